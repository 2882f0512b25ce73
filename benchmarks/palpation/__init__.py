"""Young's modulus and Poisson's ratio of synthetic bodies with known truth, as Frank 2010 judges them.

__main__    the command `python -m benchmarks.palpation`: the paper's experiments
synthetic   palpations of such bodies; example: one as a small scene for palpate calibrate, a program of its own
"""
