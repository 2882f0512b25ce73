"""Polar decomposition F = R S of deformation gradients, and how the rotation changes with F."""

import numpy as np

from palpate.physics.jit import kernel

_SWEEPS = 40
_AXES = np.cross(np.eye(3)[:, None], -np.eye(3))
"""[e_a]×, shape [3, 3, 3]."""


def rotations(gradient: np.ndarray) -> np.ndarray:
    """R of F = R S with S symmetric, shape [..., 3, 3].

    Where det F ≤ 0, R is the closest proper rotation, and S has one negative principal stretch.

    Args:
        gradient: F, shape [..., 3, 3].
    """
    flat = np.ascontiguousarray(gradient.reshape(-1, 3, 3), np.float64)
    rotation, done = np.empty_like(flat), np.zeros(len(flat), np.bool_)
    _rotate(flat, rotation, done)
    if not done.all():
        left, _, right = np.linalg.svd(flat[~done])
        left[..., 2] *= np.sign(np.linalg.det(left @ right))[:, None]
        rotation[~done] = left @ right
    return rotation.reshape(gradient.shape)


def spins(gradient: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """∂R/∂F, shape [..., 9, 9]: dR = R [ω]× with ω = (tr(S) I - S)⁻¹ axial(Rᵀ dF - dFᵀ R).

    Args:
        gradient: F, shape [..., 3, 3].
        rotation: its R, likewise.
    """
    stretch = np.swapaxes(rotation, -1, -2) @ gradient
    stretch = (stretch + np.swapaxes(stretch, -1, -2)) / 2
    trace = np.trace(stretch, axis1=-2, axis2=-1)
    matrix = trace[..., None, None] * np.eye(3) - stretch
    # Turned inside out with two equal stretches the rotation jumps, and has no derivative.
    jumps = np.abs(np.linalg.det(matrix)) <= 1e-14 * np.abs(trace) ** 3
    inverse = np.linalg.inv(np.where(jumps[..., None, None], np.eye(3), matrix))
    inverse[jumps] = 0
    turned = (rotation[..., None, :, :] @ _AXES).reshape(*rotation.shape[:-2], 3, 9)
    return np.swapaxes(turned, -1, -2) @ inverse @ turned


@kernel
def _rotate(gradient: np.ndarray, rotation: np.ndarray, done: np.ndarray) -> None:
    """Rotations of the gradients [N, 3, 3] with positive determinant, by Higham's scaled Newton iteration (1986)."""
    cofactor = np.empty((3, 3))
    for n in range(len(gradient)):
        now = rotation[n]
        for i in range(3):
            for j in range(3):
                now[i, j] = gradient[n, i, j]  # a slice's assignment takes seconds to compile
        for _ in range(_SWEEPS):
            determinant, square, other = 0.0, 0.0, 0.0
            for i in range(3):
                for j in range(3):
                    a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
                    cofactor[i, j] = now[a, c] * now[b, d] - now[a, d] * now[b, c]
                    square += now[i, j] ** 2
                    other += cofactor[i, j] ** 2
            for j in range(3):
                determinant += now[0, j] * cofactor[0, j]
            # Nearly flat gradients lose the digits that the rotation needs; a singular value decomposition keeps them.
            if not determinant > 1e-6 * square**1.5:
                break
            scale = (other / square) ** 0.25 / determinant**0.5
            change = 0.0
            for i in range(3):
                for j in range(3):
                    following = 0.5 * (scale * now[i, j] + cofactor[i, j] / (scale * determinant))
                    change += (following - now[i, j]) ** 2
                    now[i, j] = following
            if change < 1e-28:
                done[n] = True
                break
