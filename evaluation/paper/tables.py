"""Tables of the evaluation: those for reading, and rows in full precision for CSV."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from evaluation.paper.collapse import CollapseCheck, ParameterSpread
from evaluation.paper.settling import STATES, SettlingSummary
from evaluation.paper.statistics import COARSE_CLIPS, MINIMUM_CLIPS, Comparison, Interval, Summary
from evaluation.tables import to_markdown

Cell = float | int | str | None
"""None reads as a dash."""

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
    """A titled table for reading."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[str] = ()

    def to_markdown(self) -> str:
        """With title and notes."""
        cells = [[format_number(cell) for cell in row] for row in self.rows]
        notes = "".join(f"\n- {note}" for note in self.notes)
        return f"### {self.title}\n\n{to_markdown(self.columns, cells)}\n" + (f"{notes}\n" if notes else "")


def _mean_sd(summary: Summary) -> str:
    if summary.mean is None:
        return summary.notes["mean"]
    sd = format_number(summary.sd) if summary.sd is not None else f"(SD: {summary.notes['sd']})"
    return f"{format_number(summary.mean)}\u00a0±\u00a0{sd}"


def _told(item: Summary | Comparison, name: str) -> Cell:
    """A statistic, or why it could not be computed."""
    value, note = getattr(item, name), item.notes.get(name, "")
    return format_interval(value, note) if name.endswith("interval") else note if value is None else value


def _coarse(items: Sequence[Summary | Comparison]) -> list[str]:
    """A note for intervals over few clips."""
    few = [item.clips for item in items if MINIMUM_CLIPS <= item.clips < COARSE_CLIPS]
    return [f"With {max(few)} clips the interval over whole clips is coarse."] if few else []


def error_table(summaries: Mapping[str, Summary], notes: Sequence[str] = ()) -> Table:
    """Table 2 of Bini 2026: mean error ± SD and its intervals, a column for each regime (name → summary)."""
    regimes = list(summaries.values())
    return Table(
        "Table 2: simulation error, mean squared displacement error [scene units²]",
        ("metric", *summaries),
        (
            ("MSE (mean ± SD)", *map(_mean_sd, regimes)),
            ("MSE, 95 % interval (BCa, over frames)", *(_told(s, "interval") for s in regimes)),
            ("MSE, 95 % interval (over whole clips)", *(_told(s, "clip_interval") for s in regimes)),
            ("frames n", *(s.n for s in regimes)),
            ("clips", *(s.clips for s in regimes)),
        ),
        (*notes, *_coarse(regimes)),
    )


SUMMARIES = ("mean", "sd", "interval", "clip_interval")
COMPARISONS = {
    "mean_difference": "mean difference [scene units²]",
    "relative_change_percent": "change of the mean error [%]",
    "difference_interval": "difference, 95 % interval (BCa, over frames)",
    "difference_clip_interval": "difference, 95 % interval (over whole clips)",
    "wilcoxon_w": "Wilcoxon signed-rank W",
    "wilcoxon_p": "Wilcoxon p (two-sided)",
    "t": "paired t",
    "t_p": "paired t-test p (two-sided)",
    "cohens_d": "Cohen's d (paired, d_z)",
}


def comparison_table(comparisons: Mapping[str, Comparison]) -> Table:
    """Paired tests, a column for each comparison (name → comparison)."""
    columns = list(comparisons.values())
    counts = {"n": "pairs n", "clips": "clips", "left_out": "pairs left out (error not finite)"}
    return Table(
        "Paired comparison of the predicted θ with its baselines",
        ("statistic", *comparisons),
        [(label, *(_told(column, name) for column in columns)) for name, label in (COMPARISONS | counts).items()],
        (
            "Difference = baseline − predicted: positive values mean that the predicted θ has the lower error.",
            "Cohen's d is the paired variant d_z = mean(difference)/SD(difference) = t/√n, which is what the paper "
            "prints.",
            "Tests and BCa intervals take frames as independent, and frames of one clip are not; the interval over "
            "whole clips resamples clips (percentile method). 10,000 resamples each.",
            *_coarse(columns),
        ),
    )


def statistic_rows(summaries: Mapping[str, Summary], comparisons: Mapping[str, Comparison]) -> list[dict[str, Cell]]:
    """All numbers of Table 2 and its tests, one a row."""
    told: list[tuple[str, str, Summary | Comparison, str]]
    told = [(regime, "", item, name) for regime, item in summaries.items() for name in SUMMARIES]
    told += [("predicted θ", baseline, item, name) for baseline, item in comparisons.items() for name in COMPARISONS]
    rows = []
    for regime, baseline, item, name in told:
        value = getattr(item, name)
        low, high = value if isinstance(value, tuple) else (None, None)
        rows.append(
            {
                "regime": regime,
                "compared_with": baseline,
                "quantity": name,
                "value": None if isinstance(value, tuple) else value,
                "low": low,
                "high": high,
                "n": item.n,
                "clips": item.clips,
                "note": item.notes.get(name, ""),
            }
        )
    return rows


def spread_table(check: CollapseCheck) -> Table:
    """Spread of each parameter over the test frames."""

    labels = {"stiffness": "k_s [normalised]", "damping": "k_d [normalised]", "force": "|F| [normalised]"}

    def known(value: float | None) -> str:
        return "n too small" if value is None else format_number(value)

    def percent(value: float | None) -> str:
        return "n too small" if value is None else f"{100 * value:.3g} %"

    def cells(p: ParameterSpread) -> tuple[Cell, ...]:
        return (
            "F [normalised], signed" if p.low < 0 else labels[p.name],
            f"{format_number(p.mean)}\u00a0±\u00a0{known(p.sd)}",
            f"{format_number(p.minimum)} … {format_number(p.maximum)}",
            f"{format_number(p.low)} … {format_number(p.high)}",
            percent(p.spread),
            percent(p.variation),
            "one clip" if p.between_clips_sd is None else p.between_clips_sd,
            known(p.within_clips_sd),
            percent(p.at_bound),
            p.verdict or "n too small",
        )

    return Table(
        "Spread of the estimates over the test frames",
        ("parameter", "mean ± SD", "min … max", "admissible range", "SD / range", "SD / |mean|",
         "SD between clips", "SD within clips", "frames at a bound", "verdict"),
        [cells(p) for p in check.parameters],
        (
            "constant = SD below 2 % of the admissible range and below 20 % of the mean; a constant predictor has 0.",
            "By this rule the paper's own k_s (0.508 ± 0.003), k_d (0.09 ± 0.016) and F (7.79 ± 0.18) are constant.",
        ),
    )  # fmt: skip


def spread_rows(check: CollapseCheck) -> list[dict[str, Cell]]:
    """The same in full precision."""
    names = {"name": "parameter", "spread": "sd_of_range", "variation": "sd_of_mean"}
    return [
        {names.get(name, name): value for name, value in vars(p).items() if name != "collapsed"}
        | {"verdict": p.verdict}
        for p in check.parameters
    ]


def settling_table(summaries: Mapping[str, SettlingSummary]) -> Table:
    """Settling by regime (name → summary)."""
    return Table(
        "Settling time: from release until the displacement stays within 5 % of its peak",
        ("simulation", "median [s]", "longest [s]", *(f"{state} [frames]" for state in STATES)),
        [
            (
                regime,
                *("none settled" if time is None else time for time in (s.median_s, s.longest_s)),
                *(s.counts[state] for state in STATES),
            )
            for regime, s in summaries.items()
        ],
        ("Times are taken over the trajectories that settled within the simulated horizon; the others are counted.",),
    )
