"""The motion of followed points under an instrument whose way is known, by two models, each with what it has missed.

The models are the field of stiffness place by place, and a sheet of one number (`physics.sheet`). What a linear model
misses grows with the instrument's way. By which share of that, the frames so far say, of which later ones are predicted
from earlier ones; they also say which model predicts better, and that one is used.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from palpate.estimators.grip.lattice import LEAST_MOTION, GripFrame, NothingMoves, lattice_springs, length
from palpate.physics.sheet import equilibrium

FIELD, SHEET = "field", "sheet of one number"
RATIOS = np.geomspace(1e-4, 1, 17)
"""Of foundation to springs that a sheet of one number is tried with."""
MOST_FRAMES = 8
"""So many frames, evenly spread, say how well models predict: the motion grows steadily, and sheets take time."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """Followed points as the nodes of a sheet; P points."""

    points: np.ndarray
    """Places in the first frame, shape [P, 2] [px]."""
    spacing: int
    """Of their grid [px]."""
    distance: np.ndarray
    """From the tool there, shape [P] [px]."""

    def ratio(self, frames: Sequence[GripFrame]) -> float:
        """Foundation over spring stiffness, of RATIOS, with which a sheet explains some frames best near the tool.

        Least mean of error over motion of the nearest third of the points, in frames where these move:
        docs/reports/real.md.

        Raises:
            NothingMoves: they do in none.
        """
        shown = [(frame, self.nearby(frame)) for frame in frames]
        shown = [(frame, near) for frame, near in shown if near.gripped.any() and near.around.any()]
        shown = [(frame, near) for frame, near in shown if length(near.moved[near.around]) > LEAST_MOTION]
        if not shown:
            raise NothingMoves(
                f"In none of {len(frames)} frames the tissue near the tool moves by {LEAST_MOTION:g} px."
            )

        def off(ratio: float) -> float:
            errors = [
                length((self.motion(frame, ratio) - frame.moved)[near.around]) / length(frame.moved[near.around])
                for frame, near in shown
            ]
            return float(np.mean(errors))

        return float(min(RATIOS, key=off))

    def motion(self, frame: GripFrame, ratio: float) -> np.ndarray:
        """Displacement [P, 2] [px] of a sheet of one number whose gripped points move as in a frame.

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
        """The frame with those points around the grip alone that began close to the tool, or with all if none did."""
        around = frame.around
        # Nearby points began nearer to the tool than this percentile of those that are followed [%].
        nearby = around & (self.distance < np.percentile(self.distance[around | frame.gripped], 35.0))
        shown = frame.gripped | (nearby if nearby.any() else around)
        return replace(frame, moved=np.where(shown[:, None], frame.moved, np.nan))


@dataclass(frozen=True, eq=False)
class Forecast:
    """What is expected of Q points in T frames to come."""

    since: np.ndarray
    """Their motion since the last frame, shape [T, Q, 2] [px]."""
    model: str
    """By which: FIELD or SHEET, whichever predicts better."""
    skills: Mapping[str, float]
    """1 - error / motion of each model's predictions of frames so far; not a number where there are no two of them."""


def telling(past: int) -> np.ndarray:
    """Which of so many frames so far say how well models predict, the last one among them."""
    return np.unique(np.linspace(past - 1, 0, min(past, MOST_FRAMES)).round().astype(int))


def forecast(models: Mapping[str, np.ndarray], seen: np.ndarray, way: np.ndarray) -> Forecast:
    """What is to come, by the model that predicts the frames so far best.

    Args:
        models: by name the displacement of Q points in H frames so far and T to come, [H + T, Q, 2] [px].
        seen: what was observed in the former, shape [H, Q, 2] [px]; not observed = NaN, which counts as no miss.
        way: how far the instrument has moved the tissue, shape [H + T], in any unit.
    """
    told = {name: _carried_on(model, seen, way) for name, model in models.items()}
    skills = {name: skill for name, (skill, _) in told.items()}
    best = max(skills, key=lambda name: -np.inf if np.isnan(skills[name]) else skills[name])
    return Forecast(told[best][1], best, skills)


def _carried_on(model: np.ndarray, seen: np.ndarray, way: np.ndarray) -> tuple[float, np.ndarray]:
    """A model's skill in the frames so far, and what it expects of those to come, with its share of what it missed."""
    past = len(seen)
    missed = seen - model[:past]
    pairs = [(one, other) for one, other in combinations(range(past), 2) if way[one] > 0]
    grown, more, moved = [], [], []
    for one, other in pairs:
        both = np.isfinite(missed[one] + missed[other]).all(axis=1)
        grown.append((way[other] / way[one] - 1) * missed[one][both])
        more.append((missed[other] - missed[one])[both])
        moved.append((seen[other] - seen[one])[both])
    growth, change, motion = (np.concatenate([np.zeros((1, 2)), *each]) for each in (grown, more, moved))
    share = float(np.clip((growth * change).sum() / max(np.square(growth).sum(), 1e-12), 0, 1))
    whole = np.square(motion).sum()
    skill = 1 - float(np.sqrt(np.square(change - share * growth).sum() / whole)) if whole > 0 else np.nan
    further = way[past:] / way[past - 1] - 1 if way[past - 1] > 0 else np.zeros(len(way) - past)
    return skill, model[past:] - model[past - 1] + share * further[:, None, None] * np.nan_to_num(missed[-1])
