"""Answers on real clips, judged by what was kept back from the fit.

pulled     tissue that an instrument holds and moves: the estimate of the session that users run
__main__   the command `python -m benchmarks.real`
"""
