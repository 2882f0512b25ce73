"""Writes an evaluation as files: tables (Markdown, CSV), figures (PNG), all numbers (JSON) and one HTML page."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from evaluation.analysis import CONSTANT, MEAN, NO_MOTION, PREDICTED, REFERENCE, Evaluation, Record, analyse
from evaluation.baselines import Case, ConstantThetaSettings
from evaluation.figures import draw_response, draw_theta
from evaluation.page import render_page, versions
from evaluation.settling import summarise_settling
from evaluation.statistics import SIGNIFICANCE
from evaluation.tables import (
    PAPER_TABLE2,
    Cell,
    Table,
    comparison_table,
    error_table,
    long_table,
    settling_table,
    spread_rows,
    spread_table,
)
from physics.mechanics import Bounds, Mechanics

FORMAT_VERSION = 1
"""Version of `evaluation.json`."""


class EvaluationError(ValueError):
    """The evaluation can't be computed or written; one sentence says what to do."""


def write_evaluation(
    records: Sequence[Record],
    train_cases: Sequence[Case],
    mechanics: Mechanics,
    bounds: Bounds,
    output: Path,
    settings: ConstantThetaSettings | None = None,
) -> dict[str, Path]:
    """Evaluate the test records and write the results into a folder.

    Args:
        records: one mapping a test pair with `clip`, `frame`, `theta` [3] (k_s, k_d, signed F), `trajectory` and
            `reference_trajectory` [T, 3] [scene units], `observation` (`steps` [M], `displacement` [M, 3] [scene
            units], `weight` [M]), `load_steps`, `error_predicted`, `error_reference` [scene units²],
            `next_depth_error`, `copy_error`, `theta_sensitivity` (mean |Δz| [scene units]), and `case` (`mesh`:
            physics.mesh.Mesh, `vertex`, `direction` [3]). Without `case` the simulated baselines are reported missing.
        train_cases: training contacts, see `evaluation.baselines.Case`.
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
        evaluation = analyse(records, train_cases, mechanics, bounds, settings)
    except ValueError as error:
        raise EvaluationError(str(error)) from error
    made = datetime.now(UTC).replace(microsecond=0)
    tables, figures = _tables(evaluation), _figures(evaluation)
    files: dict[str, bytes] = {
        "table2.md": _markdown(
            "Simulation error", evaluation, (tables["errors"], tables["tests"], tables["regularity"])
        ),
        "table2.csv": long_table(evaluation.summaries, evaluation.comparisons).to_csv().encode(),
        "collapse.md": _markdown("Collapse check", evaluation, (tables["spread"], tables["constant"], tables["depth"])),
        "collapse.csv": spread_rows(evaluation.check).to_csv().encode(),
        "settling.csv": settling_rows(evaluation).to_csv().encode(),
        "per_frame.csv": frame_rows(evaluation).to_csv().encode(),
        "figure3.png": figures["figure3.png"],
        "theta.png": figures["theta.png"],
        "report.html": render_page(evaluation, tables, figures, mechanics, bounds, made).encode(),
        "evaluation.json": evaluation_json(evaluation, mechanics, bounds, made).encode(),
    }
    try:
        output.mkdir(parents=True, exist_ok=True)
        return {name: _write(output / name, content) for name, content in files.items()}
    except OSError as error:
        raise EvaluationError(
            f"{output}: the evaluation can't be written ({error.strerror}); choose a folder that is "
            "writable and has space."
        ) from error


def _write(path: Path, content: bytes) -> Path:
    """Write under a temporary name, then rename, so that no reader sees half a file."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        temporary.write_bytes(content)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def _markdown(title: str, evaluation: Evaluation, tables: Sequence[Table]) -> bytes:
    parts = [f"# {title}", "", f"**{evaluation.conclusion}**", ""]
    sentences = (*evaluation.sentences, *evaluation.next_depth.sentences, *evaluation.missing)
    parts += [*(f"- {sentence}" for sentence in sentences), ""]
    return "\n".join([*parts, *(table.to_markdown() for table in tables)]).encode()


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _figures(evaluation: Evaluation) -> dict[str, bytes]:
    constant = None if evaluation.constant is None else evaluation.constant.theta
    return {
        "figure3.png": _png(draw_response(evaluation.response)),
        "theta.png": _png(draw_theta(evaluation.series, constant)),
    }


def _tables(evaluation: Evaluation) -> dict[str, Table]:
    """Tables for reading, by name."""
    order = [name for name in (REFERENCE, PREDICTED, CONSTANT, MEAN, NO_MOTION) if name in evaluation.summaries]
    notes = [
        "reference θ: k_s = 5.34, k_d = 0.127 from the literature, the same F and all else identical; constant θ: "
        "fitted on the training cases; mean of predicted θ: its mean over the test frames; no motion: F = 0.",
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
    rows = tuple(
        (name, r.frames, r.not_finite, r.leaves_scene, f"{r.chaotic} of {r.checked}" if r.checked else "not checked")
        for name, r in evaluation.regularity.items()
    )
    return Table(
        "Can the simulations be believed?",
        ("simulation", "frames", "not finite", "peak over 1 scene unit", "chaotic, of those checked"),
        rows,
        (
            "Chaotic: changing F by 1e-4 of itself moves the trajectory by over 100 times that, relative to its peak.",
            "A peak over 1 scene unit is a displacement larger than the scene is deep.",
        ),
    )


def _constant_table(evaluation: Evaluation) -> Table:
    constant = evaluation.constant
    if constant is None:
        return Table(
            "Constant θ fitted on the training cases", ("quantity", "value"), (("fitted", "no training cases"),)
        )
    rows: tuple[tuple[Cell, ...], ...] = (
        ("k_s [normalised]", constant.theta[0]),
        ("k_d [normalised]", constant.theta[1]),
        ("F [normalised], negative presses into the tissue", constant.theta[2]),
        ("mean error on the training cases used [scene units²]", constant.training_error),
        ("training cases used", f"{constant.cases_used} of {constant.cases_available}"),
        ("evaluations (not finite)", f"{constant.evaluations} ({constant.not_finite})"),
    )
    return Table("Constant θ fitted on the training cases", ("quantity", "value"), rows)


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


def settling_rows(evaluation: Evaluation) -> Table:
    """Settling of every test frame under the predicted and the reference θ, for CSV."""
    rows = tuple(
        (str(clip), int(frame), name, s.state, s.after_release_s, s.release_s, s.peak, s.end_fraction)
        for name, values in evaluation.settling.items()
        for clip, frame, s in zip(evaluation.clips, evaluation.frames, values, strict=True)
    )
    columns = ("clip", "frame", "simulation", "state", "settling_time_s", "release_s", "peak", "end_fraction_of_peak")
    return Table("Settling time", columns, rows)


def frame_rows(evaluation: Evaluation) -> Table:
    """One row a test frame, for CSV: |F|, errors by regime, next-depth errors, peak and settling."""
    names = {
        REFERENCE: "reference",
        PREDICTED: "predicted",
        CONSTANT: "constant",
        MEAN: "mean_theta",
        NO_MOTION: "no_motion",
    }
    errors = {f"error_{short}": evaluation.errors[name] for name, short in names.items() if name in evaluation.errors}
    numbers = {**errors, **evaluation.next_depth_errors}
    rows = []
    for i, (clip, frame) in enumerate(zip(evaluation.clips, evaluation.frames, strict=True)):
        stiffness, damping, force = map(float, evaluation.theta[i])
        settled = evaluation.settling[PREDICTED][i]
        values = [_finite(float(column[i])) for column in numbers.values()]
        rows.append(
            (str(clip), int(frame), stiffness, damping, abs(force), *values, settled.peak, settled.after_release_s,
             settled.state)
        )  # fmt: skip
    columns = (
        "clip",
        "frame",
        "stiffness",
        "damping",
        "force",
        *numbers,
        "peak_displacement",
        "settling_time_s",
        "settling",
    )
    return Table("Per frame", columns, tuple(rows))


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
