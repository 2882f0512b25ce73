"""Files that `train.py test` writes: table 2 and figure 3 of Bini 2026, and checks that these leave out.

report      all files of an evaluation: tables (CSV) and figures (PNG)
statistics  means with intervals, paired tests, and whether the network gives the same θ for every input
simulated   baselines without a network: no motion, one constant θ; when a motion comes to rest
figures     the pictures
"""
