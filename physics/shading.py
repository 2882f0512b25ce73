"""Brightness of tissue under a light at the camera, as an endoscope's is: it darkens as it tilts or goes away.

A matt surface of albedo ρ sends back I = gain·ρ·cos θ/r², with θ between its normal and the line of sight and r its
distance from lens and lamp. Between two instants the albedo of a tissue point cancels, so that the logarithm of their
ratio, log(cos θ/r²) less its value at rest, tells how the point has tilted and moved. Rough tissue darkens less as it
tilts, and a wet one mirrors light where it faces the camera.
"""

import numpy as np


def log_brightness(depth: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """log cos θ and log(1/r²) of surfaces that a camera sees, shape [..., h, w] each.

    With w = 1/z and its slopes p, q by x and y of the rays, the normal is (p, q, w - x·p - y·q), of any length, and
    cos θ = w / (|normal|·|ray|). Slopes are central differences, at the picture's border one-sided ones; of planes,
    whose w is linear, they are exact.

    Args:
        depth: z, shape [..., h, w] [any unit], above 0, h and w at least 2.
        rays: (x, y, 1) of the pixels, of a pinhole camera, shape [h, w, 3].
    """
    inverse = 1 / depth
    pitch_right, pitch_down = rays[0, 1, 0] - rays[0, 0, 0], rays[1, 0, 1] - rays[0, 0, 1]
    right, down = np.gradient(inverse, axis=-1) / pitch_right, np.gradient(inverse, axis=-2) / pitch_down
    away = inverse - rays[..., 0] * right - rays[..., 1] * down
    square, length = right**2 + down**2 + away**2, np.log(np.square(rays).sum(axis=-1))
    return np.log(inverse) - 0.5 * np.log(square) - 0.5 * length, 2 * np.log(inverse) - length


def mirrored(facing: np.ndarray, lobe: float) -> np.ndarray:
    """Light that a wet surface mirrors to a camera at the lamp, over that of one that faces it (a von Mises lobe).

    Args:
        facing: log cos θ.
        lobe: logarithm of the lobe's width [rad].
    """
    return np.exp(np.expm1(facing) * np.exp(-2 * lobe))


def matt(facing: np.ndarray, rough: float) -> np.ndarray:
    """Matt light of a rough surface to a camera at the lamp, but for its distance: cos θ + ρ sin² θ.

    That is Oren and Nayar's law (1994) with ρ = B/A where light comes and goes along one ray; ρ = 0: Lambert's.

    Args:
        facing: log cos θ.
        rough: ρ, 0 to 0.5.
    """
    return np.exp(facing) - rough * np.expm1(2 * facing)
