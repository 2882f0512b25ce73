"""What was found on a real clip, as pictures."""

from __future__ import annotations

import cv2
import numpy as np
from matplotlib.figure import Figure

from estimators.estimate import NINETY
from evaluation.real.predicted import Prediction
from evaluation.real.pressed import Press
from evaluation.real.pulled import Pull

UNKNOWN = 1.0
"""Fields are drawn where the standard deviation of their logarithm is below this."""
ARROWS = 5
"""Every so many points along an axis get an arrow."""
SEEN, EXPECTED, BAND = "#ffd166", "#00c2ff", "#bcd9f5"


def draw_pull(found: Pull) -> Figure:
    """Motion of the last judged frame, both fields on the first picture, skill and force over time."""
    figure = Figure(figsize=(14, 7.4), dpi=100, layout="constrained")
    axes = figure.subplots(2, 3)
    _draw_motion(axes[0, 0], found)
    log, sd = found.fit.log_stiffness
    _draw_field(figure, axes[0, 1], found, log, sd, "Stiffness over its mean")
    anchor, anchor_sd = found.fit.log_anchor
    _draw_field(figure, axes[0, 2], found, anchor, anchor_sd, "Foundation over stiffness")
    for name, values in found.skills.items():
        axes[1, 0].plot(found.judged, values, marker="o", ms=3, ls="-" if "field" in name else ":", label=name)
    lowest = min([0.0, *(float(values.min()) for values in found.skills.values())])
    axes[1, 0].set(ylim=(lowest, 1), xlabel="frame after the first", ylabel="skill: 1 − error / motion")
    axes[1, 0].set_title("Motion of the frames kept back", fontsize=10)
    if found.skills:
        axes[1, 0].legend(fontsize=8)
    force, force_sd = found.force
    frames = [index for index, frame in enumerate(found.follow.frames, start=1) if frame.tells]
    axes[1, 1].fill_between(frames, force - NINETY * force_sd, force + NINETY * force_sd, color=BAND, lw=0)
    axes[1, 1].plot(frames, force, marker="o", ms=3)
    axes[1, 1].set(xlabel="frame after the first", ylabel="force over that of the last frame")
    axes[1, 1].set_title("Force at the grip (90 % band of the fitted sheet)", fontsize=10)
    told = [
        f"{name}: {value:.3g}" if isinstance(value, float) else f"{name}: {value}"
        for name, value in found.measures.items()
    ]
    axes[1, 2].axis("off")
    axes[1, 2].text(0, 1, "\n".join(told), va="top", family="monospace", fontsize=7.5, transform=axes[1, 2].transAxes)
    return figure


def draw_prediction(found: Prediction) -> Figure:
    """Motion since the last frame that both saw, as seen and as predicted, and the stiffness that predicted it."""
    figure = Figure(figsize=(14, 5), dpi=100, layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=[1, 1.15, 0.7])
    first, last = found.follow.pictures
    axes[0].imshow(last)
    axes[0].axis("off")
    axes[0].set_title("Motion since: seen (yellow), predicted (blue)", fontsize=10)
    some = (np.rint(found.points / found.follow.spacing).astype(int) % ARROWS == 0).all(axis=1)
    for motion, colour in ((found.seen, SEEN), (found.expected, EXPECTED)):
        told = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.003, "color": colour}
        axes[0].quiver(*found.begun[some].T, *motion[some].T, **told)
    places, stiffness, known = found.fields
    axes[1].imshow(cv2.cvtColor(first, cv2.COLOR_RGB2GRAY), cmap="gray", alpha=0.6)
    axes[1].axis("off")
    axes[1].set_title(f"Stiffness against stretch, relative, where known ({known.mean():.0%})", fontsize=10)
    if known.any():
        logs = np.log10(stiffness[known] / np.median(stiffness[known]))
        most = max(float(np.abs(logs).max()), 1e-3)
        shown = axes[1].scatter(*places[known].T, c=logs, s=40, cmap="coolwarm", vmin=-most, vmax=most, lw=0)
        figure.colorbar(shown, ax=axes[1], shrink=0.7, label="log₁₀ over the median")
    told = [
        f"{name}: {value:.3g}" if isinstance(value, float) else f"{name}: {value}"
        for name, value in found.measures.items()
    ]
    axes[2].axis("off")
    axes[2].text(0, 1, "\n".join(told), va="top", family="monospace", fontsize=7.5, transform=axes[2].transAxes)
    return figure


def _draw_motion(axes, found: Pull) -> None:
    """Where points went and where the sheet puts them, on the last picture."""
    points, frame = found.follow.points, found.follow.frames[-1]
    axes.imshow(found.follow.pictures[1])
    axes.axis("off")
    axes.set_title("Motion: seen (yellow), predicted (blue), grip (red)", fontsize=10)
    if not frame.tells:
        return
    moved, _ = found.fit.predict(frame)
    cells = np.rint(points / found.follow.spacing).astype(int)
    some = frame.around & (cells % ARROWS == 0).all(axis=1)
    for motion, colour in ((frame.moved, SEEN), (moved, EXPECTED)):
        told = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.003, "color": colour}
        axes.quiver(*points[some].T, *motion[some].T, **told)
    axes.plot(*points[frame.gripped].T, ".", ms=2, color="#e63946")


def _draw_field(figure: Figure, axes, found: Pull, log: np.ndarray, sd: np.ndarray, name: str) -> None:
    """A field over the first picture, grey where it isn't known."""
    axes.imshow(cv2.cvtColor(found.follow.pictures[0], cv2.COLOR_RGB2GRAY), cmap="gray", alpha=0.6)
    known = sd < UNKNOWN
    if known.any():
        shown = axes.scatter(
            *found.follow.points[known].T, c=log[known] / np.log(10), s=9, cmap="coolwarm", marker="s", lw=0
        )
        figure.colorbar(shown, ax=axes, shrink=0.7, label="log₁₀")
    axes.axis("off")
    axes.set_title(f"{name}, where known to a factor e ({known.mean():.0%})", fontsize=10)


def draw_press(found: Press) -> Figure:
    """Measured and predicted force over time."""
    figure = Figure(figsize=(9, 4.2), dpi=100, layout="constrained")
    axes = figure.subplots()
    frames = np.arange(len(found.predicted))
    low, high = found.predicted - NINETY * found.sd, found.predicted + NINETY * found.sd
    axes.fill_between(frames, low, high, color=BAND, lw=0, label="90 % interval")
    axes.plot(frames, found.predicted, label="predicted from the dent")
    axes.plot(np.arange(len(found.force)), found.force, "k.", ms=4, label="measured")
    axes.axvspan(found.fitted[0], found.fitted[1] - 1, color="#ecd9b0", alpha=0.6, lw=0, label="fitted")
    axes.set(xlabel="frame", ylabel="force [N]", xlim=(40, min(len(frames), 130)))
    axes.legend(fontsize=8)
    return figure
