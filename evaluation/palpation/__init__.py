"""Palpations of bodies with known truth.

surfaces    Young's modulus and Poisson's ratio of bodies with known truth, as Frank 2010 judges them
synthetic   palpations of such bodies; example: one as a small scene for calibrate.py palpation, a door of its own
__main__    the door
"""
