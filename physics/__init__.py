"""Simulators and their derivatives in arrays; knows nothing of images, networks or files.

mechanics        constants of the simulator, θ and its admissible box
mesh             the tissue surface: vertices, springs, held rim, contact vertex and normal; matrices of springs
load             how a tool acts on a mesh: Press or Grip
observation      observed motion of tracked points; linearised likelihoods
patches          which vertices the pixels around a contact show while the tissue moves
depth            the depth of the tissue around a contact: errors and likelihood
likelihood       how well a θ explains an observation, and its derivatives
shading          how bright tissue is under a light at the camera
identifiability  what a motion can tell about θ: information, bounds, verdict
jit              compiled loops
sheet            a gripped sheet at rest: the quasi-static limit
fem              soft bodies of tetrahedra at rest: laws, equilibria, exact derivatives
pbd              extended position-based dynamics: particles that constraints join, fields of stiffness, adjoint
msd              mass–spring–damper sheets, for numpy and for torch
"""

from palpate.common.lazy import exported

__getattr__, __dir__, __all__ = exported(
    {
        "palpate.physics.mesh": ("Mesh", "contact_normal", "grid_mesh", "nearest_vertex"),
        "palpate.physics.load": ("Grip", "Press", "PressShape", "held", "ramped"),
        "palpate.physics.observation": ("Observation",),
        "palpate.physics.likelihood": ("Likelihood",),
        "palpate.physics.mechanics": ("Bounds", "Mechanics"),
    }
)
