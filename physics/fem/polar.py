"""Polar decomposition F = R S of deformation gradients, and how the rotation changes with F."""

from __future__ import annotations

import numpy as np

from palpate.physics.jit import kernel

_SWEEPS = 40


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
    flat, turn = (np.ascontiguousarray(values.reshape(-1, 3, 3), np.float64) for values in (gradient, rotation))
    slope = np.empty((len(flat), 9, 9))
    _spin(flat, turn, slope)
    return slope.reshape(*gradient.shape[:-2], 9, 9)


@kernel
def _rotate(gradient: np.ndarray, rotation: np.ndarray, done: np.ndarray) -> None:
    """Rotations of the gradients [N, 3, 3] with positive determinant, by Higham's scaled Newton iteration (1986)."""
    cofactor = np.empty((3, 3))
    for n in range(len(gradient)):
        now = rotation[n]
        now[:] = gradient[n]
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


@kernel
def _spin(gradient: np.ndarray, rotation: np.ndarray, slope: np.ndarray) -> None:
    """∂R/∂F [N, 9, 9] at gradients and their rotations [N, 3, 3]."""
    solved, inverse = np.empty((3, 3)), np.empty((3, 3))
    turned = np.empty((3, 9))
    for n in range(len(gradient)):
        trace = 0.0
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += rotation[n, k, i] * gradient[n, k, j] + rotation[n, k, j] * gradient[n, k, i]
                solved[i, j] = -0.5 * total
            trace -= solved[i, i]
        for i in range(3):
            solved[i, i] += trace
        determinant = 0.0
        for i in range(3):
            for j in range(3):
                a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
                inverse[i, j] = solved[a, c] * solved[b, d] - solved[a, d] * solved[b, c]
        for j in range(3):
            determinant += solved[0, j] * inverse[0, j]
        if abs(determinant) < 1e-14 * abs(trace) ** 3 or determinant == 0.0:
            determinant = np.inf  # turned inside out with two stretches alike: the rotation jumps there
        for a in range(3):  # R [e_a]×, row by row
            b, c = (a + 1) % 3, (a + 2) % 3
            for i in range(3):
                turned[a, 3 * i + a] = 0.0
                turned[a, 3 * i + b] = rotation[n, i, c]
                turned[a, 3 * i + c] = -rotation[n, i, b]
        for p in range(9):
            for q in range(9):
                total = 0.0
                for a in range(3):
                    for b in range(3):
                        total += turned[a, p] * inverse[a, b] * turned[b, q]
                slope[n, p, q] = total / determinant
