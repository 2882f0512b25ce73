"""Figure 3 of Bini 2026."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palpate.physics.mechanics import Mechanics
from palpate.results.paper.simulated import distances


def _draw_heat_map(figure: Figure, axes: Axes, times: np.ndarray, relative: np.ndarray, release: np.ndarray) -> None:
    count = len(relative)
    image = axes.imshow(
        relative, aspect="auto", interpolation="nearest", cmap="viridis", vmin=0, vmax=1,
        extent=(0, times[-1], count + 0.5, 0.5),
    )  # fmt: skip
    rows = np.arange(1, count + 1)
    axes.vlines(release, rows - 0.5, rows + 0.5, color="white", lw=1.8)
    axes.set(xlim=(0, times[-1]), xlabel="time since first contact [s]", ylabel="test frame, sorted by peak")
    axes.set_title(f"(a) Each test frame (n = {count}); white: release", loc="left")
    figure.colorbar(image, ax=axes, pad=0.02).set_label("relative displacement [–]")


def _draw_fan(axes: Axes, times: np.ndarray, relative: np.ndarray, release: np.ndarray) -> None:
    low, lower, median, upper, high = np.percentile(relative, (10, 25, 50, 75, 90), axis=0)
    axes.fill_between(times, low, high, color="#ecd9b0", lw=0, label="10–90th percentile")
    axes.fill_between(times, lower, upper, color="#86c59b", lw=0, label="25–75th percentile")
    axes.plot(times, median, color="#14532d", lw=2, label="median")
    axes.axvspan(release.min(), release.max(), color="#667085", alpha=0.15, lw=0)
    axes.axvline(np.median(release), color="#667085", lw=1.3, ls="--", label="release (median)")
    axes.set(xlim=(0, times[-1]), xlabel="time since first contact [s]", ylabel="relative displacement [–]")
    axes.set_title("(b) All test frames", loc="left")
    axes.legend()


def draw_response(trajectories: np.ndarray, release: np.ndarray, mechanics: Mechanics) -> Figure:
    """Draw figure 3: heat map sorted by peak (a) and fan chart (b), with the release marked in both.

    Displacements are relative to the highest peak of all; trajectories that aren't finite are left out and counted.

    Args:
        trajectories: displacement of the contact vertex, shape [n, T, 3] [scene units].
        release: when each load ends, shape [n] [s].
        mechanics: time step of the rollout.
    """
    distance = distances(trajectories)
    finite = np.flatnonzero(~np.isnan(distance[:, 0]))
    order = finite[np.argsort(-distance[finite].max(axis=1), kind="stable")]
    peak = distance[order].max(initial=0.0)
    figure = Figure(figsize=(11, 4.6), dpi=150, layout="constrained")
    title = f"Simulated displacement of the contact vertex, predicted θ; 1 = highest peak, {peak:.3g} scene units"
    figure.suptitle(f"{title}; left out, not finite: {len(distance) - len(order)}")
    if len(order):
        left, right = figure.subplots(1, 2)
        shown = mechanics.times, distance[order] / (peak or 1.0), release[order]
        _draw_heat_map(figure, left, *shown)
        _draw_fan(right, *shown)
    return figure
