"""Does the tissue next to a tool move with the tool or with the background? A likelihood ratio for one step in time.

Two hypotheses of how tissue at a distance d from the tool moves while the tool moves by u, all less the background's
motion: by c·exp(-d/λ)·u, as tissue does that the tool holds or presses, or not at all. Both know that a mask may leave
some of the tool's own pixels to the tissue, which then move by u as far as they reach and not beyond, and that the
background's motion is known with an error that neighbouring points share.
"""

from dataclasses import dataclass

import numpy as np

COUPLING = (0.4, 0.6, 0.8, 1.0)
"""Candidates of c: tissue that sticks to the tool follows most of its motion."""
REACH = (40.0, 80.0, 160.0)
"""Candidates of λ [px]."""
HELD = 0.6
"""Share of the points next to a tool in contact that follow it; the others may be other tissue, in front or behind."""
LEAKED = 0.1
"""Share of the points that a mask may leave to the tissue although they are the tool's."""
OUTLIERS = 0.05
"""Share of the points that move anyhow."""
CORRELATION_LENGTH = 50.0
"""Distance below which points share what the models leave unexplained [px]."""
MIN_POINTS = 15
"""Fewer points next to the tool decide nothing."""
TOOL_SPREAD = 0.15
"""Standard deviation of a leaked tool pixel's motion about u, as a share of |u|: tools turn, jaws close."""
HELD_SPREAD = 0.25
"""Standard deviation of held tissue's motion about what its distance implies, as a share of that."""
_AXIS = np.array([-1.8, -0.9, 0.0, 0.9, 1.8])
_OFFSETS = np.column_stack([np.repeat(_AXIS, len(_AXIS)), np.tile(_AXIS, len(_AXIS))])
"""Errors of the background's motion that are tried, and by axis of the tool's [standard deviations]."""
_AXIS_LOG_WEIGHTS = -np.square(_AXIS) / 2 - np.log(np.exp(-np.square(_AXIS) / 2).sum())
_LOG_WEIGHTS = np.add.outer(_AXIS_LOG_WEIGHTS, _AXIS_LOG_WEIGHTS).ravel()


@dataclass(frozen=True, eq=False)
class TipMotion:
    """How a tool's tip and N tissue points next to it moved between two frames, less the background's motion."""

    moved: np.ndarray
    """Displacement of the tissue points, shape [N, 2] [px]."""
    distance: np.ndarray
    """Their distance from the tool, beyond the guard band, shape [N] [px]."""
    spacing: float
    """Distance of neighbouring points [px]."""
    tool: np.ndarray
    """u, displacement of the tip, shape [2] [px]."""
    tool_sd: float
    """Standard deviation of u by axis [px]."""
    noise: float
    """Standard deviation of a point's own displacement by axis [px]."""
    background_sd: float
    """Standard deviation by axis of the background's motion about the one subtracted, common to neighbours [px]."""


def log_ratio(observed: TipMotion) -> float:
    """Logarithm of how much likelier the motion is if the tissue moves with the tool; 0 where nothing decides.

    Where the tool hardly moves against the background, both say the same.
    """
    if len(observed.moved) < MIN_POINTS:
        return 0.0
    # Evenly spread; each then counts for more.
    every = max(1, len(observed.moved) // 120)
    moved, distance = observed.moved[::every], observed.distance[::every]
    # Correlated points count as one.
    weight = min(1.0, (observed.spacing / CORRELATION_LENGTH) ** 2) * len(observed.moved) / len(moved)
    errors = observed.background_sd * _OFFSETS
    tool, motion = observed.tool - errors, moved - errors[:, None]
    square, along, way = (motion**2).sum(-1), (motion * tool[:, None]).sum(-1), (tool**2).sum(1)[:, None]
    own = observed.noise**2 + observed.background_sd**2
    leaked = _density(square - 2 * along + way, own + observed.tool_sd**2 + TOOL_SPREAD**2 * way)
    still = (1 - LEAKED - OUTLIERS) * _density(square, own) + LEAKED * leaked
    still += OUTLIERS * _density(square, 4 * (own + way))
    # The part that holds moves as the tip does, but for an error along its way.
    length = np.sqrt(way).clip(1e-9)
    logs = []
    for off, log_weight in zip(_AXIS, _AXIS_LOG_WEIGHTS, strict=True):
        longer = 1 + off * observed.tool_sd / length
        for reach in REACH:
            for coupling in COUPLING:
                share = coupling * np.exp(-distance / reach) * longer
                apart = square - 2 * share * along + share**2 * way
                held = HELD * _density(apart, own + (HELD_SPREAD * share) ** 2 * way) + (1 - HELD) * still
                logs.append(weight * np.log(held).sum(axis=1) + _LOG_WEIGHTS + log_weight)
    none = weight * np.log(still).sum(axis=1) + _LOG_WEIGHTS
    candidates = len(REACH) * len(COUPLING)
    return float(np.logaddexp.reduce(np.ravel(logs)) - np.log(candidates) - np.logaddexp.reduce(none))


def _density(square: np.ndarray, variance: np.ndarray | float) -> np.ndarray:
    """Density of a normal distribution in the plane, at squared distances from its mean [px²]; never 0."""
    # The least density has a finite logarithm.
    return np.exp(-square / (2 * variance)) / (2 * np.pi * variance) + 1e-300
