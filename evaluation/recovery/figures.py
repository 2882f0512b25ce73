"""Figures of the benchmark: estimates against truth, errors against bounds, and whether intervals hold."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import norm

from evaluation.recovery.scores import PARAMETERS, QUANTITIES, Scores, coverage, rms
from evaluation.recovery.suites import REGIMES
from physics.identifiability import LIMIT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = dict(zip(REGIMES, ("#1d4e89", "#c77d0a", "#3f8f4f"), strict=True))
"""One colour a regime, told apart also by their lightness."""
MARKERS = dict(zip(REGIMES, ("o", "s", "^"), strict=True))
SYMBOLS = ("stiffness $k_s$", "damping $k_d$", "force $|F|$")
QUANTITY_COLORS = dict(zip(QUANTITIES, ("#1d4e89", "#c77d0a", "#3f8f4f", "#8a4fa3", "#667085"), strict=True))
GREY, PALE = "#667085", "#cdd3dc"
LEVELS = np.linspace(0.02, 0.98, 49)
"""Nominal coverages at which the empirical ones are drawn."""
SMALLEST_ERROR = 1e-3
"""Errors below this are drawn there."""
CROWDED = 400
"""So many clips and more are drawn smaller and fainter."""


def normal_width(level: float) -> float:
    """Standard deviations on both sides of the mean that hold a share of a normal variable."""
    return float(norm.ppf(0.5 + level / 2))


def coverage_curve(scores: Scores, quantity: int) -> np.ndarray | None:
    """Share of clips whose interval holds the truth at each of LEVELS; None where nothing gives intervals."""
    used = scores.groups(quantity)["all"]
    errors, sd = scores.errors[used, quantity], scores.sd[used, quantity]
    values = [coverage(errors, sd, normal_width(level)) for level in LEVELS]
    return None if not values or values[0] is None else np.array(values)


def draw_recovery(scores: Scores) -> Figure:
    """Estimated against true parameters; bars are the Cramér–Rao bound around each estimate.

    The dotted line is the best constant for the clips whose bound lies below the limit.
    """
    figure, panels = _panels(f"{scores.estimator} on {scores.suite}: estimated against true, bars = Cramér–Rao bound")
    size, line, alpha = (4, 0.8, 0.85) if len(scores.rows) < CROWDED else (2.5, 0.4, 0.6)
    for column, axes in enumerate(panels):
        truth, estimate, bounds = (array[:, column] for array in (scores.truth, scores.estimate, scores.bounds))
        known = scores.identifiable[:, column]
        axes.plot(
            np.exp(truth[~known]), np.exp(estimate[~known]), "x", ms=size, color=PALE, zorder=1,
            label=f"bound ≥ {LIMIT:g} ({(~known).sum()})",
        )  # fmt: skip
        for regime in REGIMES:
            used = known & (scores.regimes == regime)
            value = np.exp(estimate[used])
            bars = value - np.exp(estimate[used] - bounds[used]), np.exp(estimate[used] + bounds[used]) - value
            axes.errorbar(
                np.exp(truth[used]), value, yerr=bars, fmt=MARKERS[regime], ms=size, lw=line, color=COLORS[regime],
                alpha=alpha, label=f"{regime} ({used.sum()})",
            )  # fmt: skip
        limits = _limits(np.exp(np.concatenate((truth, estimate))))
        axes.plot(limits, limits, color=GREY, lw=1, ls="--", zorder=0)
        if known.any():
            best = math.exp(truth[known].mean())
            axes.axhline(best, color=GREY, lw=1, ls=":", zorder=0, label="best constant")
        axes.set(xscale="log", yscale="log", xlim=limits, ylim=limits, aspect="equal")
        axes.set_xlabel(f"true {SYMBOLS[column]} [scene units]")
        axes.set_ylabel(f"estimated {SYMBOLS[column]} [scene units]")
        plain_axes(axes)
        axes.legend(fontsize=7, loc="upper left", framealpha=0.9)
    return figure


def draw_errors(scores: Scores) -> Figure:
    """Size of every error against its bound, and the RMS of both for each regime."""
    figure, panels = _panels(f"{scores.estimator} on {scores.suite}: error against Cramér–Rao bound")
    for column, axes in enumerate(panels):
        errors = np.maximum(np.abs(scores.errors[:, column]), SMALLEST_ERROR)
        bounds = scores.bounds[:, column]
        for regime in REGIMES:
            used = scores.regimes == regime
            style = {"color": COLORS[regime], "marker": MARKERS[regime], "ls": "none"}
            axes.plot(bounds[used], errors[used], ms=4, alpha=0.55, label=regime, **style)
            judged = used & scores.identifiable[:, column]
            if judged.any():
                axes.plot(rms(bounds[judged]), rms(errors[judged]), ms=11, mec="black", mew=1.2, zorder=5, **style)
        low, high = _limits(np.append(bounds, (0.05, 1.0)))
        axes.plot((low, high), (low, high), color=GREY, lw=1, ls="--", label="error = bound")
        axes.axvline(LIMIT, color=GREY, lw=1, ls=":", label=f"limit of identifiable, {LIMIT:g}")
        axes.plot([], [], "o", ms=11, color="white", mec="black", mew=1.2, label="RMS of a regime below the limit")
        axes.set(xscale="log", yscale="log", xlim=(low, high), ylim=_limits(np.append(errors, (0.01, 1.0))))
        axes.set_xlabel(f"bound of log {SYMBOLS[column].split()[1]} [–]")
        axes.set_ylabel(f"|error| of log {SYMBOLS[column].split()[1]} [–]")
        axes.set_title(PARAMETERS[column], fontsize=10)
        plain_axes(axes)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def draw_coverage(scores: Sequence[Scores]) -> Figure:
    """Nominal against empirical coverage of one estimator, a panel a suite."""

    from matplotlib.figure import Figure

    columns = min(4, len(scores))
    rows = -(-len(scores) // columns)
    figure = Figure(figsize=(3.2 * columns + 0.4, 3.3 * rows + 0.5), dpi=150, layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, item in zip(grid.flat, scores, strict=False):
        axes.plot((0, 100), (0, 100), color=GREY, lw=1, ls="--")
        for column, quantity in enumerate(QUANTITIES):
            curve, count = coverage_curve(item, column), int(item.groups(column)["all"].sum())
            if curve is not None:
                style = "-" if column < len(PARAMETERS) else (0, (4, 1.5))
                color = QUANTITY_COLORS[quantity]
                axes.plot(100 * LEVELS, 100 * curve, color=color, ls=style, lw=1.4, label=f"{quantity} ({count})")
        axes.set(xlim=(0, 100), ylim=(0, 100), aspect="equal", title=item.suite)
        axes.title.set_fontsize(10)
        plain_axes(axes)
        if axes.get_legend_handles_labels()[1]:
            axes.legend(fontsize=6.5, loc="lower right", framealpha=0.6)
    for axes in grid.flat[len(scores) :]:
        axes.set_axis_off()
    figure.supxlabel("nominal coverage of the estimate's interval [%]", fontsize=10)
    figure.supylabel("clips whose truth it holds [%]", fontsize=10)
    figure.suptitle(f"{scores[0].estimator}: does its uncertainty hold? (clips in brackets)", fontsize=11)
    return figure


def figures(scores: Sequence[Scores]) -> Iterator[tuple[str, Figure]]:
    """All figures with their file names; a constant has none."""
    scores = [item for item in scores if item.estimator != "constant"]
    estimators = dict.fromkeys(item.estimator for item in scores)
    for item in scores:
        if item.rows:
            yield f"recovery_{item.estimator}_{item.suite}.png", draw_recovery(item)
            yield f"errors_{item.estimator}_{item.suite}.png", draw_errors(item)
    for estimator in estimators:
        given = [item for item in scores if item.estimator == estimator and np.isfinite(item.sd).any()]
        if given:
            yield f"coverage_{estimator}.png", draw_coverage(given)


def _panels(title: str) -> tuple[Figure, np.ndarray]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.4), dpi=150, layout="constrained")
    figure.suptitle(title, fontsize=11)
    return figure, figure.subplots(1, 3)


def _limits(values: np.ndarray) -> tuple[float, float]:
    """Ends of a logarithmic axis with a margin."""
    return float(values.min() / 1.3), float(values.max() * 1.3)


def plain_axes(axes: Axes) -> None:
    """No frame at the top and on the right, and plain numbers along logarithmic axes."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            low, high = axis.get_view_interval()
            few = high / low > 30
            axis.set_major_locator(LogLocator(subs=(1,) if few else (1, 2, 5)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_formatter(NullFormatter())
