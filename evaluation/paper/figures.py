"""Figure 3 of Bini 2026, and the estimates by frame. What is drawn is computed first, apart from the drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from physics.mechanics import PARAMETERS, REFERENCE_DAMPING, REFERENCE_STIFFNESS, Bounds, Mechanics

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PERCENTILES = (10, 25, 50, 75, 90)
NAMED_SHARE = 0.2
"""Clips are named on the axis when each holds more than this share of the frames, so that the names fit."""
MEDIAN, INNER, OUTER = "#14532d", "#86c59b", "#ecd9b0"
ACCENT, GREY, WARM = "#1d4e89", "#667085", "#b4432b"
LABELS = {"stiffness": "stiffness $k_s$\n[normalised]", "damping": "damping $k_d$\n[normalised]",
          "force": "force $|F|$\n[normalised]"}  # fmt: skip


@dataclass(frozen=True)
class Response:
    """The test trajectories as Figure 3 draws them, rows sorted by peak, highest first."""

    times: np.ndarray
    """Time since first contact, shape [T] [s]."""
    relative: np.ndarray
    """Displacement relative to the highest peak of all, shape [n, T], in [0, 1]."""
    percentiles: np.ndarray
    """10th, 25th, 50th, 75th and 90th percentile over the rows, shape [5, T]."""
    release: np.ndarray
    """Time of release of each row, shape [n] [s]."""
    order: np.ndarray
    """Index of the trajectory that each row shows, shape [n]."""
    peak: float
    """The highest peak, which is 1 in `relative` [scene units]."""
    left_out: int
    """Trajectories that aren't finite and so aren't shown."""


def response(trajectories: np.ndarray, load_steps: Sequence[int] | np.ndarray, mechanics: Mechanics) -> Response:
    """Relative displacement of trajectories [n, T, 3] [scene units], released after load_steps [n]."""
    distance = np.linalg.norm(np.asarray(trajectories, dtype=float), axis=2)
    finite = np.flatnonzero(np.isfinite(distance).all(axis=1))
    peaks = distance[finite].max(axis=1, initial=0.0)
    order = finite[np.argsort(-peaks, kind="stable")]
    highest = float(peaks.max(initial=0.0))
    relative = distance[order] / (highest or 1.0)
    times = mechanics.time_step * np.arange(1, distance.shape[1] + 1)
    return Response(
        times=times,
        relative=relative,
        percentiles=np.percentile(relative, PERCENTILES, axis=0) if len(order) else np.empty((5, 0)),
        release=np.asarray(load_steps)[order] * mechanics.time_step,
        order=order,
        peak=highest,
        left_out=len(distance) - len(order),
    )


def _style(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)


def _draw_heat_map(figure: Figure, axes: Axes, data: Response) -> None:
    from matplotlib.ticker import MaxNLocator

    count, step = len(data.relative), data.times[0]
    image = axes.imshow(
        data.relative, aspect="auto", interpolation="nearest", cmap="viridis", vmin=0, vmax=1,
        extent=(data.times[0] - step, data.times[-1], count + 0.5, 0.5),
    )  # fmt: skip
    if np.ptp(data.release) == 0:
        axes.axvline(data.release[0], color="white", lw=1.6, ls="--", label="release")
    else:
        rows = np.arange(1, count + 1)
        axes.vlines(data.release, rows - 0.5, rows + 0.5, color="white", lw=1.8, label="release")
    axes.set(xlabel="time since first contact [s]", ylabel="test frame, sorted by peak")
    axes.set_xlim(0, data.times[-1])
    axes.yaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 5, 10], integer=True, min_n_ticks=1))
    legend = axes.legend(loc="upper right", fontsize=9, framealpha=0.35, facecolor="black", edgecolor="none")
    for text in legend.get_texts():
        text.set_color("white")
    bar = figure.colorbar(image, ax=axes, pad=0.02)
    bar.ax.tick_params(labelsize=9)
    bar.ax.set_title("relative\ndisplacement [–]", fontsize=9)
    axes.set_title(f"(a) Each test frame (n = {count})", loc="left", fontsize=11, fontweight="bold")
    axes.tick_params(labelsize=9)


def _draw_fan(axes: Axes, data: Response) -> None:
    low, lower, median, upper, high = data.percentiles
    axes.fill_between(data.times, low, high, color=OUTER, lw=0, label="10–90th percentile")
    axes.fill_between(data.times, lower, upper, color=INNER, lw=0, label="25–75th percentile")
    axes.plot(data.times, median, color=MEDIAN, lw=2, label="median")
    release = float(np.median(data.release))
    axes.axvline(release, color="#333333", lw=1.3, ls="--", label=f"release, {release:.2f} s")
    if np.ptp(data.release) > 0:
        ends = data.release.min(), data.release.max()
        axes.axvspan(*ends, color="#333333", alpha=0.08, lw=0, label="range of releases")
    axes.set(xlabel="time since first contact [s]", ylabel="relative displacement [–]")
    axes.set_xlim(0, data.times[-1])
    axes.set_ylim(0, 1.05 * max(float(data.percentiles.max()), 1e-3))
    axes.set_title("(b) All test frames", loc="left", fontsize=11, fontweight="bold")
    axes.legend(fontsize=9, frameon=False, loc="upper right")
    _style(axes)


def draw_response(data: Response) -> Figure:
    """Figure 3: heat map sorted by peak (a) and fan chart (b), with the release marked in both."""

    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.6), dpi=150, layout="constrained")
    left, right = figure.subplots(1, 2)
    if len(data.relative):
        _draw_heat_map(figure, left, data)
        _draw_fan(right, data)
    else:
        for axes in (left, right):
            axes.text(0.5, 0.5, "no finite trajectory", ha="center", va="center", transform=axes.transAxes)
            axes.set_axis_off()
    title = f"Simulated displacement of the contact vertex, predicted θ; 1 = highest peak, {data.peak:.3g} scene units"
    if data.left_out:
        title += f"; left out, not finite: {data.left_out}"
    figure.suptitle(title, fontsize=11)
    return figure


@dataclass(frozen=True)
class ThetaSeries:
    """The estimates in the order they are drawn: by clip, then by frame; force as a magnitude."""

    values: np.ndarray
    """k_s, k_d, |F|, shape [n, 3]."""
    clip_starts: np.ndarray
    """Position at which each clip starts."""
    clip_names: tuple[str, ...]
    limits: np.ndarray
    """Admissible range of k_s, k_d, |F|, shape [3, 2]."""


def theta_series(theta: np.ndarray, clips: Sequence[str], frames: Sequence[int], bounds: Bounds) -> ThetaSeries:
    """Order θ [n, 3] of the named clips and frame indices [n] for drawing."""
    clips_array, frames_array = np.asarray(clips), np.asarray(frames)
    order = np.lexsort((frames_array, clips_array))
    values = np.asarray(theta, dtype=float)[order]
    values[:, 2] = np.abs(values[:, 2])
    names, starts = np.unique(clips_array[order], return_index=True)
    limits = np.array([bounds.stiffness, bounds.damping, bounds.force], dtype=float)
    low, high = limits[2]
    limits[2] = (0.0 if low <= 0 <= high else min(abs(low), abs(high))), max(abs(low), abs(high))
    return ThetaSeries(values, starts, tuple(map(str, names)), limits)


def _short(name: str) -> str:
    return name if len(name) <= 14 else f"{name[:6]}…{name[-7:]}"


def _draw_parameter(axes: Axes, data: ThetaSeries, column: int, constant: float | None, zoom: bool) -> None:
    from matplotlib.ticker import MaxNLocator

    values, (low, high) = data.values[:, column], data.limits[column]
    position = np.arange(1, len(values) + 1)
    for start in data.clip_starts[1:]:
        axes.axvline(start + 0.5, color="#d0d5dd", lw=0.8, zorder=0)
    if constant is not None:
        axes.axhline(constant, color=WARM, lw=1.3, ls="--", label="constant θ fitted on training contacts")
    axes.plot(position, values, ".", ms=4, color=ACCENT, label="estimate")
    axes.yaxis.set_major_locator(MaxNLocator(5))
    ends = np.append(data.clip_starts[1:], len(values))
    if (ends - data.clip_starts).min() > NAMED_SHARE * len(values):
        axes.set_xticks((data.clip_starts + ends + 1) / 2, map(_short, data.clip_names))
        axes.tick_params(axis="x", length=0)
    else:
        axes.xaxis.set_major_locator(MaxNLocator(steps=[1, 2, 5, 10], integer=True, min_n_ticks=1))
    axes.set_xlim(0.5, len(values) + 0.5)
    if zoom:
        middle, half = (values.max() + values.min()) / 2, (values.max() - values.min()) / 2
        half = max(1.15 * half, 0.01 * abs(middle), 1e-6)
        axes.set_ylim(middle - half, middle + half)
    else:
        margin = 0.06 * (high - low)
        axes.axhspan(low, high, color="#eef4fb", lw=0, zorder=-1, label="admissible range")
        axes.set_ylim(low - margin, high + margin)
        axes.set_ylabel(LABELS[PARAMETERS[column]], fontsize=10)
    _style(axes)


def draw_theta(data: ThetaSeries, constant: Sequence[float] | None = None) -> Figure:
    """θ by test frame: on the left within the admissible box, on the right zoomed to the estimates.

    Args:
        data: from `theta_series`.
        constant: (k_s, k_d, F) of the constant baseline, drawn as a dashed line.
    """

    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.4), dpi=150, layout="constrained")
    grid = figure.subplots(3, 2, sharex=True)
    references = (REFERENCE_STIFFNESS, REFERENCE_DAMPING, None)
    for column in range(3):
        value = None if constant is None else abs(constant[column])
        _draw_parameter(grid[column, 0], data, column, value, zoom=False)
        _draw_parameter(grid[column, 1], data, column, value, zoom=True)
        reference, (low, high) = references[column], data.limits[column]
        if reference is not None and low <= reference <= high:
            grid[column, 0].axhline(reference, color=GREY, lw=1.2, ls=":", label="literature value")
        elif reference is not None:
            grid[column, 0].text(
                0.99, 0.96, f"literature value {reference:g}: outside the range", fontsize=8, color=GREY, ha="right",
                va="top", transform=grid[column, 0].transAxes,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 2},
            )  # fmt: skip
    grid[0, 0].set_title("Within the admissible range", loc="left", fontsize=11, fontweight="bold")
    grid[0, 1].set_title("Zoomed to the estimates", loc="left", fontsize=11, fontweight="bold")
    for axes in grid[2]:
        axes.set_xlabel("test frames in order, by clip")
    entries = {}
    for axes in grid[:, 0]:
        entries.update(dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True)))
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    count, clips = len(data.values), len(data.clip_names)
    figure.suptitle(f"Estimated parameters by test frame (n = {count}, clips: {clips})", fontsize=11)
    return figure


def draw_next_depth(real: np.ndarray, predicted: np.ndarray) -> Figure:
    """Real next depth map beside the predicted one and their absolute difference.

    Args:
        real: D_t+1, shape [H, W] [scene units], 0 = invalid.
        predicted: G_AB's answer, same shape.
    """

    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 2.9), layout="constrained", dpi=100)
    panels = figure.subplots(1, 3)
    difference = np.abs(predicted - real)
    pictures = {"real next depth": real, "predicted": predicted, "|predicted − real|": difference}
    highest = max(float(real.max()), float(predicted.max()))
    for axes, (title, picture) in zip(panels, pictures.items(), strict=True):
        limit = highest if picture is not difference else None
        image = axes.imshow(picture, cmap="viridis" if limit else "magma", vmin=0, vmax=limit)
        axes.set_title(title, fontsize=11)
        axes.set(xticks=[], yticks=[])
        figure.colorbar(image, ax=axes).set_label("scene units", fontsize=9)
    return figure
