"""Young's modulus and Poisson's ratio of synthetic bodies with known truth, as Frank 2010 judges them.

surfaces    the paper's experiments
synthetic   palpations of such bodies; example: one as a small scene for palpate calibrate, a program of its own
__main__    the command `python -m benchmarks.palpation`
"""
