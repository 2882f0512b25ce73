"""Answers on real clips, judged by what was kept back from the fit: tissue that an instrument holds and moves."""
