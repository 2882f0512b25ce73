"""How bright tissue is under a light at the camera, as an endoscope's is: it darkens as it tilts or goes away.

A matt surface of albedo ρ sends back I = gain·ρ·cos θ/r², with θ between its normal and the line of sight and r its
distance from lens and lamp. Between two instants the albedo of a tissue point cancels, so that the logarithm of their
ratio, log(cos θ/r²) less its value at rest, tells how the point has tilted and moved.
"""

from __future__ import annotations

import numpy as np


def log_brightness(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """log cos θ and log(1/r²) of surfaces that are given on grids of points, shape [..., h, w] each.

    The normal is that of central differences; at the grid's border of one-sided ones.

    Args:
        points: positions from the camera, shape [..., h, w, 3] [any unit], h and w at least 2; no surface passes
            through the camera or is seen exactly from its side.
    """
    facing, normal_square, square = _products(points)[:3]
    falloff = -np.log(square)
    return np.log(np.abs(facing)) - 0.5 * (np.log(normal_square) - falloff), falloff


def log_brightness_slopes(points: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of `log_brightness` by D parameters, shape [..., h, w, D] each.

    Args:
        points: as above.
        slopes: derivatives of the points, shape [..., h, w, 3, D].
    """
    facing, normal_square, square, normal, (down, across) = _products(points)
    turning = _cross(np.gradient(slopes, axis=-4), across[..., None]) + _cross(
        down[..., None], np.gradient(slopes, axis=-3)
    )
    towards = np.einsum("...i,...id->...d", normal, slopes) + np.einsum("...i,...id->...d", points, turning)
    stretched = np.einsum("...i,...id->...d", normal, turning)
    away = np.einsum("...i,...id->...d", points, slopes) / square[..., None]
    return towards / facing[..., None] - stretched / normal_square[..., None] - away, -2 * away


def _products(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """n·p, n·n, p·p, the normals n (of any length) and their factors, derivatives of the points along the grid."""
    factors = np.gradient(points, axis=(-3, -2))
    normal = _cross(*(factor[..., None] for factor in factors))[..., 0]
    products = (np.einsum("...i,...i->...", *pair) for pair in ((normal, points), (normal, normal), (points, points)))
    return *products, normal, list(factors)


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Vector product along the last axis but one; numpy's own takes three times as long on many small vectors."""
    ahead, behind = [1, 2, 0], [2, 0, 1]
    return first[..., ahead, :] * second[..., behind, :] - first[..., behind, :] * second[..., ahead, :]
