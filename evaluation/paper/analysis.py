"""All numbers of an evaluation, from test records to what `evaluation.paper.report` writes (Bini 2026, section 4)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from palpate.data.contact.interaction import Interaction
from palpate.evaluation.paper import simulated, statistics
from palpate.evaluation.paper.statistics import SENTENCES, Statistics, compare, format_number, summarise
from palpate.physics.mechanics import PARAMETERS, REFERENCE_DAMPING, REFERENCE_STIFFNESS, Bounds, Mechanics

Record = Mapping[str, Any]

REFERENCE, PREDICTED, CONSTANT, NO_MOTION = "reference θ", "predicted θ", "constant θ", "no motion"
REGIMES = {
    REFERENCE: "error_reference",
    PREDICTED: "error_predicted",
    CONSTANT: "error_constant",
    "mean of predicted θ": "error_mean_theta",
    NO_MOTION: "error_no_motion",
}
"""Column of the table of frames by simulated parameters, in the order of tables."""
GIVEN = ["clip", "frame", "error_reference", "error_predicted", "next_depth_error", "copy_error", "theta_sensitivity"]
"""Columns of the table of frames that come from the records."""
CONDITION_SHARE = 0.05
"""Below this fraction of the change between frames, a change of θ hardly reaches the decoded picture."""


class EvaluationError(ValueError):
    """The evaluation can't be computed or written; one sentence says what to do."""


@dataclass(frozen=True)
class Evaluation:
    """Everything measured on the test frames."""

    frames: pd.DataFrame
    """One row a test frame, in order of clip and frame: parameters as reported, displacement errors by regime [scene
    units²], errors of the next depth map [scene units], settling of the predicted motion."""
    trajectories: np.ndarray
    """Displacement of the contact vertex under the predicted θ, shape [n, T, 3] [scene units]."""
    summaries: dict[str, Statistics]
    """Errors of each regime."""
    comparisons: dict[str, Statistics]
    """Paired comparisons of the predicted θ with every other regime."""
    depth: dict[str, Statistics]
    """Mean |Δz| of the decoded next depth map, of repeating the last frame, and of the decoded map when θ moves to the
    farthest corner of the admissible box; then the paired comparison of the first two."""
    motion: pd.DataFrame
    """Settling and peaks under the predicted and the reference θ in numbers."""
    spread: pd.DataFrame
    """Spread of the estimates by parameter."""
    constant: np.ndarray
    """The constant θ, F signed; not a number without training contacts."""
    training_error: float
    """Mean displacement error of the constant θ on the training contacts [scene units²]."""
    conclusion: str
    """Verdict on collapse and on the comparison with baselines, in one sentence."""
    sentences: tuple[str, ...]
    """All comparisons and definitions, in one sentence each."""


def describe_depth(depth: Mapping[str, Statistics]) -> str:
    """One sentence on how far θ changes the decoded picture."""
    moved, error, change = (depth[name]["mean"].value for name in ("sensitivity", "decoder", "copy"))
    share = moved / change if change else np.nan
    words = {"moved": format_number(moved), "share": format_number(100 * share), "error": format_number(error)}
    return SENTENCES["depth"].format(reaches="reaches" if share >= CONDITION_SHARE else "hardly reaches", **words)


def analyse_depth(frames: pd.DataFrame) -> dict[str, Statistics]:
    """Compare the decoder's next depth with the last frame, and how far θ moves it."""
    columns = {"decoder": "next_depth_error", "copy": "copy_error", "sensitivity": "theta_sensitivity"}
    found = {name: summarise(frames[column], frames["clip"]) for name, column in columns.items()}
    return found | {"comparison": compare(frames["next_depth_error"], frames["copy_error"], frames["clip"])}


def analyse(records: list[Record], training: list[Interaction], mechanics: Mechanics, bounds: Bounds) -> Evaluation:
    """Compute every number of the evaluation; see `evaluation.paper.report.write_evaluation` for the arguments.

    Raises:
        EvaluationError: there are no records.
    """
    if not records:
        raise EvaluationError(
            "no test pair is in contact, so there is nothing to evaluate; check the split and the counts by status "
            "that the data preparation prints."
        )
    records = sorted(records, key=lambda record: (record["clip"], record["frame"]))
    contacts = [Interaction(one["mesh"], one["load"], one["observation"], mechanics.time_step) for one in records]
    names = "theta", "trajectory", "reference_trajectory"
    theta, predicted, reference = (np.array([record[name] for record in records], float) for name in names)
    frames = pd.DataFrame(records, columns=GIVEN)
    frames[list(PARAMETERS)] = statistics.as_reported(theta, bounds)
    constant, training_error = simulated.fit_constant_theta(training, bounds, mechanics)
    frames["error_constant"] = simulated.simulate_contacts(constant, contacts, mechanics)[1] if training else np.nan
    frames["error_mean_theta"] = simulated.simulate_contacts(theta.mean(axis=0), contacts, mechanics)[1]
    frames["error_no_motion"] = simulated.no_motion_errors(contacts, mechanics)
    clips, errors = frames["clip"], {name: frames[column] for name, column in REGIMES.items()}
    comparisons = {name: compare(errors[PREDICTED], errors[name], clips) for name in errors if name != PREDICTED}
    depth = analyse_depth(frames)

    load_steps = np.array([contact.load.factor.sum().round() for contact in contacts], dtype=int)
    paths = {REFERENCE: reference, PREDICTED: predicted}
    settled = {name: simulated.settle(path, load_steps, mechanics) for name, path in paths.items()}
    motion = {name: simulated.motion_row(each) for name, each in settled.items()}
    for name, path in paths.items():
        motion[name]["median of highest peak"] = simulated.median_share(path)

    motions = [(one.observation.times.tobytes(), one.moved.tobytes()) for one in contacts]
    observed = set(zip(clips, motions, strict=True))
    spread = statistics.spread_of(frames, bounds, len(observed))
    return Evaluation(
        frames=frames.join(settled[PREDICTED]),
        trajectories=predicted,
        summaries={name: summarise(values, clips) for name, values in errors.items()},
        comparisons=comparisons,
        depth=depth,
        motion=pd.DataFrame.from_dict(motion, orient="index"),
        spread=spread,
        constant=constant,
        training_error=training_error,
        conclusion=statistics.conclude(spread, comparisons[CONSTANT], comparisons[REFERENCE]),
        sentences=(
            *(statistics.describe(found, "The predicted θ", name) for name, found in comparisons.items()),
            statistics.describe(depth["comparison"], "The decoder's next depth map", "repeating the last frame"),
            describe_depth(depth),
            SENTENCES["amounts"].format(frames=len(frames), observed=len(observed)),
            SENTENCES["definitions"].format(stiffness=REFERENCE_STIFFNESS, damping=REFERENCE_DAMPING),
        ),
    )
