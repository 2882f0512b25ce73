"""Figures of the benchmark: estimates against truth."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from palpate.data.synthetic.truth import REGIMES
from palpate.evaluation.recovery.estimators import CONSTANT
from palpate.evaluation.recovery.scores import Scores
from palpate.physics.identifiability import LIMIT

STYLES = {
    "under-damped": {"color": "#1d4e89", "marker": "o"},
    "critical": {"color": "#c77d0a", "marker": "s"},
    "over-damped": {"color": "#3f8f4f", "marker": "^"},
}
"""Regimes differ by lightness and marker as well."""
SYMBOLS = ("stiffness $k_s$", "damping $k_d$", "force $|F|$")
GREY, PALE = "#667085", "#cdd3dc"


def draw_recovery(scores: Scores) -> Figure:
    """Estimated against true parameters; bars are the Cramér–Rao bound around each estimate.

    The dotted line is the best constant for the clips whose bound lies below the limit.
    """
    figure = Figure(figsize=(12, 4.4), dpi=150, layout="constrained")
    figure.suptitle(
        f"{scores.estimator} on {scores.suite}: estimated against true, bars = Cramér–Rao bound", fontsize=11
    )
    for column, axes in enumerate(figure.subplots(1, 3)):
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


def figures(scores: Sequence[Scores]) -> Iterator[tuple[str, Figure]]:
    """All figures with their file names; a constant has none."""
    for item in scores:
        if item.estimator != CONSTANT and item.rows:
            yield f"recovery_{item.estimator}_{item.suite}.png", draw_recovery(item)


def _limits(values: np.ndarray) -> tuple[float, float]:
    """Ends of a logarithmic axis with a margin."""
    return float(values.min() / 1.3), float(values.max() * 1.3)


def _plain_axes(axes: Axes) -> None:
    """No frame at the top and on the right, and plain numbers along logarithmic axes."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 3)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
