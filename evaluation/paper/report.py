"""Writes an evaluation as files: tables (Markdown, CSV), figures (PNG), all numbers (JSON) and one HTML page."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd
import torch
import yaml

from palpate.common.files import as_json
from palpate.common.output import ForeignFile, write_own
from palpate.common.tables import to_markdown
from palpate.data.contact.interaction import Interaction
from palpate.evaluation.page import as_png, render_page
from palpate.evaluation.paper.analysis import NO_MOTION, Evaluation, EvaluationError, Record, analyse
from palpate.evaluation.paper.figures import draw_response, draw_theta
from palpate.evaluation.paper.statistics import MINIMUM_FOR_WILCOXON, SIGNIFICANCE, Statistics, as_reported
from palpate.evaluation.paper.statistics import format_number as shown
from palpate.physics.mechanics import PARAMETERS, Bounds, Mechanics
from palpate.results.record import versions

FILES = ("figure3.png", "theta.png", "per_frame.csv", "report.html", "evaluation.json")
FORMAT_VERSION = 3
"""Version of `evaluation.json`."""
TEXTS: dict[str, dict[str, str]] = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
"""Lines of tables, and units."""
ERRORS, COMPARISONS = TEXTS["errors"], TEXTS["comparisons"]
ESTIMATES = ("mean", "SD", "lowest", "highest", "lower bound", "upper bound")
"""Columns of the first table of estimates."""
TITLE = "Evaluation of the estimated tissue parameters"


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
        EvaluationError: there are no records, the folder can't be written, or holds a user's file of such a name.
    """
    try:
        found = analyse(records, training, mechanics, bounds)
    except ValueError as error:
        raise EvaluationError(str(error)) from error
    made = datetime.now(UTC).replace(microsecond=0)
    figures = {
        "figure3.png": as_png(draw_response(found.trajectories, found.frames["release_s"].to_numpy(), mechanics)),
        "theta.png": as_png(draw_theta(found.frames, found.spread, as_reported(found.constant, bounds))),
    }
    texts = {
        "per_frame.csv": found.frames.to_csv(index=False),
        "report.html": render_page(TITLE, page_text(found, len(training), mechanics, bounds, made), figures),
        "evaluation.json": evaluation_json(found, mechanics, bounds, made),
    }
    try:
        output.mkdir(parents=True, exist_ok=True)
        for name, content in (figures | {name: text.encode() for name, text in texts.items()}).items():
            write_own(output / name, content)
        return {name: output / name for name in FILES}
    except ForeignFile as error:
        raise EvaluationError(str(error)) from error
    except OSError as error:
        raise EvaluationError(
            f"{output}: the evaluation can't be written ({error.strerror}); choose a folder with space."
        ) from error


def _table(table: pd.DataFrame) -> str:
    """Markdown of a table, whose rows are named by its index."""
    rows = [[shown(cell) for cell in row] for row in table.itertuples()]
    return to_markdown(["", *table.columns], rows)


def _shares(errors: Mapping[str, float]) -> dict[str, float]:
    """Errors as shares [%] of the error without motion; not a number where nothing moved."""
    return {name: 100 * error / (errors[NO_MOTION] or math.nan) for name, error in errors.items()}


def _filled(lines: Mapping[str, str], columns: Mapping[str, Statistics]) -> pd.DataFrame:
    """Table of statistics for reading, with a column for each; a line is a label and a template."""
    cells = {name: [text.format(**found) for text in lines.values()] for name, found in columns.items()}
    return pd.DataFrame(cells, index=list(lines))


def reading_tables(found: Evaluation) -> dict[str, pd.DataFrame]:
    """Tables for reading, by their names in the page."""
    constant = dict(zip(PARAMETERS, found.constant, strict=True))
    constant["mean error on these contacts [scene units²]"] = found.training_error
    errors = {name: summary["mean"].value for name, summary in found.summaries.items()}
    estimates = found.spread[["mean", "sd", "minimum", "maximum", "low", "high"]].set_axis(ESTIMATES, axis="columns")
    comparisons = {f"vs {name}": comparison for name, comparison in found.comparisons.items()}
    fit = {"mean squared error [scene units²]": errors, "of that without motion [%]": _shares(errors)}
    return {
        "fit": pd.DataFrame(fit),
        "estimates": estimates,
        "errors": _filled(ERRORS, found.summaries),
        "tests": _filled(COMPARISONS, comparisons),
        "motion": found.motion,
        "spread": found.spread.rename(columns=lambda name: name.replace("_", " ")),
        "constant": pd.DataFrame({"value": constant}),
        "depth": _filled(ERRORS, {label: found.depth[name] for name, label in TEXTS["depth"].items()}),
    }


def page_text(found: Evaluation, contacts: int, mechanics: Mechanics, bounds: Bounds, made: datetime) -> str:
    """The page as Markdown: the conclusion, what was found with its figures, then every comparison and its grounds.

    Args:
        found: all numbers.
        contacts: how many the constant θ was fitted on.
        mechanics, bounds, made: how and when they were made.
    """
    frames, clips = len(found.frames), found.frames["clip"].nunique()
    template = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    return template.format(
        title=TITLE,
        made=made,
        conclusion=f"> {found.conclusion}",
        sentences="\n".join(f"- {sentence}" for sentence in found.sentences),
        amounts=f"{frames} test frame{'s' * (frames != 1)} of {clips} clip{'s' * (clips != 1)}",
        contacts=contacts,
        significance=SIGNIFICANCE,
        fewest=MINIMUM_FOR_WILCOXON,
        mechanics=mechanics,
        box="; ".join("{} {:g} … {:g}".format(name, *getattr(bounds, name)) for name in PARAMETERS),
        versions=", ".join(f"{name} {number}" for name, number in made_with().items()),
        **{name: _table(table) for name, table in reading_tables(found).items()},
    )


def made_with() -> dict[str, str]:
    """Versions that the numbers depend on."""
    return versions() | {"torch": torch.__version__}


def evaluation_json(found: Evaluation, mechanics: Mechanics, bounds: Bounds, made: datetime) -> str:
    """All numbers of the evaluation as one JSON document; what doesn't exist is null."""
    content = vars(found) | {
        "format_version": FORMAT_VERSION,
        "made": made.isoformat(),
        "versions": made_with(),
        "units": TEXTS["units"],
        "mechanics": asdict(mechanics),
        "bounds": asdict(bounds),
    }
    for name in ("summaries", "comparisons", "depth"):
        groups = getattr(found, name).items()
        content[name] = {group: {name: each._asdict() for name, each in own.items()} for group, own in groups}
    for name, value in content.items():
        if isinstance(value, pd.DataFrame):
            content[name] = value.to_dict("index")
    return as_json(content, ensure_ascii=False) + "\n"
