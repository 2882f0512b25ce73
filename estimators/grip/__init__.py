"""Tissue that an instrument holds and moves: its motion is given, what lies around it is explained.

recorder     a run of contact without an onset, gathered frame by frame
sheet        one foundation and the force, with the grip's motion unknown
lattice      the points as a sheet's nodes, and a sheet whose grip moves as it was observed to
grip_estimate what all of that tells, and what is determined
stiffness_fit where it is stiffer, with the grip's motion unknown, and how well that is known
whitening    neighbours' errors made independent, and how many of them are correlated
"""
