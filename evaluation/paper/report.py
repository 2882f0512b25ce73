"""Writes an evaluation as files: tables (Markdown, CSV), figures (PNG), all numbers (JSON) and one HTML page."""

from __future__ import annotations

import dataclasses
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from data.contact.interaction import Interaction
from evaluation.paper.analysis import CONSTANT, MEAN, NO_MOTION, PREDICTED, REFERENCE, Evaluation, Record, analyse
from evaluation.paper.baselines import ConstantThetaSettings
from evaluation.paper.figures import draw_response, draw_theta
from evaluation.paper.page import bullets, render_page, versions
from evaluation.paper.settling import summarise_settling
from evaluation.paper.statistics import SIGNIFICANCE
from evaluation.paper.tables import (
    PAPER_TABLE2,
    Cell,
    Table,
    comparison_table,
    error_table,
    settling_table,
    spread_rows,
    spread_table,
    statistic_rows,
)
from evaluation.tables import to_csv
from physics.files import replacing
from physics.mechanics import PARAMETERS, Bounds, Mechanics

FORMAT_VERSION = 1
"""Version of `evaluation.json`."""
REGIMES = {
    REFERENCE: "reference",
    PREDICTED: "predicted",
    CONSTANT: "constant",
    MEAN: "mean_theta",
    NO_MOTION: "no_motion",
}
"""Regimes in the order of tables, as columns name them."""


class EvaluationError(ValueError):
    """The evaluation can't be computed or written; one sentence says what to do."""


def write_evaluation(
    records: Sequence[Record],
    training: Sequence[Interaction],
    mechanics: Mechanics,
    bounds: Bounds,
    output: Path,
    settings: ConstantThetaSettings | None = None,
) -> dict[str, Path]:
    """Evaluate the test records and write the results into a folder.

    Args:
        records: one a test pair, as `models.records.pair_records` makes them.
        training: training contacts.
        mechanics: constants of the rollout that made the trajectories.
        bounds: admissible box of θ.
        output: folder, created if needed; files of an earlier evaluation are replaced one by one.
        settings: budget of the constant-θ fit.

    Returns:
        Paths by name: table2.md, table2.csv, collapse.md, collapse.csv, settling.csv, figure3.png, theta.png,
        per_frame.csv, report.html, evaluation.json.

    Raises:
        EvaluationError: there are no records, or the folder can't be written.
    """
    try:
        evaluation = analyse(records, training, mechanics, bounds, settings)
    except ValueError as error:
        raise EvaluationError(str(error)) from error
    made = datetime.now(UTC).replace(microsecond=0)
    tables = _tables(evaluation)
    constant = None if evaluation.constant is None else evaluation.constant.theta
    figures = {
        "figure3.png": _png(draw_response(evaluation.response)),
        "theta.png": _png(draw_theta(evaluation.series, constant)),
    }
    texts = {
        "table2.md": _markdown("Simulation error", evaluation, tables, ("errors", "tests", "regularity")),
        "table2.csv": to_csv(statistic_rows(evaluation.summaries, evaluation.comparisons)),
        "collapse.md": _markdown("Collapse check", evaluation, tables, ("spread", "constant", "depth")),
        "collapse.csv": to_csv(spread_rows(evaluation.check)),
        "settling.csv": to_csv(list(settling_rows(evaluation))),
        "per_frame.csv": to_csv(list(frame_rows(evaluation))),
        "report.html": render_page(evaluation, tables, figures, mechanics, bounds, made),
        "evaluation.json": evaluation_json(evaluation, mechanics, bounds, made),
    }
    try:
        output.mkdir(parents=True, exist_ok=True)
        for name, content in (figures | {name: text.encode() for name, text in texts.items()}).items():
            with replacing(output / name) as partial:
                partial.write_bytes(content)
        return {name: output / name for name in (*figures, *texts)}
    except OSError as error:
        raise EvaluationError(
            f"{output}: the evaluation can't be written ({error.strerror}); choose a folder that is "
            "writable and has space."
        ) from error


def _markdown(title: str, evaluation: Evaluation, tables: Mapping[str, Table], names: Sequence[str]) -> str:
    sentences = (*evaluation.sentences, *evaluation.next_depth.sentences, *evaluation.missing)
    shown = "\n".join(tables[name].to_markdown() for name in names)
    return f"# {title}\n\n**{evaluation.conclusion}**\n\n{bullets(sentences)}\n{shown}"


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _tables(evaluation: Evaluation) -> dict[str, Table]:
    """Tables for reading, by name."""
    order = [name for name in REGIMES if name in evaluation.summaries]
    notes = [
        "reference θ: k_s = 5.34, k_d = 0.127 from the literature, the same F and all else identical; constant θ: "
        "fitted on the training contacts; mean of predicted θ: its mean over the test frames; no motion: F = 0.",
        *(
            f"{name}: {count} of {len(values)} errors are not finite and left out of its column."
            for name, values in evaluation.errors.items()
            if (count := int(np.count_nonzero(~np.isfinite(values))))
        ),
        *evaluation.missing,
        PAPER_TABLE2,
    ]
    return {
        "errors": error_table({name: evaluation.summaries[name] for name in order}, notes),
        "tests": comparison_table({f"vs {name}": value for name, value in evaluation.comparisons.items()}),
        "regularity": _regularity_table(evaluation),
        "spread": spread_table(evaluation.check),
        "constant": _constant_table(evaluation),
        "depth": _depth_table(evaluation),
        "settling": settling_table({name: summarise_settling(values) for name, values in evaluation.settling.items()}),
    }


def _regularity_table(evaluation: Evaluation) -> Table:
    return Table(
        "Can the simulations be believed?",
        ("simulation", "frames", "not finite", "peak over 1 scene unit", "chaotic, of those checked"),
        [
            (name, r.frames, r.not_finite, r.leaves_scene, f"{r.chaotic} of {r.checked}")
            for name, r in evaluation.regularity.items()
        ],
        (
            "Chaotic: changing F by 1e-4 of itself moves the trajectory by over 100 times that, relative to its peak.",
            "A peak over 1 scene unit is a displacement larger than the scene is deep.",
        ),
    )


def _constant_table(evaluation: Evaluation) -> Table:
    constant = evaluation.constant
    rows: list[tuple[str, Cell]] = [("fitted", "no training contacts")]
    if constant is not None:
        rows = [
            ("k_s [normalised]", constant.theta[0]),
            ("k_d [normalised]", constant.theta[1]),
            ("F [normalised], negative presses into the tissue", constant.theta[2]),
            ("mean error on the training contacts used [scene units²]", constant.training_error),
            ("training contacts used", f"{constant.contacts_used} of {constant.contacts_available}"),
            ("evaluations (not finite)", f"{constant.evaluations} ({constant.not_finite})"),
        ]
    return Table("Constant θ fitted on the training contacts", ("quantity", "value"), rows)


def _depth_table(evaluation: Evaluation) -> Table:
    result = evaluation.next_depth
    columns = {
        "decoder": result.decoder,
        "repeat the last frame": result.copy,
        "change when θ moves": result.sensitivity,
    }
    table = error_table(columns)
    rows = tuple((str(row[0]).replace("MSE", "mean |Δz|"), *row[1:]) for row in table.rows)
    w, p = result.comparison.wilcoxon_w, result.comparison.wilcoxon_p
    test = result.comparison.notes.get("wilcoxon_w") if w is None or p is None else f"W = {w:.6g}, p = {p:.2g}"
    return Table(
        "Next depth map: mean absolute error [scene units]",
        table.columns,
        rows,
        (
            f"Decoder against repeating the last frame, Wilcoxon signed-rank: {test} (threshold {SIGNIFICANCE}).",
            "Change when θ moves: mean |Δz| of the decoded map when θ moves to the box's farthest corner.",
        ),
    )


def settling_rows(evaluation: Evaluation) -> Iterator[dict[str, Cell]]:
    """Settling of every test frame under the predicted and the reference θ."""
    for name, values in evaluation.settling.items():
        for clip, frame, settled in zip(evaluation.clips, evaluation.frames, values, strict=True):
            yield {
                "clip": str(clip),
                "frame": int(frame),
                "simulation": name,
                "state": settled.state,
                "settling_time_s": settled.after_release_s,
                "release_s": settled.release_s,
                "peak": settled.peak,
                "end_fraction_of_peak": settled.end_fraction,
            }


def frame_rows(evaluation: Evaluation) -> Iterator[dict[str, Cell]]:
    """One row a test frame: |F|, errors by regime, next-depth errors, peak and settling."""
    errors = {f"error_{short}": evaluation.errors[name] for name, short in REGIMES.items() if name in evaluation.errors}
    columns = errors | evaluation.next_depth_errors
    for i, settled in enumerate(evaluation.settling[PREDICTED]):
        yield {
            "clip": str(evaluation.clips[i]),
            "frame": int(evaluation.frames[i]),
            **dict(zip(PARAMETERS, np.abs(evaluation.theta[i]).tolist(), strict=True)),
            **{name: _finite(float(values[i])) for name, values in columns.items()},
            "peak_displacement": settled.peak,
            "settling_time_s": settled.after_release_s,
            "settling": settled.state,
        }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plain(value: Any) -> Any:
    """JSON's own types; numbers that aren't finite become null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {item.name: _plain(getattr(value, item.name)) for item in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return _finite(value) if isinstance(value, float) else value


def evaluation_json(evaluation: Evaluation, mechanics: Mechanics, bounds: Bounds, made: datetime) -> str:
    """All numbers of the evaluation as one JSON document, with what the two figures draw."""
    content = {
        "format_version": FORMAT_VERSION,
        "made": made.isoformat(),
        "versions": versions(),
        "units": {
            "stiffness": "normalised, not N/m",
            "damping": "normalised, not N·s/m",
            "force": "normalised, not N; signed, negative presses into the tissue",
            "error": "scene units²",
            "depth_error": "scene units",
            "time": "s",
        },
        "mechanics": mechanics,
        "bounds": bounds,
        "evaluation": evaluation,
        "settling_summary": {name: summarise_settling(values) for name, values in evaluation.settling.items()},
    }
    return json.dumps(_plain(content), ensure_ascii=False, allow_nan=False) + "\n"
