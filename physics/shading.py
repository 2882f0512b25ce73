"""Brightness of tissue under a light at the camera, as an endoscope's is: it darkens as it tilts or goes away.

A matt surface of albedo ρ sends back I = gain·ρ·cos θ/r², with θ between its normal and the line of sight and r its
distance from lens and lamp. Between two instants the albedo of a tissue point cancels, so that the logarithm of their
ratio, log(cos θ/r²) less its value at rest, tells how the point has tilted and moved. Rough tissue darkens less as it
tilts, and a wet one mirrors light where it faces the camera.
"""

import math

import numpy as np

from palpate.physics.jit import kernel


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


@kernel
def exchanged(points, light):
    """Light that places of a surface receive from its other places by their form factors, shape [N, S, S].

    Args:
        points: of the surface, shape [N, S, S, 3].
        light: that leaves them, shape [N, S, S].
    """
    count, side = points.shape[0], points.shape[1]
    found, size = np.zeros(light.shape), side * side
    at, normal, sent = np.empty((3, size)), np.empty((3, size)), np.empty(size)
    for frame in range(count):
        place = points[frame]
        for row in range(side):
            for column in range(side):
                top, down = max(row - 1, 0), min(row + 1, side - 1)
                left, right = max(column - 1, 0), min(column + 1, side - 1)
                a = (place[down, column] - place[top, column]) / (down - top)
                b = (place[row, right] - place[row, left]) / (right - left)
                index = row * side + column
                at[:, index], sent[index] = place[row, column], light[frame, row, column]
                normal[0, index] = a[2] * b[1] - a[1] * b[2]
                normal[1, index] = a[0] * b[2] - a[2] * b[0]
                normal[2, index] = a[1] * b[0] - a[0] * b[1]
        if normal[2, size // 2] > 0:
            normal *= -1  # towards the camera
        received = np.zeros(size)
        for here in range(size):
            x, y, z = at[0, here], at[1, here], at[2, here]
            for there in range(here):
                dx, dy, dz = at[0, there] - x, at[1, there] - y, at[2, there] - z
                ahead = normal[0, here] * dx + normal[1, here] * dy + normal[2, here] * dz
                back = -(normal[0, there] * dx + normal[1, there] * dy + normal[2, there] * dz)
                if ahead > 0 and back > 0:
                    factor = ahead * back / (dx * dx + dy * dy + dz * dz) ** 2
                    received[here] += sent[there] * factor
                    received[there] += sent[here] * factor
        area = np.sqrt(np.square(normal).sum(axis=0))
        found[frame] = (received / (math.pi * area)).reshape(side, side)
    return found
