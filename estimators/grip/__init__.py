"""Tissue that an instrument holds and moves: its motion is given, what lies around it is explained.

driver       where it is held, by its motion alone
lattice      the points as a sheet's nodes, and coarse knots for fields over it
recorder     a run of contact without an onset, gathered frame by frame
sheet_fit    stiffness and foundation as fields, and how well they predict
sheet_problem, foundation_fit  one foundation and the force, with the grip's motion unknown
stiffness_field, stiffness_fit  where it is stiffer, with the grip's motion unknown
pull_motion, pull_fit  force over E by a slab of finite elements, where its thickness is given
alike        how many points err alike
whitening    neighbours' errors made independent
"""

from physics.lazy import exported

__getattr__ = exported({"estimators.grip.sheet_fit": ("GripFrame", "NothingMoves", "SheetFit", "fit_sheet")})
