"""Observations of a run of contact: recorded, whitened, linearised, and turned into inputs of networks.

base       Observation, and JointLikelihood: one motion against several; kinds: observations by name
point      the followed contact
depth      the depth of all visible tissue around it
shading    its light; lit_sheet: what a camera with a light next to it sees of a pressed plane
"""
