"""A gripped sheet at rest: where springs and a foundation hold tissue whose grip is moved slowly.

The quasi-static limit of Bini 2026, equation 9, for a sheet under tension: K u = 0 away from the grip, with K the graph
Laplacian of the springs' stiffness plus the foundation's. Tension makes the force of a spring k·(u_j - u_i), along
whatever axis: every axis is alone, and a picture's plane does. Only ratios of stiffness and foundation count for u.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from palpate.physics.fem.linear_system import factorised
from palpate.physics.mesh import laplacian


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A sheet at rest under a grip; N nodes, G gripped nodes, A axes."""

    displacement: np.ndarray
    """Displacement from where nothing is pulled, shape [N, A], in the unit of the grip's motion."""
    matrix: csr_array
    """K, shape [N, N] [unit of stiffness]."""
    gripped: np.ndarray
    """Mask of the gripped nodes, shape [N], bool."""

    @property
    def reaction(self) -> np.ndarray:
        """Force on every gripped node that holds it there, shape [G, A] [unit of stiffness × unit of motion]."""
        return (self.matrix @ self.displacement)[self.gripped]


def equilibrium(
    springs: np.ndarray, stiffness: np.ndarray, anchor: np.ndarray, gripped: np.ndarray, motion: np.ndarray
) -> Equilibrium:
    """Equilibrium of a sheet when some of its nodes are held at a displacement.

    Args:
        springs: node indices, shape [S, 2].
        stiffness: stiffness of every spring, shape [S], positive.
        anchor: stiffness of every node's foundation, shape [N], positive.
        gripped: mask of the held nodes, shape [N]; some but not all.
        motion: their displacement, shape [G, A], finite.

    Raises:
        ValueError: nothing is gripped or everything; stiffness that is not positive; motion that is not finite.
    """
    count = len(anchor)
    if not gripped.any() or gripped.all():
        raise ValueError(f"{int(gripped.sum())} of {count} nodes are gripped; hold some of them and leave some free.")
    if not ((stiffness > 0).all() and (anchor > 0).all()):
        raise ValueError("a stiffness is not positive; without any a node has no place.")
    if not np.isfinite(motion).all():
        raise ValueError("motion of the grip holds a number that is not finite.")
    matrix = laplacian(springs, stiffness, anchor)
    displacement = np.zeros((count, motion.shape[1]))
    displacement[gripped] = motion
    free = matrix[~gripped]
    pull = free[:, gripped] @ np.asarray(motion, np.float64)
    displacement[~gripped] = factorised(free[:, ~gripped].tocsc()).solve(-pull)
    return Equilibrium(displacement, matrix, gripped)
