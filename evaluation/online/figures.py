"""Figures 5, 7, 8 and 9 and Table II of Liang 2024, drawn of what was run."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from palpate.evaluation.online.compare import BATCH, HORIZON, METHODS, Case
from palpate.evaluation.online.sequences import Pull

Cases = Mapping[tuple[str, str, str], Case]
"""By sequence, start and method."""
COLOURS = dict(zip(METHODS, ("#6c757d", "#f4a261", "#2a9d8f", "#1d3557"), strict=True))
SHOWN = ("k2", "k1", "k3")
"""Starts that are drawn, the first that was run: the paper draws k2."""
INSTANTS = (40, 50)
"""Frames from which figure 8 predicts, as the paper's; the last two that were predicted from, where these weren't."""


def table(cases: Cases) -> pd.DataFrame:
    """Table II: future gap; keypoints' error [mm] of every method, by sequence and start."""
    columns = dict.fromkeys(key[:2] for key in cases)

    def cell(sequence: str, start: str, method: str) -> str:
        case = cases.get((sequence, start, method))
        return "" if case is None else f"{1e3 * case.gap.mean():.1f}; {1e3 * case.keypoint.mean():.2f}"

    return pd.DataFrame(
        {"method": METHODS} | {f"{s}, {start}": [cell(s, start, method) for method in METHODS] for s, start in columns}
    )


def draw_all(cases: Cases, pulls: Mapping[str, Pull]) -> dict[str, Figure]:
    """Every figure by its name."""
    shown = {
        name: start for name in pulls for start in reversed(SHOWN) if any((name, start, m) in cases for m in METHODS)
    }
    drawn = {
        "figure_5.png": _over_time(cases, shown, "chamfer", ("PBD", "PBD-RM")),
        "figure_7.png": _over_time(cases, shown, "gap", METHODS),
        "figure_8.png": _gap_maps(cases, shown, pulls),
    }
    if any((*key, "PBD-RM-ON") in cases for key in shown.items()):
        drawn["figure_9.png"] = _fields(cases, shown, pulls)
    return drawn


def _over_time(cases: Cases, shown: Mapping[str, str], what: str, methods: tuple[str, ...]) -> Figure:
    figure = Figure(figsize=(4 * len(shown), 3.2), dpi=100, layout="constrained")
    for axes, (sequence, start) in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown.items(), strict=True):
        for method in methods:
            case = cases.get((sequence, start, method))
            if case is None:
                continue
            if what == "chamfer":
                axes.plot(1 + np.arange(len(case.chamfer)), 1e3 * case.chamfer, color=COLOURS[method], label=method)
            else:
                axes.plot(1 + case.ahead, 1e3 * case.gap, marker="o", ms=3, color=COLOURS[method], label=method)
        axes.set(xlabel="frame", title=f"{sequence}, {start}")
        axes.set_ylabel("Chamfer distance [mm]" if what == "chamfer" else "mean future gap ‖Δ‖ [mm]")
        axes.set_ylim(bottom=0)
        axes.legend(fontsize=8)
    return figure


def _places(points: np.ndarray, pull: Pull) -> np.ndarray:
    """What the camera sees of states [N, 3], from above, shape [n, 2] [mm]."""
    return 1e3 * points[pull.seen, :2]


def _gap_maps(cases: Cases, shown: Mapping[str, str], pulls: Mapping[str, Pull]) -> Figure:
    """Ten frames ahead from two instants, on one scale a sequence."""
    methods = [method for method in METHODS if method != BATCH]
    columns = [(number, method) for number in range(len(INSTANTS)) for method in methods]
    figure = Figure(figsize=(2.6 * len(columns), 2.6 * len(shown)), dpi=100, layout="constrained")
    grid = figure.subplots(len(shown), len(columns), squeeze=False)
    for row, (sequence, start) in zip(grid, shown.items(), strict=True):
        own = {m: cases[sequence, start, m] for m in methods if (sequence, start, m) in cases}
        most = 1e3 * max((float(case.gaps[instants(case)].max()) for case in own.values()), default=1.0)
        drawn = None
        for axes, (number, method) in zip(row, columns, strict=True):
            axes.set(aspect="equal", xticks=[], yticks=[])
            if method not in own or number >= len(instants(own[method])):
                continue
            case, at = own[method], instants(own[method])[number]
            style = {"c": 1e3 * case.gaps[at][pulls[sequence].seen], "cmap": "viridis", "vmin": 0, "vmax": most}
            drawn = axes.scatter(*_places(case.states[at], pulls[sequence]).T, s=18, **style)
            axes.set_title(f"{sequence}, {start}\n{method}, t = {1 + case.ahead[at]} + {HORIZON}", fontsize=9)
        if drawn is not None:
            figure.colorbar(drawn, ax=row, shrink=0.8, label="‖Δ‖ of a particle [mm]")
    return figure


def instants(case: Case) -> list[int]:
    """Which of a case's predictions figure 8 shows, in time."""
    chosen = np.flatnonzero(np.isin(1 + case.ahead, INSTANTS)).tolist()
    return chosen if len(chosen) == len(INSTANTS) else list(range(len(case.ahead)))[-len(INSTANTS) :]


def _fields(cases: Cases, shown: Mapping[str, str], pulls: Mapping[str, Pull]) -> Figure:
    """Distances above, shapes below, at the first, the middle and the last prediction, and the truth next to them."""
    columns = 1 + min(3, max(len(case.ahead) for case in cases.values()))
    figure = Figure(figsize=(3.2 * columns, 5 * len(shown)), dpi=100, layout="constrained")
    grid = figure.subplots(2 * len(shown), columns, squeeze=False)
    for number, (sequence, start) in enumerate(shown.items()):
        case, pull = cases.get((sequence, start, "PBD-RM-ON")), pulls[sequence]
        if case is None:
            continue
        truth = np.log10(pull.stiffness / np.median(pull.stiffness))
        for row, name in zip(grid[2 * number : 2 * number + 2], ("distance", "shape"), strict=True):
            fields = np.log10(getattr(case, name))
            picked = sorted({0, len(fields) // 2, len(fields) - 1})
            panels = [(fields[j] - np.median(fields[j]), f"{name}, frame {1 + case.ahead[j]}") for j in picked]
            if name == "distance":
                panels.append((truth, "truth"))
            most = max(0.1, *(float(np.abs(values).max()) for values, _ in panels))
            for axes, (values, name) in zip(row, panels, strict=False):
                drawn = axes.scatter(
                    *_places(pull.body.rest, pull).T, c=values[pull.seen], s=30, cmap="coolwarm", vmin=-most, vmax=most
                )
                axes.set_title(f"{sequence}, {start}: {name}", fontsize=8)
            for axes in row:
                axes.set(aspect="equal", xticks=[], yticks=[], frame_on=False)
            figure.colorbar(drawn, ax=row, shrink=0.8, label="log₁₀ over the median")
    return figure
