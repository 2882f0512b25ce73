"""Vertices that can matter when only a few vertices are loaded and watched.

Distances are counted in springs from the centre of the load.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy.fft import dct

from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.reference import integrator

GRID_EIGENVALUE = 9.0
"""Upper bound on the eigenvalues of the graph Laplacian of springs right, down and along one diagonal."""
INSIDE = 1e-3
"""Factor by which the window used may neglect less than the smaller one it is checked with."""
DERIVATIVES = math.sqrt(INSIDE)
"""Factor by which trajectories must agree better where derivatives by θ are wanted: near chaos these lose more."""


class Reach(NamedTuple):
    """Distances of loads and watched vertices from the centre of a window [springs]."""

    loaded: int = 0
    """Farthest loaded vertex."""
    watched: int = 0
    """Farthest watched vertex."""

    def narrowed(self, from_load: np.ndarray, to_watched: np.ndarray) -> np.ndarray:
        """Radii within which each step must be computed, shape [T].

        Args:
            from_load: distance from the load that each step's influence has reached, shape [T].
            to_watched: distance from which each step can still matter for the watched vertices, shape [T].
        """
        return np.minimum(from_load + self.loaded, to_watched + self.watched)


def exact_radii(steps: int, reach: Reach) -> np.ndarray:
    """Radius within which each step must be computed, shape [T], int64; exact for the watched vertices' trajectories.

    A step carries influence one spring further. From rest, step t only moves vertices within t of the load. Only those
    within T−1−t of a watched one can still reach it before the end.
    """
    step = np.arange(steps)
    return reach.narrowed(step, steps - 1 - step)


def window_radii(
    stiffness: float, damping: float, mechanics: Mechanics, steps: int, reach: Reach
) -> tuple[np.ndarray, np.ndarray]:
    """Radii of two windows inside the exact cone, shapes [T], int64: the one to use and a smaller one to check it with.

    A response after τ steps is a polynomial in the elastic operator K, written in Chebyshev polynomials on K's spectrum
    [0, k_s·GRID_EIGENVALUE]. Vertices n springs away only get the terms of degree n and more: the sum of their
    coefficients bounds what a window of radius n neglects. The bound is for small deformation; comparing both windows'
    trajectories shows whether it holds for the case at hand.

    Args:
        stiffness: k_s.
        damping: k_d.
        mechanics: constants; ``window_error`` is what the smaller window may neglect, ``INSIDE`` of it the larger.
        steps: T.
        reach: distances of loads and watched vertices.
    """
    exact = exact_radii(steps, reach)
    if not (math.isfinite(stiffness) and math.isfinite(damping) and stiffness > 0):
        return exact, exact
    # θ is rounded to an eighth of an octave, to the side of wider windows, so that a window's shape can be reused.
    wider = 2 ** (math.ceil(8 * math.log2(stiffness)) / 8)
    slower = 2 ** (math.floor(8 * math.log2(damping)) / 8) if damping > 1e-6 else 0.0
    # Only the smaller of both radii counts, so that responses are needed over half of the time, or over all of it.
    horizon = int(exact.max()) + 1 if reach == Reach() else steps
    step = np.arange(steps)
    elapsed, left = np.minimum(step, horizon), np.minimum(steps - step, horizon)
    reaches = _decay(wider, slower, mechanics, horizon)
    used, checked = (np.minimum(reach.narrowed(far[elapsed], far[left]), exact) for far in reaches)
    return used, checked


@functools.lru_cache(maxsize=4096)
def _decay(stiffness: float, damping: float, mechanics: Mechanics, horizon: int) -> tuple[np.ndarray, np.ndarray]:
    """Reach of a response after 0, 1, … steps, shapes [horizon + 1]: of it all but what each window neglects."""
    # The response after τ steps has degree τ: as many nodes give its coefficients exactly.
    nodes = np.cos(np.pi * (np.arange(horizon + 1) + 0.5) / (horizon + 1))
    step = integrator(damping, mechanics)
    pull = mechanics.time_step * step.kick * stiffness * GRID_EIGENVALUE * (1 - nodes) / 2
    now, before = np.full_like(nodes, mechanics.time_step), np.zeros_like(nodes)
    responses = [before, now]
    with np.errstate(all="ignore"):
        for _ in range(horizon - 1):
            now, before = (1 + step.keep - pull) * now - step.keep * before, now
            responses.append(now)
        coefficients = np.abs(dct(np.array(responses), axis=1)) / len(nodes)
    neglected = np.cumsum(coefficients[:, ::-1], axis=1)[:, ::-1]
    if not np.isfinite(neglected).all():
        return np.arange(horizon + 1), np.arange(horizon + 1)
    allowed = mechanics.window_error * neglected[:, 0].max()
    used, checked = ((neglected > allowed * share).sum(axis=1) for share in (INSIDE, 1.0))
    return used, checked
