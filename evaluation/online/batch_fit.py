"""Fields of stiffness fitted to the first frames together, many times over (DiffCloud, as Liang 2024 compares it).

DiffCloud (Sundaresan 2022) simulates a training trajectory from its beginning, compares it with its point clouds, and
changes the simulation's parameters by the gradient of the sum. Here these are the same fields, within the same bounds
and by the same optimiser as the online estimator's; followed points count where these are matched.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palpate.estimators.online.adam import Adam
from palpate.estimators.online.matching import Match
from palpate.estimators.online.objective import Objective
from palpate.physics.pbd.stiffness import Stiffness

FRAMES, EPOCHS = 30, 25
"""Of the training trajectory, and how often it is gone through (Liang 2024, section III-D)."""


def fit_batch(
    objective: Objective,
    begun: Stiffness,
    places: np.ndarray,
    matches: Sequence[Sequence[Match]],
    rate: float,
    epochs: int = EPOCHS,
) -> tuple[Stiffness, np.ndarray]:
    """Fields after so many epochs.

    Args:
        objective: how the body is stepped; its other terms don't count.
        begun: fields to begin with, shape [N].
        places: where gripped particles are in T frames, from rest on, shape [T, G, 3] [m].
        matches: what was seen in each of them.
        rate: Adam's, on logits.
        epochs: how often.

    Returns:
        the fields, and the mean over frames of what was left before every epoch, shape [epochs] [mean edges²]: Adam's
        guard knows no unit.
    """
    body, bounds, adam, fields = objective.body, objective.bounds, Adam(rate), begun
    logits, left = bounds.logits(begun), []
    share = 1 / (len(matches) * float(body.layout.rest[body.kinds[0]].mean()) ** 2)
    for _ in range(epochs):
        motion = objective.stepped(fields, body.rest, places)
        pulls, total = np.zeros_like(motion.positions), 0.0
        states, slopes_at = motion.positions[0], pulls[0]
        for frame, seen in enumerate(matches, start=1):
            for match in seen:
                value, slope, _ = match.slope(states[frame])
                total += share * value
                slopes_at[frame] += share * slope
        left.append(total)
        found = motion.gradient(pulls)
        slopes = Stiffness(found.distance.sum(axis=0), found.shape.sum(axis=0), 0.0)
        logits = adam.step(logits, bounds.by_logits(fields, slopes))
        fields = bounds.fields(logits, float(begun.volume))
    return fields, np.array(left)
