"""Polar decomposition F = R S of deformation gradients, and how the rotation changes with F."""

import numpy as np


def rotations(gradient: np.ndarray) -> np.ndarray:
    """R of F = R S with S symmetric, shape [..., 3, 3].

    Where det F ≤ 0, R is the closest proper rotation, and S has one negative principal stretch.

    Args:
        gradient: F, shape [..., 3, 3].
    """
    left, _, right = np.linalg.svd(gradient)
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[..., None]
    return left @ right


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
    axes = np.cross(np.eye(3)[:, None], -np.eye(3))  # [e_a]×
    turned = (rotation[..., None, :, :] @ axes).reshape(*rotation.shape[:-2], 3, 9)
    return np.swapaxes(turned, -1, -2) @ inverse @ turned
