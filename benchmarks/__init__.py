"""What is timed or measured once, against what; each is run by `python -m benchmarks.NAME`.

rollout        the differentiable rollout against plain torch
inference      where the time of inference goes: encoder and head alone, and every stage of infer.py
shared         what all of them need: command line, timing, a table, the machine
"""
