"""Results on real clips of tissue that an instrument holds and moves, judged by frames kept back from the fit."""
