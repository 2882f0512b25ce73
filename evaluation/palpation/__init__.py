"""Measured forces on tissue and objects, judged on what was kept back from the fits.

probing     force at probes that were left out
relaxation  the second half of a hold
grasping    objects grasped several times, and whether they rank as their names say
synthetic   palpations of bodies with known truth; frank: the paper's experiments on them, a door of its own
example     a small scene for calibrate.py palpation, with its data
descents    a numeric descent after the paper's beside Gauss–Newton, in solves
design      what such palpations can tell at best
__main__    the door of the rest
"""
