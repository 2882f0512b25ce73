"""Likelihood ratio, for one step in time, that tissue next to a tool moves with the tool or with the background.

Let the tool move by u, less the background's motion. Tissue at a distance d from it moves by c·exp(-d/λ)·u if the tool
holds or presses it, or not at all. In both hypotheses a mask may leave some of the tool's own pixels to the tissue,
which then move by u. The background's motion has an error that neighbouring points share.
"""

from dataclasses import dataclass

import numpy as np

HELD = 0.6
"""Share of the points next to a tool in contact that move with it; others may be tissue in front or behind."""
LEAKED = 0.1
"""Share of the points that a mask may leave to the tissue although they are the tool's."""
OUTLIERS = 0.05
"""Share of the points that move in any way."""
CORRELATION_LENGTH = 50.0
"""Distance below which points share the models' residual [px]."""
MIN_POINTS = 15
"""Smallest number of points next to the tool that decide."""
TOOL_SPREAD = 0.15
"""Standard deviation of a leaked tool pixel's motion about u, as a share of |u|: tools turn, jaws close."""
HELD_SPREAD = 0.25
"""Standard deviation of held tissue's motion about that by its distance, as a share."""


@dataclass(frozen=True, eq=False)
class TipMotion:
    """Motion of a tool's tip and N tissue points next to it between two frames, less the background's."""

    moved: np.ndarray
    """Displacement of the tissue points, shape [N, 2] [px]."""
    distance: np.ndarray
    """Distance of the points from the tool, beyond the guard band, shape [N] [px]."""
    spacing: float
    """Distance of neighbouring points [px]."""
    tool: np.ndarray
    """Displacement u of the tip, shape [2] [px]."""
    tool_sd: float
    """Standard deviation of u by axis [px]."""
    noise: float
    """Standard deviation of a point's own displacement by axis [px]."""
    background_sd: float
    """Standard deviation by axis of the background's motion about the one subtracted, common to neighbours [px]."""


def log_ratio(observed: TipMotion) -> float:
    """Logarithm of the likelihood ratio of the motion, with the tool over without; 0 for too few points.

    It is near 0 if the tool hardly moves against the background.
    """
    if len(observed.moved) < MIN_POINTS:
        return 0.0
    # Evenly spread; each then counts for more.
    every = max(1, len(observed.moved) // 120)
    moved, distance = observed.moved[::every], observed.distance[::every]
    # Correlated points count as one.
    weight = min(1.0, (observed.spacing / CORRELATION_LENGTH) ** 2) * len(observed.moved) / len(moved)
    # Errors of the background's motion that are tried, and of the tool's along its way [standard deviations].
    axis = np.array([-1.8, -0.9, 0.0, 0.9, 1.8])
    axis_weights = -np.square(axis) / 2 - np.log(np.exp(-np.square(axis) / 2).sum())
    log_weights = np.add.outer(axis_weights, axis_weights).ravel()
    errors = observed.background_sd * np.column_stack([np.repeat(axis, len(axis)), np.tile(axis, len(axis))])
    tool, motion = observed.tool - errors, moved - errors[:, None]
    square, along, way = (motion**2).sum(-1), (motion * tool[:, None]).sum(-1), (tool**2).sum(1)[:, None]
    own = observed.noise**2 + observed.background_sd**2
    leaked = _density(square - 2 * along + way, own + observed.tool_sd**2 + TOOL_SPREAD**2 * way)
    still = (1 - LEAKED - OUTLIERS) * _density(square, own) + LEAKED * leaked
    still += OUTLIERS * _density(square, 4 * (own + way))
    # The part that holds moves as the tip does, but for an error along its way.
    length = np.sqrt(way).clip(1e-9)
    logs = []
    for off, log_weight in zip(axis, axis_weights, strict=True):
        longer = 1 + off * observed.tool_sd / length
        for reach in (40.0, 80.0, 160.0):  # candidates of λ [px]
            for coupling in (0.4, 0.6, 0.8, 1.0):  # candidates of c: tissue sticks to the tool
                share = coupling * np.exp(-distance / reach) * longer
                apart = square - 2 * share * along + share**2 * way
                held = HELD * _density(apart, own + (HELD_SPREAD * share) ** 2 * way) + (1 - HELD) * still
                logs.append(weight * np.log(held).sum(axis=1) + log_weights + log_weight)
    none = weight * np.log(still).sum(axis=1) + log_weights
    return float(np.logaddexp.reduce(np.ravel(logs)) - np.log(12) - np.logaddexp.reduce(none))


def _density(square: np.ndarray, variance: np.ndarray | float) -> np.ndarray:
    """Density of a normal distribution in the plane, at squared distances from its mean [px²]; never 0."""
    # The least density has a finite logarithm.
    return np.exp(-square / (2 * variance)) / (2 * np.pi * variance) + 1e-300
