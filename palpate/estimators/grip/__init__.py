"""Pulls: the relative force at an instrument that holds and moves tissue, by a sheet on a foundation.

recorder       motion of tissue points over a run of contact, and the fit to it
lattice        the sheet on the lattice of tracked points: one factorisation per foundation serves all frames
grip_estimate  skill and relative force, and whether it is determined
"""
