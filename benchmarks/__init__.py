"""What is timed or measured once, against what; each is run by `python -m benchmarks.NAME`.

goldens        numbers that a change must leave as they are
inference      encoder and head alone, one contact, and plain videos from end to end
"""
