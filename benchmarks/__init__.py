"""What is timed or measured once, against what; each is run by `python -m benchmarks.NAME`.

inference      encoder and head alone, one contact, and plain videos from end to end
"""
