"""Parts of the online estimator (Liang 2024): what takes a simulated state to what was seen, and its derivative.

matching  how far particles are from what was seen: Chamfer distance to a cloud, followed points
mapping   the residual deformation that takes a state to what was seen, and its adjoint
"""

from physics.lazy import exported

__getattr__ = exported(
    {
        "estimators.online.matching": ("Chamfer", "Tracks"),
        "estimators.online.mapping": ("Mapping", "Residual", "map_residual"),
    }
)
