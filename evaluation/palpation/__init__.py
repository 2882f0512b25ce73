"""Measured forces on tissue and objects, judged on what was kept back from the fits.

curves      force at left-out probes, and the second half of a hold
surfaces    Young's modulus and Poisson's ratio of bodies with known truth, as Frank 2010 judges them
synthetic   palpations of such bodies; example: one as a small scene for palpate calibrate palpation, a door of its own
__main__    the door of the studies
"""
