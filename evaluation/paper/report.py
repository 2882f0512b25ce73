"""Writes an evaluation as files: tables (Markdown, CSV), figures (PNG), all numbers (JSON) and one HTML page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd
import torch

from palpate.common.files import as_json
from palpate.common.output import ForeignFile, replacing_own
from palpate.common.tables import to_markdown
from palpate.data.contact.interaction import Interaction
from palpate.evaluation.page import as_png, render_page
from palpate.evaluation.paper.analysis import NO_MOTION, Evaluation, EvaluationError, Record, analyse
from palpate.evaluation.paper.figures import draw_response, draw_theta
from palpate.evaluation.paper.statistics import (
    MINIMUM_FOR_WILCOXON,
    SIGNIFICANCE,
    Statistics,
    as_reported,
    format_number,
)
from palpate.physics.mechanics import PARAMETERS, Bounds, Mechanics
from palpate.results.record import versions

FILES = (
    *("figure3.png", "theta.png", "table2.md", "table2.csv", "collapse.md", "collapse.csv"),
    *("settling.csv", "per_frame.csv", "report.html", "evaluation.json"),
)
FORMAT_VERSION = 2
"""Version of `evaluation.json`."""
ERRORS = {
    "mean ± SD": "{mean}\u00a0±\u00a0{sd}",
    "95 % interval of the mean (BCa, over frames)": "{interval}",
    "95 % interval of the mean (over whole clips)": "{clip_interval}",
    "frames n": "{n}",
    "clips": "{clips}",
    "frames left out (error not finite)": "{left_out}",
}
COMPARISONS = {
    "mean difference [scene units²]": "{mean_difference}",
    "change of the mean error [%]": "{relative_change_percent}",
    "difference, 95 % interval (BCa, over frames)": "{difference_interval}",
    "difference, 95 % interval (over whole clips)": "{difference_clip_interval}",
    "Wilcoxon signed-rank W": "{wilcoxon_w}",
    "Wilcoxon p (two-sided)": "{wilcoxon_p}",
    "paired t": "{t}",
    "paired t-test p (two-sided)": "{t_p}",
    "Cohen's d (paired, d_z)": "{cohens_d}",
    "pairs n": "{n}",
    "clips": "{clips}",
    "pairs left out (error not finite)": "{left_out}",
}
DEPTH_COLUMNS = {"decoder": "decoder", "copy": "repeat the last frame", "sensitivity": "change when θ moves"}
UNITS = {
    "stiffness": "normalised, not N/m",
    "damping": "normalised, not N·s/m",
    "force": "normalised, not N; a magnitude unless the admissible range crosses 0",
    "error": "scene units²",
    "depth_error": "scene units",
    "time": "s",
}
ESTIMATES = ("mean", "SD", "lowest", "highest", "lower bound", "upper bound")
"""Columns of the first table of estimates."""
TITLE = "Evaluation of the estimated tissue parameters"


def write_evaluation(
    records: Sequence[Record], training: Sequence[Interaction], mechanics: Mechanics, bounds: Bounds, output: Path
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
    tables = reading_tables(found, len(training))
    figures = {
        "figure3.png": as_png(draw_response(found.trajectories, found.frames["release_s"].to_numpy(), mechanics)),
        "theta.png": as_png(draw_theta(found.frames, found.spread, as_reported(found.constant, bounds))),
    }
    conclusion, listed = f"> {found.conclusion}\n", "".join(f"- {sentence}\n" for sentence in found.sentences)
    lead = f"{conclusion}\n{listed}"
    texts = {
        "table2.md": "\n".join(("# Simulation error\n", lead, tables["errors"], tables["tests"], tables["motion"])),
        "table2.csv": statistics_table(found).to_csv(index=False),
        "collapse.md": "\n".join(("# Collapse check\n", lead, tables["spread"], tables["constant"], tables["depth"])),
        "collapse.csv": found.spread.to_csv(index_label="parameter"),
        "settling.csv": found.settling.to_csv(index=False),
        "per_frame.csv": found.frames.to_csv(index=False),
        "report.html": render_page(TITLE, page_text(conclusion, listed, tables, mechanics, bounds, made), figures),
        "evaluation.json": evaluation_json(found, mechanics, bounds, made),
    }
    try:
        output.mkdir(parents=True, exist_ok=True)
        for name, content in (figures | {name: text.encode() for name, text in texts.items()}).items():
            with replacing_own(output / name) as partial:
                partial.write_bytes(content)
        return {name: output / name for name in FILES}
    except ForeignFile as error:
        raise EvaluationError(str(error)) from error
    except OSError as error:
        raise EvaluationError(
            f"{output}: the evaluation can't be written ({error.strerror}); choose a folder that is "
            "writable and has space."
        ) from error


def _table(title: str, table: pd.DataFrame, *notes: str) -> str:
    """Markdown of a table, named by its index, with title and notes."""
    rows = [[format_number(cell) for cell in row] for row in table.itertuples()]
    listed = "".join(f"- {note}\n" for note in notes)
    return f"### {title}\n\n{to_markdown(['', *table.columns], rows)}\n\n{listed}"


def _amounts(found: Evaluation) -> str:
    """Number of test frames and clips, in words."""
    frames, clips = len(found.frames), found.frames["clip"].nunique()
    return f"{frames} test frame{'s' * (frames != 1)} of {clips} clip{'s' * (clips != 1)}"


def _shares(errors: Mapping[str, float]) -> dict[str, float]:
    """Errors as shares [%] of the error without motion; not a number where nothing moved."""
    return {name: 100 * error / (errors[NO_MOTION] or math.nan) for name, error in errors.items()}


def _filled(lines: Mapping[str, str], columns: Mapping[str, Statistics]) -> pd.DataFrame:
    """Table of statistics for reading, with a column for each; a line is a label and a template."""
    cells = {name: [text.format(**found) for text in lines.values()] for name, found in columns.items()}
    return pd.DataFrame(cells, index=list(lines))


def reading_tables(found: Evaluation, contacts: int) -> dict[str, str]:
    """Tables for reading as Markdown, by name; `contacts` is how many the constant θ was fitted on."""
    constant = dict(zip(PARAMETERS, found.constant, strict=True)) | {
        "mean error on these contacts [scene units²]": found.training_error
    }
    depth = {label: found.depth[name] for name, label in DEPTH_COLUMNS.items()}
    errors = {name: summary["mean"].value for name, summary in found.summaries.items()}
    estimates = found.spread[["mean", "sd", "minimum", "maximum", "low", "high"]].set_axis(ESTIMATES, axis="columns")
    return {
        "fit": _table(
            f"How well simulations follow the observed motion ({_amounts(found)})",
            pd.DataFrame({"mean squared error [scene units²]": errors, "of that without motion [%]": _shares(errors)}),
            "θ: stiffness k_s, damping k_d and force F. Predicted: estimated from the pictures, frame by frame. The "
            "others are baselines: reference, the literature's k_s and k_d; constant, one θ for all, "
            "fitted on the training clips; the mean of all predictions; and tissue that does not move at all.",
        ),
        "estimates": _table(f"What was estimated, in normalised units ({_amounts(found)})", estimates),
        "errors": _table(
            "Table 2: simulation error, mean squared displacement error (MSE) [scene units²]",
            _filled(ERRORS, found.summaries),
            "The interval over whole clips resamples clips (percentile method); with fewer than 10 clips it is coarse.",
            "For orientation, Bini 2026, table 2, on its own data: reference 0.00467 ± 0.01361 [0.00286, 0.00684], "
            "predicted 0.00428 ± 0.01308 [0.00256, 0.00638]; errors of different data or scenes are not comparable.",
        ),
        "tests": _table(
            "Paired comparison of the predicted θ with its baselines",
            _filled(COMPARISONS, {f"vs {name}": comparison for name, comparison in found.comparisons.items()}),
            "Difference = baseline − predicted: positive values mean that the predicted θ has the lower error.",
            f"Better, worse: the mean error is lower or higher and Wilcoxon's p below {SIGNIFICANCE:g}; too few to "
            f"judge with fewer than {MINIMUM_FOR_WILCOXON} clips.",
            "Cohen's d is the paired variant d_z = mean(difference)/SD(difference) = t/√n, as the paper prints it.",
            "Tests and BCa intervals take frames as independent, and frames of one clip are not. 10,000 resamples.",
        ),
        "motion": _table(
            "When do the simulations settle?",
            found.motion,
            "Settling time: from release until the displacement stays within 5 % of its peak, of those that settled "
            "within the simulated horizon; the others are counted.",
            "A peak over 1 scene unit is a displacement larger than the scene is deep.",
            "Median of highest peak: how high figure 3b's median rises. Bini 2026, section 4.2, has 0.63 to 0.65 on "
            "its own data, and rest within 0.9 s.",
        ),
        "spread": _table(
            "Spread of the estimates over the test frames [normalised]",
            found.spread.rename(columns=lambda name: name.replace("_", " ")),
            "low, high: admissible range. Constant = SD below 2 % of it and below 20 % of the mean; a constant "
            "predictor has 0. At bound: fraction of the frames at an end of the range.",
            "By this rule the paper's own k_s (0.508 ± 0.003), k_d (0.09 ± 0.016) and F (7.79 ± 0.18) are constant.",
        ),
        "constant": _table(
            f"Constant θ fitted on the training contacts (n = {contacts}) [normalised]",
            pd.DataFrame({"value": constant}),
            "Negative forces press into the tissue.",
        ),
        "depth": _table(
            "Next depth map: mean absolute error [scene units]",
            _filled(ERRORS, depth),
            "Change when θ moves: mean |Δz| of the decoded map when θ moves to the box's farthest corner.",
        ),
    }


def statistics_table(found: Evaluation) -> pd.DataFrame:
    """All numbers of Table 2 and its tests, one a row."""
    regimes = [(name, "", statistics) for name, statistics in found.summaries.items()]
    regimes += [("predicted θ", name, statistics) for name, statistics in found.comparisons.items()]
    return pd.DataFrame(
        [
            {"regime": regime, "compared_with": baseline, "quantity": quantity, **statistic._asdict()}
            for regime, baseline, statistics in regimes
            for quantity, statistic in statistics.items()
        ]
    )


def page_text(
    conclusion: str, listed: str, tables: Mapping[str, str], mechanics: Mechanics, bounds: Bounds, made: datetime
) -> str:
    """The page as Markdown: the conclusion, what was found with its figures, then every comparison and its grounds."""
    box = "; ".join(f"{name} {getattr(bounds, name)[0]:g} … {getattr(bounds, name)[1]:g}" for name in PARAMETERS)
    return f"""# {TITLE}

palpate · {made:%Y-%m-%d %H:%M} UTC

**Not a medical device.** For research only; no clinical decision may rest on these numbers.

{conclusion}
## What was found

{tables["fit"]}
{tables["estimates"]}
![Stiffness, damping and force by test frame](theta.png)

*Estimates by test frame. Left: within the admissible range, where an estimator that ignores the frames shows a flat
line. Right: zoomed to the estimates.*

![Heat map and fan chart of relative displacement over time](figure3.png)

*Figure 3. Displacement of the contact vertex simulated with the predicted θ, relative to the highest peak.
(a) Every test frame, sorted by peak. (b) Median and percentiles over the test frames.*

## In sentences

{listed}
## Simulation error

{tables["errors"]}
{tables["tests"]}
## Dynamic response

{tables["motion"]}
## Collapse check

{tables["spread"]}
{tables["constant"]}
## Next depth map

{tables["depth"]}
## How this was made

- Simulation: mass–spring–damper on the tissue mesh of the frame, {mechanics.steps} steps of {mechanics.time_step:g} s,
  mass {mechanics.mass:g} a vertex, implicit damping, a fixed rim;
  the load ends when the observation's contact ends.
- Error: mean over the observed steps of the squared distance between simulated and observed displacement of the
  contact vertex (Bini 2026, equation 14) [scene units²].
- Admissible box of θ (F signed, negative presses into the tissue): {box}.
- Units: lengths are scene units, the depth divided by the clip's one fixed scale. k_s, k_d and F are normalised,
  not N/m, N·s/m and N; scene units differ between clips unless a metric scale is known.
- No force or stiffness was measured on real clips: the evaluation says how well the simulation follows the observed
  motion, not how true the parameters are.
- Made with {", ".join(f"{name} {number}" for name, number in made_with().items())}.
"""


def made_with() -> dict[str, str]:
    """Versions that the numbers depend on."""
    return versions() | {"torch": torch.__version__}


def evaluation_json(found: Evaluation, mechanics: Mechanics, bounds: Bounds, made: datetime) -> str:
    """All numbers of the evaluation as one JSON document; what doesn't exist is null."""
    content = vars(found) | {
        "format_version": FORMAT_VERSION,
        "made": made.isoformat(),
        "versions": made_with(),
        "units": UNITS,
        "mechanics": asdict(mechanics),
        "bounds": asdict(bounds),
    }
    for name in ("summaries", "comparisons", "depth"):
        content[name] = {
            group: {quantity: statistic._asdict() for quantity, statistic in statistics.items()}
            for group, statistics in getattr(found, name).items()
        }
    for name, value in content.items():
        if isinstance(value, pd.DataFrame):
            content[name] = value.to_dict("index")
    return as_json(content, ensure_ascii=False) + "\n"
