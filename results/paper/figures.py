"""Figure 3 of Bini 2026, the estimates by frame, and a predicted next depth map next to the real one."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palpate.physics.mechanics import REFERENCE_DAMPING, REFERENCE_STIFFNESS, Mechanics
from palpate.results.paper.simulated import distances

PERCENTILES = (10, 25, 50, 75, 90)
MEDIAN_COLOUR, INNER_COLOUR, OUTER_COLOUR = "#14532d", "#86c59b", "#ecd9b0"
ACCENT, GREY, WARM, LIGHT, BOX = "#1d4e89", "#667085", "#b4432b", "#d0d5dd", "#eef4fb"
LITERATURE = {"stiffness": REFERENCE_STIFFNESS, "damping": REFERENCE_DAMPING}


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
    low, lower, median, upper, high = np.percentile(relative, PERCENTILES, axis=0)
    axes.fill_between(times, low, high, color=OUTER_COLOUR, lw=0, label="10–90th percentile")
    axes.fill_between(times, lower, upper, color=INNER_COLOUR, lw=0, label="25–75th percentile")
    axes.plot(times, median, color=MEDIAN_COLOUR, lw=2, label="median")
    axes.axvspan(release.min(), release.max(), color=GREY, alpha=0.15, lw=0)
    axes.axvline(np.median(release), color=GREY, lw=1.3, ls="--", label="release (median)")
    axes.set(xlim=(0, times[-1]), xlabel="time since first contact [s]", ylabel="relative displacement [–]")
    axes.set_title("(b) All test frames", loc="left")
    axes.legend()


def draw_response(trajectories: np.ndarray, release: np.ndarray, mechanics: Mechanics) -> Figure:
    """Figure 3: heat map sorted by peak (a) and fan chart (b), with the release marked in both.

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
    figure.suptitle(
        f"Simulated displacement of the contact vertex, predicted θ; 1 = highest peak, {peak:.3g} scene units; "
        f"left out, not finite: {len(distance) - len(order)}"
    )
    if len(order):
        left, right = figure.subplots(1, 2)
        shown = mechanics.times, distance[order] / (peak or 1.0), release[order]
        _draw_heat_map(figure, left, *shown)
        _draw_fan(right, *shown)
    return figure


def draw_theta(frames: pd.DataFrame, spread: pd.DataFrame) -> Figure:
    """θ by test frame: on the left within the admissible box, on the right zoomed to the estimates.

    Args:
        frames: one row a test frame with its clip and parameters, in order.
        spread: admissible range (`low`, `high`) and constant baseline by parameter; not a number = there is none.
    """

    figure = Figure(figsize=(11, 6.4), dpi=150, layout="constrained")
    figure.suptitle(f"Estimated parameters by test frame (n = {len(frames)}, clips: {frames['clip'].nunique()})")
    grid = figure.subplots(3, 2, sharex=True)
    position = np.arange(1, len(frames) + 1)
    changes = position[frames["clip"] != frames["clip"].shift()][1:] - 0.5
    for (box, zoom), (name, row) in zip(grid, spread.iterrows(), strict=True):
        for axes in (box, zoom):
            axes.plot(position, frames[name], ".", ms=4, color=ACCENT, label="estimate")
            for change in changes:
                axes.axvline(change, color=LIGHT, lw=0.8, zorder=0)
        box.axhspan(row["low"], row["high"], color=BOX, lw=0, zorder=-1, label="admissible range")
        box.axhline(row["constant"], color=WARM, lw=1.3, ls="--", label="constant θ fitted on training contacts")
        box.axhline(LITERATURE.get(str(name), np.nan), color=GREY, ls=":", label="literature value, where in range")
        margin = 0.06 * (row["high"] - row["low"])
        box.set(ylabel=f"{name}\n[normalised]", ylim=(row["low"] - margin, row["high"] + margin))
    for axes, title in zip(grid[0], ("Within the admissible range", "Zoomed to the estimates"), strict=True):
        axes.set_title(title, loc="left")
    for axes in grid[-1]:
        axes.set(xlabel="test frames in order; grey lines separate clips", xlim=(0.5, len(frames) + 0.5))
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def draw_next_depth(real: np.ndarray, predicted: np.ndarray) -> Figure:
    """Real next depth map, the predicted one, and their absolute difference, side by side.

    Args:
        real: D_t+1, shape [H, W] [scene units], 0 = invalid.
        predicted: output of G_AB, same shape.
    """

    figure = Figure(figsize=(13, 2.9), layout="constrained", dpi=100)
    highest = max(float(real.max()), float(predicted.max()))
    panels = (
        ("real next depth", real, "viridis", highest),
        ("predicted", predicted, "viridis", highest),
        ("|predicted − real|", np.abs(predicted - real), "magma", None),
    )
    for axes, (title, picture, colours, limit) in zip(figure.subplots(1, 3), panels, strict=True):
        image = axes.imshow(picture, cmap=colours, vmin=0, vmax=limit)
        axes.set(title=title, xticks=[], yticks=[])
        figure.colorbar(image, ax=axes).set_label("scene units")
    return figure
