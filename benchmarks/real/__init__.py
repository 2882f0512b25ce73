"""Answers on real clips, judged by what was kept back from the fit.

pulled     tissue that an instrument holds and moves: what the session that users run says of it
predicted  the same tissue ahead from a few frames, by the online estimator and by a sheet of one number
__main__   the door
"""
