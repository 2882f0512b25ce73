"""Which vertices can matter when only the contact vertex is loaded and observed.

Distances are counted in springs from the contact vertex.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from scipy.fft import dct

from physics.mechanics import Mechanics
from physics.msd_numpy import integrator

GRID_EIGENVALUE = 9.0
"""Upper bound on the eigenvalues of the graph Laplacian of springs right, down and along one diagonal."""

LEVELS_PER_OCTAVE = 8
"""θ is rounded this finely, to the side of wider windows, so that a window's shape can be reused."""

INSIDE = 1e-3
"""How much less the window used may neglect than the smaller one it is checked with."""


def exact_radii(steps: int) -> np.ndarray:
    """Radius within which each step must be computed, shape [T], int64; exact for the contact vertex's trajectory.

    A step carries influence one spring further. From rest, step t can only move vertices within t of the contact, and
    only those within T−1−t can still reach it before the end.
    """
    step = np.arange(steps)
    return np.minimum(step, steps - 1 - step)


def growing_radii(steps: int) -> np.ndarray:
    """Radius within which each step can move vertices, shape [T], int64; exact for the whole field."""
    return np.arange(steps)


def window_radii(
    stiffness: float, damping: float, mechanics: Mechanics, eigenvalue: float
) -> tuple[np.ndarray, np.ndarray]:
    """Radii of two windows inside the exact cone, shapes [T], int64: the one to use and a smaller one to check it with.

    A response after τ steps is a polynomial in the elastic operator K. Written in Chebyshev polynomials on K's spectrum
    [0, k_s·λ], whatever lies n springs away only gets the terms of degree n and more, so the sum of their coefficients
    bounds what a window of radius n neglects. That holds for small deformation; the comparison of both windows'
    trajectories is what shows that it holds for the case at hand.

    Args:
        stiffness: k_s.
        damping: k_d.
        mechanics: constants; ``window_error`` is what the smaller window may neglect, ``INSIDE`` of it the larger.
        eigenvalue: upper bound λ on the eigenvalues of the springs' graph Laplacian.
    """
    exact = exact_radii(mechanics.steps)
    if not (math.isfinite(stiffness) and math.isfinite(damping) and stiffness > 0):
        return exact, exact
    wider = 2 ** (math.ceil(LEVELS_PER_OCTAVE * math.log2(stiffness)) / LEVELS_PER_OCTAVE)
    slower = 2 ** (math.floor(LEVELS_PER_OCTAVE * math.log2(damping)) / LEVELS_PER_OCTAVE) if damping > 1e-6 else 0.0
    return _windows(wider, slower, mechanics, eigenvalue)


@functools.lru_cache(maxsize=4096)
def _windows(
    stiffness: float, damping: float, mechanics: Mechanics, eigenvalue: float
) -> tuple[np.ndarray, np.ndarray]:
    """`window_radii` for rounded parameters."""
    exact = exact_radii(mechanics.steps)
    horizon = int(exact.max()) + 1
    # The response after τ steps has degree τ: as many nodes give its coefficients exactly.
    nodes = np.cos(np.pi * (np.arange(horizon + 1) + 0.5) / (horizon + 1))
    step = integrator(damping, mechanics)
    pull = mechanics.time_step * step.kick * stiffness * (eigenvalue + mechanics.anchor) * (1 - nodes) / 2
    now, before = np.full_like(nodes, mechanics.time_step), np.zeros_like(nodes)
    responses = [before, now]
    with np.errstate(all="ignore"):
        for _ in range(horizon - 1):
            now, before = (1 + step.keep - pull) * now - step.keep * before, now
            responses.append(now)
        coefficients = np.abs(dct(np.array(responses), axis=1)) / len(nodes)
    neglected = np.cumsum(coefficients[:, ::-1], axis=1)[:, ::-1]
    if not np.isfinite(neglected).all():
        return exact, exact
    step_index = np.arange(mechanics.steps)
    elapsed = np.minimum(np.minimum(step_index, mechanics.steps - step_index), horizon)
    allowed = mechanics.window_error * neglected[:, 0].max()
    used, checked = ((neglected > allowed * share).sum(axis=1)[elapsed] for share in (INSIDE, 1.0))
    return np.minimum(used, exact), np.minimum(checked, exact)
