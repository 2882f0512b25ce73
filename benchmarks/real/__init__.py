"""Answers on real clips, judged by what was kept back from the fit.

pulled     tissue that an instrument holds and moves: what the session that users run says of it
__main__   the door
"""
