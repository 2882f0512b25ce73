"""What the ablations leave behind: `ablations.csv`, a Markdown table a family for the documentation, and a figure."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluation.ablations.rows import OBSERVATION, ROWS, TRAINING
from evaluation.ablations.scores import NUMBERS
from evaluation.recovery.figures import QUANTITY_COLORS, plain_axes
from evaluation.recovery.scores import PARAMETERS
from evaluation.recovery.store import replace_text
from evaluation.tables import to_csv, to_markdown
from results.store import writing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = ("family", "row", "what", "status", "reason", "steps", "seconds", *NUMBERS)
"""Of `ablations.csv`."""
DONE, FAILED = "ok", "failed"
TITLES = {OBSERVATION: "What is observed", TRAINING: "How the generators are trained"}
SYMBOLS = ("k_s", "k_d", "F")


@dataclass(frozen=True)
class Result:
    """A row's outcome."""

    row: str
    settings: Mapping[str, Any]
    """What decides its numbers; a result of other settings is measured again."""
    status: str = DONE
    reason: str = ""
    """Why it failed, in words."""
    seconds: float = 0.0
    """Time that the row took [s]."""
    numbers: Mapping[str, float | None] = field(default_factory=dict)
    """NUMBERS, where there are any."""

    def cells(self) -> dict[str, object]:
        """Its line of `ablations.csv`."""
        row = ROWS[self.row]
        head = {"family": row.family, "row": row.name, "what": row.what, "status": self.status, "reason": self.reason}
        steps = self.settings["steps"] if row.trained else 0
        return head | {"steps": steps, "seconds": round(self.seconds)} | dict(self.numbers)


def keep(result: Result, folder: Path) -> None:
    """Keep a finished row; its file appears only when it is complete."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    replace_text(folder / f"{result.row}.json", json.dumps(asdict(result), indent=2))


def kept(row: str, settings: Mapping[str, Any], folder: Path) -> Result | None:
    """A finished row of the same settings; None where there is none."""
    try:
        result = Result(**json.loads((folder / f"{row}.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
    return result if result.settings == settings else None


def write_all(results: Sequence[Result], folder: Path) -> None:
    """Write ablations.csv, ablations.md and ablations.png, rows in the table's order.

    Raises:
        OutputError: they can't be written.
    """
    places = list(ROWS)
    results = sorted(results, key=lambda result: places.index(result.row))
    replace_text(folder / "ablations.csv", to_csv([result.cells() for result in results], COLUMNS, ".6g"))
    replace_text(folder / "ablations.md", markdown(results))
    with writing(folder):
        draw(results).savefig(folder / "ablations.png")


def markdown(results: Sequence[Result]) -> str:
    """A table a family; a number that doesn't exist is a dash, and a row that failed says why."""
    blocks = []
    for family, title in TITLES.items():
        rows = [result for result in results if ROWS[result.row].family == family]
        if not rows:
            continue
        depth = family == TRAINING
        head = ["row", "what", "steps", "error/bound k_s, k_d, F", "constant/bound", "k_s/k_d, F/k_d", "coverage"]
        head += ["next depth/copy"] * depth
        blocks.append(f"**{title}**\n\n{to_markdown(head, (_cells(result, depth) for result in rows))}")
    return "\n\n".join(blocks) + "\n"


def _cells(result: Result, depth: bool) -> list[str]:
    row, values = ROWS[result.row], result.numbers
    head = [row.name, row.what, str(result.cells()["steps"])]
    if result.status == FAILED:
        return [*head, f"failed: {result.reason}".replace("|", "/"), *["–"] * (3 + depth)]
    cells = [
        ", ".join(_number(values.get(f"{label}_{name}"), form) for name in names)
        for label, names, form in (
            ("over_bound", PARAMETERS, ".2f"),
            ("constant_over_bound", PARAMETERS, ".1f"),
            ("rms", ("stiffness_damping", "force_damping"), ".2f"),
            ("coverage", PARAMETERS, ".0%"),
        )
    ]
    return head + cells + [_number(values.get("next_depth_over_copy"), ".2f")] * depth


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def draw(results: Sequence[Result]) -> Figure:
    """Error over bound by row, a panel a family."""

    from matplotlib.figure import Figure

    families = [name for name in TITLES if any(ROWS[result.row].family == name for result in results)]
    figure = Figure(figsize=(6.2 * max(1, len(families)), 4.8), dpi=150, layout="constrained")
    for axes, family in zip(figure.subplots(1, max(1, len(families)), squeeze=False)[0], families, strict=False):
        _draw_family(axes, [r for r in results if ROWS[r.row].family == family and r.status == DONE])
        axes.set_title(TITLES[family], fontsize=10)
    return figure


def _draw_family(axes: Axes, results: Sequence[Result]) -> None:

    for column, name in enumerate(PARAMETERS):
        places = [index + 0.22 * (column - 1) for index in range(len(results))]
        styles: tuple[tuple[str, dict[str, Any]], ...] = (
            ("over_bound", {"marker": "os^"[column], "label": f"${SYMBOLS[column]}$"}),
            ("constant_over_bound", {"marker": "_", "ms": 10, "label": None if column else "best constant"}),
        )
        for label, style in styles:
            values = [result.numbers.get(f"{label}_{name}") for result in results]
            heights = [math.nan if value is None else value for value in values]
            axes.plot(places, heights, ls="none", color=QUANTITY_COLORS[name], **style)
    axes.axhline(1, color="#667085", lw=1, ls="--", label="bound")
    axes.set_xticks(range(len(results)), [result.row for result in results], rotation=40, ha="right", fontsize=8)
    axes.set(yscale="log", xlim=(-0.6, max(len(results), 1) - 0.4))
    axes.set_ylabel("RMS error of log θ / Cramér–Rao bound [–]")
    axes.set_xlabel("row")
    plain_axes(axes)
    axes.legend(fontsize=8)
