"""The evaluation that `train.py test` writes: the paper's table 2 and figure 3, and checks that these leave out.

report      all files of an evaluation: tables, JSON, one HTML page, whose words are report.md
analysis    all numbers of an evaluation
statistics  means with intervals, paired tests, and whether the network gives the same θ for every input
simulated   no network: no motion, one constant θ; when a motion comes to rest
figures     the pictures
"""
