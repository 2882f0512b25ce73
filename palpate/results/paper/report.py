"""Tables (CSV) and figures (PNG) of an evaluation, from test records (Bini 2026, section 4)."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palpate.common.output import write_own
from palpate.data.contact.interaction import Interaction
from palpate.physics.mechanics import PARAMETERS, Bounds, Mechanics
from palpate.results.paper import simulated
from palpate.results.paper.figures import draw_response
from palpate.results.paper.statistics import as_reported, compare, spread_of, summarise

Record = Mapping[str, Any]

REFERENCE, PREDICTED, CONSTANT = "reference θ", "predicted θ", "constant θ"
REGIMES = {
    REFERENCE: "error_reference",
    PREDICTED: "error_predicted",
    CONSTANT: "error_constant",
    "mean of predicted θ": "error_mean_theta",
    "no motion": "error_no_motion",
}
"""Column of the table of frames by simulated parameters, in the order of tables."""
FILES = "figure3.png", "table_2.csv", "comparisons.csv", "depth.csv", "motion.csv", "spread.csv", "per_frame.csv"


class EvaluationError(ValueError):
    """The evaluation can't be computed; one sentence says what to do."""


@dataclass(frozen=True)
class Evaluation:
    """Everything measured on n test frames."""

    tables: dict[str, pd.DataFrame]
    """Tables by file. table_2.csv: errors of each regime [scene units²]; comparisons.csv: paired comparisons of the
    predicted θ with every other regime; depth.csv: mean |Δz| of next depth maps [scene units]; motion.csv: settling
    and peaks; spread.csv: spread of the estimates; per_frame.csv: a row a test frame, by clip and frame."""
    trajectories: np.ndarray
    """Displacement of the contact vertex under the predicted θ, shape [n, T, 3] [scene units]."""
    constant: np.ndarray
    """The constant θ, F signed, shape [3]; not a number without training contacts."""


def analyse(records: list[Record], training: list[Interaction], mechanics: Mechanics, bounds: Bounds) -> Evaluation:
    """Compute every number of the evaluation; see `write_evaluation` for the arguments.

    Raises:
        EvaluationError: there are no records.
    """
    if not records:
        raise EvaluationError("no test pair is in contact; check the split, and the preparation's counts by status.")
    records = sorted(records, key=lambda record: (record["clip"], record["frame"]))
    contacts = [
        Interaction(one["mesh"], one["load"], {"point": one["observation"]}, mechanics.time_step) for one in records
    ]
    names = "theta", "trajectory", "reference_trajectory"
    theta, predicted, reference = (np.array([record[name] for record in records], float) for name in names)
    # Columns by what is compared with the next depth map (the last: with the decoded one).
    depths = {"decoded next depth": "next_depth_error", "last frame repeated": "copy_error"}
    depths |= {"θ in the farthest corner of the box": "theta_sensitivity"}
    frames = pd.DataFrame(records, columns=["clip", "frame", *list(REGIMES.values())[:2], *depths.values()])
    frames[list(PARAMETERS)] = as_reported(theta, bounds)
    constant = simulated.fit_constant_theta(training, bounds, mechanics)[0]
    frames["error_constant"] = simulated.simulate_contacts(constant, contacts, mechanics)[1] if training else np.nan
    frames["error_mean_theta"] = simulated.simulate_contacts(theta.mean(axis=0), contacts, mechanics)[1]
    frames["error_no_motion"] = simulated.no_motion_errors(contacts, mechanics)
    clips, errors = frames["clip"], {name: frames[column] for name, column in REGIMES.items()}

    load_steps = np.array([contact.load.factor.sum().round() for contact in contacts], dtype=int)
    paths = {REFERENCE: reference, PREDICTED: predicted}
    settled = {name: simulated.settle(path, load_steps, mechanics) for name, path in paths.items()}
    shares = {name: {"median of highest peak": simulated.median_share(path)} for name, path in paths.items()}
    motion = {name: simulated.motion_row(settled[name]) | share for name, share in shares.items()}
    both = zip(clips, contacts, strict=True)
    motions = {(clip, one.observation.times.tobytes(), one.moved.tobytes()) for clip, one in both}
    compared = {name: compare(errors[PREDICTED], errors[name], clips) for name in errors if name != PREDICTED}
    tables: dict[str, dict[str, dict[str, Any]]] = {
        "table_2.csv": {name: summarise(values, clips) for name, values in errors.items()},
        "comparisons.csv": compared,
        "depth.csv": {name: summarise(frames[column], clips) for name, column in depths.items()},
        "motion.csv": motion,
    }
    found = {name: pd.DataFrame.from_dict(dict(rows), orient="index") for name, rows in tables.items()}
    found["spread.csv"] = spread_of(frames, bounds, len(motions)).assign(constant=as_reported(constant, bounds))
    found["per_frame.csv"] = frames.join(settled[PREDICTED]).set_index("clip")
    return Evaluation(found, predicted, constant)


def write_evaluation(
    records: list[Record], training: list[Interaction], mechanics: Mechanics, bounds: Bounds, output: Path
) -> dict[str, Path]:
    """Evaluate the test records and write the results into a folder.

    Args:
        records: one a test pair, as `models.records.pair_records` makes them.
        training: training contacts that the constant θ is fitted on.
        mechanics: constants of the rollout that made the trajectories.
        bounds: admissible box of θ.
        output: folder, created if needed; files of an earlier evaluation are replaced one by one, a user's never.

    Returns:
        Paths by name: all of FILES.

    Raises:
        EvaluationError: there are no records.
        ForeignFile: the folder holds a user's file of such a name.
    """
    found = analyse(records, training, mechanics, bounds)
    frames = found.tables["per_frame.csv"].reset_index()
    figure, buffer = draw_response(found.trajectories, frames["release_s"].to_numpy(), mechanics), io.BytesIO()
    figure.savefig(buffer, format="png")
    contents = {"figure3.png": buffer.getvalue()}
    contents |= {name: table.to_csv().encode() for name, table in found.tables.items()}
    output.mkdir(parents=True, exist_ok=True)
    for name, content in contents.items():
        write_own(output / name, content)
    return {name: output / name for name in FILES}
