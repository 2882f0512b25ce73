"""One method on one pull, as Liang 2024 judges it: Chamfer distance, future gap, keypoints, and its Table II.

PBD-DiffCloud fits fields of stiffness to the first frames together, in many epochs, as Liang 2024 compares it.
DiffCloud (Sundaresan 2022) simulates a training trajectory, compares it with its point clouds, and changes the
simulation's parameters by the gradient of the sum. Here the fields, their bounds and the optimiser are those of the
online estimator; tracks count where these are matched.
"""

import time
from collections.abc import Mapping
from typing import Literal

import numpy as np
import pandas as pd
from scipy.spatial import KDTree
from scipy.stats import spearmanr

from benchmarks.harness import Row
from benchmarks.online.sequences import Pull
from palpate.estimators.online.determined import Determined
from palpate.estimators.online.objective import Chamfer, Match, Objective
from palpate.estimators.online.sequence import PIXELS
from palpate.estimators.online.session import Adam, Method, Session
from palpate.physics.pbd.stiffness import Stiffness

Key = tuple[str, str, str]
"""Sequence, start and method."""
BATCH = "PBD-DiffCloud"
METHODS = ("PBD", BATCH, "PBD-RM", "PBD-RM-ON")
STARTS = {"k1": (5.0, 0.015), "k2": (1.0, 0.01), "k3": (0.2, 0.005)}
"""Stiffness of distances and shapes to begin with: the paper's (section III-B), shapes inside its own bound."""
Optimizer = Literal["adam", "gauss-newton"]
HORIZON = 10
"""Prediction horizon T [frames] (section III-D)."""
EPOCHS = 25
"""Epochs of the batch fit (section III-D)."""


def run_case(
    pull: Pull, start: tuple[float, float], name: str, match: str, every: int, optimizer: Optimizer = "gauss-newton"
) -> Row:
    """Track a pull, and predict from every `every`-th frame.

    Every method's gap is the residual mapping by k⁰ to the observations, even if the method doesn't use them.

    Args:
        pull: simulated sequence.
        start: stiffness of distances and shapes to begin with.
        name: one of `METHODS`.
        match: observations: chamfer (the cloud), tracks or both. A cloud alone doesn't show
            tissue that slides within its surface.
        every: frames from one prediction to the next.
        optimizer: optimizer of PBD-RM-ON; Gauss–Newton always uses tracks.

    Returns:
        Measures by name; T frames, J frames from which is predicted. `chamfer`: distance of the state to the cloud, the
        root of both ways' mean squared distances added, shape [T] [m] (equation 4 adds squares up, figure 5 has mm).
        `ahead`: those frames, [J]. `gap`: mean norm of the residual mapping 1 to 10 frames ahead (equation 10), [J]
        [m]. `keypoint`: mean error of predicted keypoints over 1 to 10 frames ahead, [J] [m]; equation 11 has that of
        the tenth. `rank`: Spearman's correlation of the last distance field with truth where tissue moves; NaN of a
        uniform field. `seconds`: median time of a step on one processor core.
    """
    body, frames = pull.body, len(pull.truth)
    objective = Objective(body, pull.gripped)
    fields = Stiffness(*(np.full(body.count, value) for value in start))
    method = Method("PBD" if name == BATCH else name, optimizer)  # ty: ignore[invalid-argument-type]: one of METHODS
    if name == BATCH:
        # The training trajectory has 30 frames (Liang 2024, section III-D).
        matches = [pull.matches(frame, match) for frame in range(min(30, frames))]
        fields, _ = fit_batch(objective, fields, pull.places[: len(matches)], matches, method.rate)
    session, learner = Session(objective, fields, method), None

    def moved(places: np.ndarray) -> np.ndarray:
        return PIXELS / body.edge * (places - pull.shares @ body.rest)

    if (method.name, optimizer) == ("PBD-RM-ON", "gauss-newton"):

        def shown(states: np.ndarray) -> np.ndarray:
            return np.stack([moved(pull.shares @ state) for state in states])

        learner = Determined(objective, fields, lambda values: pull.shares @ values, shown)
    nearest = KDTree(body.rest).query(pull.points[0, pull.keypoints])[1]
    chamfer, spent, ahead, rows = [], [], [], []
    for frame in range(frames):
        begun = time.process_time()
        state = session.step(pull.places[frame], pull.matches(frame, match))
        if learner is not None:
            learner.step(session.fields, pull.places[frame], moved(pull.tracks[frame]))
            session.fields = learner.likeliest(session.fields)
        spent.append(time.process_time() - begun)
        chamfer.append(np.sqrt(Chamfer(pull.clouds[frame], pull.visible).slope(state.positions)[0]))
        if frame % every == every - 1 and frame + HORIZON < frames:
            ahead.append(frame)
            states = session.ahead(pull.places[frame + 1 : frame + 1 + HORIZON])
            rows.append(_judged(pull, objective, states, frame, nearest, match))
    gap, keypoint = np.transpose(rows)
    moving, found = pull.moving(), session.fields.distance
    varied = np.ptp(found[moving]) > 1e-9
    rank = float(spearmanr(found[moving], pull.stiffness[moving]).statistic) if varied else float("nan")
    return {
        "chamfer": np.array(chamfer), "ahead": np.array(ahead), "gap": gap, "keypoint": keypoint, "rank": rank,
        "seconds": float(np.median(spent)),
    }  # fmt: skip


def fit_batch(
    objective: Objective, begun: Stiffness, places: np.ndarray, matches: list[list[Match]], rate: float
) -> tuple[Stiffness, np.ndarray]:
    """Fields after EPOCHS epochs.

    Args:
        objective: steps the body; its other terms don't count.
        begun: fields to begin with, shape [N].
        places: places of gripped particles in T frames, from rest on, shape [T, G, 3] [m].
        matches: observations of each frame.
        rate: Adam's, on logits.

    Returns:
        Fields, and the mean residual over frames before every epoch, shape [EPOCHS] [mean edges²]: Adam's guard has no
        unit.
    """
    body, bounds, adam, fields = objective.body, objective.bounds, Adam(rate), begun
    logits, left = bounds.logits(begun), []
    share = 1 / (len(matches) * body.edge**2)
    for _ in range(EPOCHS):
        motion = objective.stepped(fields, body.rest, places)
        pulls, total = np.zeros_like(motion.positions), 0.0
        states, slopes_at = motion.positions[0], pulls[0]
        for frame, observed in enumerate(matches, start=1):
            for match in observed:
                value, slope, _ = match.slope(states[frame])
                total += share * value
                slopes_at[frame] += share * slope
        left.append(total)
        slopes = Stiffness(*motion.gradient(pulls).total, 0.0)
        logits = adam.step(logits, bounds.by_logits(fields, slopes))
        fields = bounds.fields(logits, float(begun.volume))
    return fields, np.array(left)


def _judged(
    pull: Pull, objective: Objective, states: np.ndarray, frame: int, nearest: np.ndarray, match: str
) -> tuple[float, float]:
    """Gap and the keypoints' error of states [10, N, 3] after a frame."""
    gaps, off = [], []
    for at, state in enumerate(states, start=frame + 1):
        gaps.append(np.linalg.norm(objective.mapped(state, pull.matches(at, match)).deformation))
        moved = state[nearest] - pull.body.rest[nearest]
        true = pull.points[at + 1, pull.keypoints] - pull.points[0, pull.keypoints]
        off.append(np.linalg.norm(moved - true, axis=1).mean())
    return float(np.mean(gaps)), float(np.mean(off))


def table(cases: Mapping[tuple, Row]) -> pd.DataFrame:
    """Table II: future gap; keypoints' error [mm] of every method, by sequence and start."""
    columns = dict.fromkeys(key[:2] for key in cases)

    def cell(sequence: str, start: str, method: str) -> str:
        case = cases.get((sequence, start, method))
        return "" if case is None else f"{1e3 * case['gap'].mean():.1f}; {1e3 * case['keypoint'].mean():.2f}"

    cells = {", ".join(key): [cell(*key, method) for method in METHODS] for key in columns}
    return pd.DataFrame({"method": METHODS} | cells)
