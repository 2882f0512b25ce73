"""How good the estimates are.

harness      what all share: resuming, tables, pictures and page; an experiment gives rows for a case
paper        `train.py test`: table 2, figure 3 and whether training collapsed
recovery     synthetic clips with known truth against the best that is possible; benchmark: its door
compare_with_truth  estimates of synthetic clips; a door of its own
plain_video  presses in drawn videos, from the pictures alone; a door of its own
real         real clips, judged on what was kept back from the fit; a door of its own
online       the online estimator on simulated pulls, as its paper judges it; a door of its own
palpation    measured forces on tissue, judged on what was kept back; a door of its own
page         Markdown and figures as one HTML page
"""
