"""Tables of the evaluation, written once and rendered as Markdown, CSV and HTML."""

from __future__ import annotations

import csv
import html
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from evaluation.collapse import CollapseCheck, ParameterSpread
from evaluation.settling import STATES, SettlingSummary
from evaluation.statistics import COARSE_CLIPS, MINIMUM_CLIPS, Comparison, Interval, Summary

Cell = float | int | str | None
"""None renders as a dash in text and as an empty field in CSV."""

PAPER_TABLE2 = (
    "For orientation, Bini 2026, table 2, on its own data: reference 0.00467 ± 0.01361 [0.00286, 0.00684], "
    "predicted 0.00428 ± 0.01308 [0.00256, 0.00638]; errors of different data or scenes are not comparable."
)


def format_number(value: Cell) -> str:
    """A cell for reading: four significant digits, a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return str(value)
    if not math.isfinite(value):
        return "not finite"
    return f"{value:.4g}".replace("e-0", "e-").replace("e+0", "e+").replace("-", "−")


def format_interval(interval: Interval | None, note: str = "") -> str:
    """`[low, high]`, or the note where there is no interval."""
    if interval is None:
        return note or "–"
    return f"[{format_number(interval[0])}, {format_number(interval[1])}]"


@dataclass(frozen=True)
class Table:
    """A titled table; every row has as many cells as there are columns."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f'table "{self.title}" has {len(self.columns)} columns, and a row has {len(row)} cells.'
                )

    def to_markdown(self) -> str:
        """GitHub-flavoured Markdown, title and notes included."""

        def line(cells: Sequence[str]) -> str:
            return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

        lines = [f"### {self.title}", "", line(self.columns), line(["---"] * len(self.columns))]
        lines += [line([format_number(cell) for cell in row]) for row in self.rows]
        if self.notes:
            lines += [""] + [f"- {note}" for note in self.notes]
        return "\n".join(lines) + "\n"

    def to_csv(self) -> str:
        """CSV with full precision; title and notes left out."""
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(self.columns)
        for row in self.rows:
            writer.writerow([repr(float(cell)) if isinstance(cell, float) else cell for cell in row])
        return buffer.getvalue()

    def to_html(self) -> str:
        """A `<figure>` with the table, its title as caption and its notes below."""
        head = "".join(f"<th scope='col'>{html.escape(column)}</th>" for column in self.columns)
        body = "".join(
            "<tr>"
            + "".join(
                f"<{tag}>{html.escape(format_number(cell))}</{tag.split()[0]}>"
                for tag, cell in zip(["th scope='row'"] + ["td"] * (len(row) - 1), row, strict=True)
            )
            + "</tr>"
            for row in self.rows
        )
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in self.notes)
        return (
            f"<figure class='table'><figcaption>{html.escape(self.title)}</figcaption><div class='scroll'><table>"
            f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
            + (f"<ul class='notes'>{notes}</ul>" if notes else "")
            + "</figure>"
        )


def _mean_sd(summary: Summary) -> str:
    if summary.mean is None:
        return summary.notes.get("mean", "–")
    sd = format_number(summary.sd) if summary.sd is not None else f"(SD: {summary.notes['sd']})"
    return f"{format_number(summary.mean)}\u00a0±\u00a0{sd}"


def _interval(summary: Summary, name: str) -> str:
    return format_interval(getattr(summary, name), summary.notes.get(name, ""))


def _coarse(clips: Sequence[int]) -> tuple[str, ...]:
    """A note for intervals over few clips."""
    few = [count for count in clips if MINIMUM_CLIPS <= count < COARSE_CLIPS]
    return (f"With {max(few)} clips the interval over whole clips is coarse.",) if few else ()


def error_table(summaries: Mapping[str, Summary], notes: Sequence[str] = ()) -> Table:
    """Table 2 of Bini 2026: mean error ± SD and its intervals, a column for each regime (name → summary)."""
    regimes = list(summaries.values())
    return Table(
        "Table 2: simulation error, mean squared displacement error [scene units²]",
        ("metric", *summaries),
        (
            ("MSE (mean ± SD)", *(_mean_sd(s) for s in regimes)),
            ("MSE, 95 % interval (BCa, over frames)", *(_interval(s, "interval") for s in regimes)),
            ("MSE, 95 % interval (over whole clips)", *(_interval(s, "clip_interval") for s in regimes)),
            ("frames n", *(s.n for s in regimes)),
            ("clips", *(s.clips for s in regimes)),
        ),
        (*notes, *_coarse([s.clips for s in regimes])),
    )  # fmt: skip


COMPARISON_ROWS = (
    ("mean_difference", "mean difference [scene units²]"),
    ("relative_change_percent", "change of the mean error [%]"),
    ("difference_interval", "difference, 95 % interval (BCa, over frames)"),
    ("difference_clip_interval", "difference, 95 % interval (over whole clips)"),
    ("wilcoxon_w", "Wilcoxon signed-rank W"),
    ("wilcoxon_p", "Wilcoxon p (two-sided)"),
    ("t", "paired t"),
    ("t_p", "paired t-test p (two-sided)"),
    ("cohens_d", "Cohen's d (paired, d_z)"),
)


def _comparison_cell(comparison: Comparison, name: str) -> Cell:
    value, note = getattr(comparison, name), comparison.notes.get(name, "")
    if name.endswith("interval"):
        return format_interval(value, note)
    return note or "–" if value is None else value


def comparison_table(comparisons: Mapping[str, Comparison]) -> Table:
    """Paired tests, a column for each comparison (name → comparison)."""
    columns = list(comparisons.values())
    rows: list[tuple[Cell, ...]] = [
        (label, *(_comparison_cell(column, name) for column in columns)) for name, label in COMPARISON_ROWS
    ]
    rows += [
        ("pairs n", *(column.n for column in columns)),
        ("clips", *(column.clips for column in columns)),
        ("pairs left out (error not finite)", *(column.left_out for column in columns)),
    ]
    notes: tuple[str, ...] = (
        "Difference = baseline − predicted: positive values mean that the predicted θ has the lower error.",
        "Cohen's d is the paired variant d_z = mean(difference)/SD(difference) = t/√n, which is what the paper prints.",
        "Tests and BCa intervals take frames as independent, and frames of one clip are not; the interval over "
        "whole clips resamples clips (percentile method). 10,000 resamples each.",
    )
    notes += _coarse([column.clips for column in columns])
    title = "Paired comparison of the predicted θ with its baselines"
    return Table(title, ("statistic", *comparisons), tuple(rows), notes)


def long_table(summaries: Mapping[str, Summary], comparisons: Mapping[str, Comparison]) -> Table:
    """All numbers of Table 2 and its tests, one a row, for CSV."""
    rows: list[tuple[Cell, ...]] = []
    for regime, s in summaries.items():
        for name in ("mean", "sd"):
            rows.append((regime, "", name, getattr(s, name), None, None, s.n, s.clips, s.notes.get(name, "")))
        for name in ("interval", "clip_interval"):
            low, high = getattr(s, name) or (None, None)
            rows.append((regime, "", name, None, low, high, s.n, s.clips, s.notes.get(name, "")))
    for baseline, c in comparisons.items():
        for name, _ in COMPARISON_ROWS:
            value, note = getattr(c, name), c.notes.get(name, "")
            low, high = (value or (None, None)) if name.endswith("interval") else (None, None)
            single = None if name.endswith("interval") else value
            rows.append(("predicted θ", baseline, name, single, low, high, c.n, c.clips, note))
    columns = ("regime", "compared_with", "quantity", "value", "low", "high", "n", "clips", "note")
    return Table("Table 2", columns, tuple(rows))


def spread_table(check: CollapseCheck) -> Table:
    """Spread of each parameter over the test frames, for reading."""

    labels = {"stiffness": "k_s [normalised]", "damping": "k_d [normalised]", "force": "|F| [normalised]"}

    def cells(p: ParameterSpread) -> tuple[Cell, ...]:
        small = "n too small"
        return (
            "F [normalised], signed" if p.low < 0 else labels[p.name],
            f"{format_number(p.mean)}\u00a0±\u00a0{format_number(p.sd) if p.sd is not None else small}",
            f"{format_number(p.minimum)} … {format_number(p.maximum)}",
            f"{format_number(p.low)} … {format_number(p.high)}",
            small if p.spread is None else f"{100 * p.spread:.3g} %",
            small if p.variation is None else f"{100 * p.variation:.3g} %",
            "one clip" if p.between_clips_sd is None else p.between_clips_sd,
            small if p.within_clips_sd is None else p.within_clips_sd,
            f"{100 * p.at_bound:.3g} %",
            small if p.collapsed is None else "constant" if p.collapsed else "varies",
        )  # fmt: skip

    return Table(
        "Spread of the estimates over the test frames",
        ("parameter", "mean ± SD", "min … max", "admissible range", "SD / range", "SD / |mean|",
         "SD between clips", "SD within clips", "frames at a bound", "verdict"),
        tuple(cells(p) for p in check.parameters),
        (
            "constant = SD below 2 % of the admissible range and below 20 % of the mean; a constant predictor has 0.",
            "By this rule the paper's own k_s (0.508 ± 0.003), k_d (0.09 ± 0.016) and F (7.79 ± 0.18) are constant.",
        ),
    )  # fmt: skip


def spread_rows(check: CollapseCheck) -> Table:
    """The same for CSV, in full precision."""
    columns = ("parameter", "mean", "sd", "minimum", "maximum", "low", "high", "sd_of_range", "sd_of_mean",
               "between_clips_sd", "within_clips_sd", "at_bound", "verdict")  # fmt: skip
    rows = tuple(
        (p.name, p.mean, p.sd, p.minimum, p.maximum, p.low, p.high, p.spread, p.variation, p.between_clips_sd,
         p.within_clips_sd, p.at_bound, "" if p.collapsed is None else "constant" if p.collapsed else "varies")
        for p in check.parameters
    )  # fmt: skip
    return Table("Collapse check", columns, rows)


def settling_table(summaries: Mapping[str, SettlingSummary]) -> Table:
    """Settling by regime (name → summary)."""
    rows = tuple(
        (
            regime,
            "none settled" if s.median_s is None else s.median_s,
            "none settled" if s.longest_s is None else s.longest_s,
            *(s.counts[state] for state in STATES),
        )
        for regime, s in summaries.items()
    )
    return Table(
        "Settling time: from release until the displacement stays within 5 % of its peak",
        ("simulation", "median [s]", "longest [s]", *(f"{state} [frames]" for state in STATES)),
        rows,
        ("Times are taken over the trajectories that settled within the simulated horizon; the others are counted.",),
    )
