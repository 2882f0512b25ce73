"""What is timed or measured once, against what; each is run by `python -m benchmarks.NAME`.

inference      where the time of inference goes: encoder and head alone, and every stage of infer.py
"""
