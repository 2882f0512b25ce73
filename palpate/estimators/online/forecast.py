"""Skill of predicting later frames from earlier ones, by the field of stiffness and by a sheet of one number.

The field counts only where it predicts better than the sheet (`physics.sheet`). What a linear model misses grows with
the instrument's way.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from palpate.estimators.grip.lattice import LEAST_MOTION, GripFrame, NothingMoves, lattice_springs, length
from palpate.physics.sheet import equilibrium

FIELD, SHEET = "field", "sheet of one number"
RATIOS = np.geomspace(1e-4, 1, 17)
"""Ratios of foundation to springs that a sheet of one number is tried with."""
MOST_FRAMES = 8
"""Number of frames, evenly spread, on which predictions are judged: the motion grows steadily, and sheets take time."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """Followed points as the nodes of a sheet; P points."""

    points: np.ndarray
    """Places in the first frame, shape [P, 2] [px]."""
    spacing: int
    """Spacing of their grid [px]."""
    distance: np.ndarray
    """Distance from the tool there, shape [P] [px]."""

    def ratio(self, frames: Sequence[GripFrame]) -> float:
        """Return the ratio of foundation to springs, of RATIOS, with which a sheet explains some frames best near the
        tool.

        Least mean of error over motion of the nearest third of the points, in frames where these move:
        docs/reports/real.md.

        Raises:
            NothingMoves: they do in none.
        """
        shown = [(frame, self.nearby(frame)) for frame in frames]
        shown = [(frame, near) for frame, near in shown if near.gripped.any() and near.around.any()]
        shown = [(frame, near) for frame, near in shown if length(near.moved[near.around]) > LEAST_MOTION]
        if not shown:
            raise NothingMoves(f"Tissue near the tool moves by {LEAST_MOTION:g} px in none of {len(frames)} frames.")
        moves = [length(near.moved[near.around]) for _, near in shown]

        def off(ratio: float) -> float:
            errors = [length((self.motion(frame, ratio) - frame.moved)[near.around]) for frame, near in shown]
            return float(np.mean(np.divide(errors, moves)))

        return float(min(RATIOS, key=off))

    def motion(self, frame: GripFrame, ratio: float) -> np.ndarray:
        """Return the displacement [P, 2] [px] of a sheet of one number whose gripped points move as in a frame.

        It is made of the points that are in view; elsewhere not a number.
        """
        visible = np.isfinite(frame.moved).all(axis=1)
        springs = lattice_springs(self.points[visible].astype(int), self.spacing)
        gripped, count = frame.gripped[visible], int(visible.sum())
        found = np.full(frame.moved.shape, np.nan)
        alike = np.ones(len(springs)), np.full(count, ratio)
        found[visible] = equilibrium(springs, *alike, gripped, frame.moved[frame.gripped]).displacement
        return found

    def nearby(self, frame: GripFrame) -> GripFrame:
        """Return the frame with those points around the grip alone that began close to the tool, or with all if none
        did."""
        around = frame.around
        # Nearby points began nearer to the tool than this percentile of those that are followed [%].
        nearby = around & (self.distance < np.percentile(self.distance[around | frame.gripped], 35.0))
        shown = frame.gripped | (nearby if nearby.any() else around)
        return replace(frame, moved=np.where(shown[:, None], frame.moved, np.nan))


def telling(past: int) -> np.ndarray:
    """Return indices of the frames so far on which predictions are judged, the last one among them."""
    return np.unique(np.linspace(past - 1, 0, min(past, MOST_FRAMES)).round().astype(int))


def prediction_skill(model: np.ndarray, seen: np.ndarray, way: np.ndarray) -> float:
    """Return the skill, 1 - error / motion, of later frames predicted from earlier ones; NaN where there are no two of
    them.

    What the model missed in the earlier frame grows with the instrument's way, by one share of that in all pairs.

    Args:
        model: displacement of Q points in H frames, shape [H, Q, 2] [px].
        seen: what was observed, shape [H, Q, 2] [px]; not observed = NaN, which counts as no miss.
        way: how far the instrument has moved the tissue, shape [H], in any unit.
    """
    missed = seen - model
    grown, more, moved = [], [], []
    for one, other in combinations(range(len(seen)), 2):
        if way[one] > 0:
            both = np.isfinite(missed[one] + missed[other]).all(axis=1)
            grown.append((way[other] / way[one] - 1) * missed[one][both])
            more.append((missed[other] - missed[one])[both])
            moved.append((seen[other] - seen[one])[both])
    growth, change, motion = (np.concatenate([np.zeros((1, 2)), *each]) for each in (grown, more, moved))
    share = float(np.clip((growth * change).sum() / max(np.square(growth).sum(), 1e-12), 0, 1))
    whole = np.square(motion).sum()
    return 1 - float(np.sqrt(np.square(change - share * growth).sum() / whole)) if whole > 0 else np.nan
