"""Figures of the benchmark: estimates against truth, errors against bounds, and whether intervals hold."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from scipy.stats import norm

from palpate.data.synthetic.truth import REGIMES
from palpate.evaluation.recovery.estimators import CONSTANT
from palpate.evaluation.recovery.scores import QUANTITIES, Scores, rms
from palpate.physics.identifiability import LIMIT
from palpate.physics.mechanics import PARAMETERS

STYLES = {
    "under-damped": {"color": "#1d4e89", "marker": "o"},
    "critical": {"color": "#c77d0a", "marker": "s"},
    "over-damped": {"color": "#3f8f4f", "marker": "^"},
}
"""Regimes differ by lightness and marker as well."""
SYMBOLS = ("stiffness $k_s$", "damping $k_d$", "force $|F|$")
GREY, PALE = "#667085", "#cdd3dc"
LEVELS = np.linspace(0.02, 0.98, 49)
"""Nominal coverages at which the empirical ones are drawn."""
SMALLEST_ERROR = 1e-3
"""Errors below this are drawn there."""


def coverage_curve(scores: Scores, quantity: int) -> np.ndarray:
    """Share of clips whose interval holds the truth at each of LEVELS; not a number where nothing gives intervals."""
    used = scores.groups(quantity)["all"] & np.isfinite(scores.sd[:, quantity])
    if not used.any():
        return np.full(len(LEVELS), math.nan)
    scaled = np.abs(scores.errors[used, quantity] / scores.sd[used, quantity])
    return (scaled[:, None] <= norm.ppf(0.5 + LEVELS / 2)).mean(axis=0)


def draw_recovery(scores: Scores) -> Figure:
    """Estimated against true parameters; bars are the Cramér–Rao bound around each estimate.

    The dotted line is the best constant for the clips whose bound lies below the limit.
    """
    figure, panels = _panels(f"{scores.estimator} on {scores.suite}: estimated against true, bars = Cramér–Rao bound")
    for column, axes in enumerate(panels):
        truth, estimate, bounds = (array[:, column] for array in (scores.truth, scores.estimate, scores.bounds))
        known = scores.identifiable[:, column]
        label = f"bound ≥ {LIMIT:g} ({(~known).sum()})"
        axes.plot(np.exp(truth[~known]), np.exp(estimate[~known]), "x", ms=3, color=PALE, zorder=1, label=label)
        for regime in REGIMES:
            used = known & (scores.regimes == regime)
            value = np.exp(estimate[used])
            bars = value * -np.expm1(-bounds[used]), value * np.expm1(bounds[used])
            style = {**STYLES[regime], "ls": "none", "ms": 3, "elinewidth": 0.5, "alpha": 0.7}
            axes.errorbar(np.exp(truth[used]), value, yerr=bars, label=f"{regime} ({used.sum()})", **style)
        limits = _limits(np.exp(np.concatenate((truth, estimate))))
        axes.plot(limits, limits, color=GREY, lw=1, ls="--", zorder=0)
        if known.any():
            best = math.exp(truth[known].mean())
            axes.axhline(best, color=GREY, lw=1, ls=":", zorder=0, label="best constant")
        axes.set(xscale="log", yscale="log", xlim=limits, ylim=limits, aspect="equal")
        axes.set_xlabel(f"true {SYMBOLS[column]} [scene units]")
        axes.set_ylabel(f"estimated {SYMBOLS[column]} [scene units]")
        _plain_axes(axes)
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
            style = {**STYLES[regime], "ls": "none"}
            axes.plot(bounds[used], errors[used], ms=4, alpha=0.55, label=regime, **style)
            judged = used & scores.identifiable[:, column]
            axes.plot(rms(bounds[judged]), rms(errors[judged]), ms=11, mec="black", mew=1.2, zorder=5, **style)
        low, high = _limits(np.append(bounds, (0.05, 1.0)))
        axes.plot((low, high), (low, high), color=GREY, lw=1, ls="--", label="error = bound")
        axes.axvline(LIMIT, color=GREY, lw=1, ls=":", label=f"limit of identifiable, {LIMIT:g}")
        axes.plot([], [], "o", ms=11, color="white", mec="black", mew=1.2, label="RMS of a regime below the limit")
        axes.set(xscale="log", yscale="log", xlim=(low, high), ylim=_limits(np.append(errors, (0.01, 1.0))))
        symbol = SYMBOLS[column].split()[1]
        axes.set(xlabel=f"bound of log {symbol} [–]", ylabel=f"|error| of log {symbol} [–]")
        axes.set_title(PARAMETERS[column], fontsize=10)
        _plain_axes(axes)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def draw_coverage(scores: Sequence[Scores]) -> Figure:
    """Nominal against empirical coverage of one estimator, a panel a suite."""
    title = f"{scores[0].estimator}: does its uncertainty hold? (clips in brackets)"
    figure, panels = _panels(title, len(scores))
    for axes, item in zip(panels, scores, strict=True):
        axes.plot((0, 100), (0, 100), color=GREY, lw=1, ls="--")
        for column, quantity in enumerate(QUANTITIES):
            count = item.groups(column)["all"].sum()
            style = "-" if quantity in PARAMETERS else "--"
            axes.plot(100 * LEVELS, 100 * coverage_curve(item, column), ls=style, label=f"{quantity} ({count})")
        axes.set(xlim=(0, 100), ylim=(0, 100), aspect="equal", title=item.suite)
        _plain_axes(axes)
        axes.legend(fontsize=6.5, loc="lower right", framealpha=0.6)
    figure.supxlabel("nominal coverage of the estimate's interval [%]", fontsize=10)
    figure.supylabel("clips whose truth it holds [%]", fontsize=10)
    return figure


def figures(scores: Sequence[Scores]) -> Iterator[tuple[str, Figure]]:
    """All figures with their file names; a constant has none."""
    scores = [item for item in scores if item.estimator != CONSTANT and item.rows]
    for item in scores:
        yield f"recovery_{item.estimator}_{item.suite}.png", draw_recovery(item)
        yield f"errors_{item.estimator}_{item.suite}.png", draw_errors(item)
    for estimator in dict.fromkeys(item.estimator for item in scores):
        given = [item for item in scores if item.estimator == estimator and np.isfinite(item.sd).any()]
        if given:
            yield f"coverage_{estimator}.png", draw_coverage(given)


def _panels(title: str, count: int = 3) -> tuple[Figure, np.ndarray]:
    """An empty figure of panels, up to four in a row."""
    columns, rows = min(4, count), math.ceil(count / 4)
    figure = Figure(figsize=(4 * columns, 4.4 * rows), dpi=150, layout="constrained")
    figure.suptitle(title, fontsize=11)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in panels[count:]:
        axes.set_axis_off()
    return figure, panels[:count]


def _limits(values: np.ndarray) -> tuple[float, float]:
    """Ends of a logarithmic axis with a margin."""
    return float(values.min() / 1.3), float(values.max() * 1.3)


def _plain_axes(axes: Axes) -> None:
    """No frame at the top and on the right, and plain numbers along logarithmic axes."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_locator(LogLocator(subs=(1, 3)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
