"""What is observed of a run of contact: how it is recorded, whitened, linearised, and what networks are given of it.

base       Observation, and JointLikelihood: one motion against several; kinds: observations by name
point      the followed contact
depth      the depth of all visible tissue around it
shading    its light; lit_sheet: what a camera with a light next to it sees of a pressed plane
"""
