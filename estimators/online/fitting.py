"""What one number each can say of gripped tissue: how fast it follows, what holds it to its rest, how it bends.

The paper leaves time step, masses and attachments open, and its optimiser takes tens of frames to get anywhere. These
three are fitted to the frames that were observed, by simulation alone; stiffness place by place is left to the
optimiser.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from palpate.estimators.grip.lattice import length
from palpate.physics.load import Grip
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.simulation import Stepping, simulate
from palpate.physics.pbd.stiffness import Stiffness

TIME_STEPS = (1.0, 2.0, 4.0, 8.0)
"""A frame's time over √(m/k): from tissue that hangs back to tissue that is at rest in every frame."""
FOUNDATIONS = (0.0, 0.01, 0.03, 0.1, 0.3)
"""Over the stiffness of distances."""
BENDINGS = (0.02, 0.3, 1.0)
"""Stiffness of shapes, likewise: the paper's largest of both bounds is a five-hundredth. Those that bounds allow are
tried."""
LEAST = 0.2
"""Frames whose points move less tell nothing [px]."""


VOLUME = 1e10 * 0.0089**4
"""Stiffness of volumes where edges are 1 long in the mean: the paper's 10¹⁰ at its size, 600 particles of a block with
edges of 8.9 mm. It goes with the inverse of their fourth power, since a volume's gradient goes with the second."""


def uniform(body: Body, distance: float, shape: float) -> Stiffness:
    """The same everywhere; of volumes as the paper's, in whatever unit."""
    edge = float(body.layout.rest[body.kinds[0]].mean())
    return Stiffness(np.full(body.count, distance), np.full(body.count, shape), VOLUME / edge**4)


class Fit(NamedTuple):
    """What explains some frames best."""

    time_step: float
    foundation: float
    """Over the stiffness of distances."""
    bending: float
    """Stiffness of shapes, likewise."""
    error: float
    """Mean over frames of error over motion, root mean squares over points."""

    def stepping(self, usual: Stepping, stiffness: float) -> Stepping:
        """The usual one with this time step and foundation, for such a stiffness of distances."""
        return dataclasses.replace(usual, time_step=self.time_step, foundation=self.foundation * stiffness)


def fit_motion(
    body: Body,
    grip: Grip,
    seen: np.ndarray,
    shown: Callable[[np.ndarray], np.ndarray],
    stepping: Stepping,
    stiffness: float,
    bendings: Sequence[float] = BENDINGS,
) -> Fit | None:
    """Try every combination on the frames so far, from rest on; None where nothing moves in any.

    Args:
        body: N particles.
        grip: where the gripped ones are in T frames.
        seen: displacement of Q points in them, shape [T, Q, 2] [px]; not observed = NaN.
        shown: gives that of states [T, N, 3].
        stepping: sweeps a step; its time step and foundation don't count.
        stiffness: of distances, the same everywhere.
        bendings: stiffness of shapes over that, to choose from.
    """
    used = np.isfinite(seen[..., 0] + seen[..., 1])
    motion = np.array([length(frame[some]) if some.any() else 0 for frame, some in zip(seen, used, strict=True)])
    telling = np.flatnonzero(motion > LEAST)
    if len(telling) == 0:
        return None
    fits = []
    for time_step, foundation, bending in product(TIME_STEPS, FOUNDATIONS, bendings):
        fit = Fit(time_step, foundation, bending, np.nan)
        fields = uniform(body, stiffness, bending * stiffness)
        states = simulate(body, fields, grip, fit.stepping(stepping, stiffness)).positions[0, 1:]
        off = shown(states) - seen
        errors = [length(off[frame, used[frame]]) / motion[frame] for frame in telling]
        fits.append(fit._replace(error=float(np.mean(errors))))
    return min(fits, key=lambda fit: fit.error)
