"""What was found on a real clip, as pictures."""

from __future__ import annotations

import cv2
import numpy as np
from matplotlib.figure import Figure

from palpate.estimators.estimate import NINETY
from palpate.evaluation.real.predicted import Prediction
from palpate.evaluation.real.pressed import Press

ARROWS = 5
"""Every so many points along an axis get an arrow."""
OBSERVED, EXPECTED, BAND = "#ffd166", "#00c2ff", "#bcd9f5"


def draw_prediction(found: Prediction) -> Figure:
    """Motion since the last frame that both used, as observed and as predicted, and the stiffness that predicted it."""
    figure = Figure(figsize=(14, 5), dpi=100, layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=[1, 1.15, 0.7])
    first, last = found.follow.pictures
    axes[0].imshow(last)
    axes[0].axis("off")
    axes[0].set_title("Motion since: seen (yellow), predicted (blue)", fontsize=10)
    some = (np.rint(found.points / found.follow.spacing).astype(int) % ARROWS == 0).all(axis=1)
    for motion, colour in ((found.seen, OBSERVED), (found.expected, EXPECTED)):
        style = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.003, "color": colour}
        axes[0].quiver(*found.begun[some].T, *motion[some].T, **style)
    places, stiffness, known = found.fields
    axes[1].imshow(cv2.cvtColor(first, cv2.COLOR_RGB2GRAY), cmap="gray", alpha=0.6)
    axes[1].axis("off")
    axes[1].set_title(f"Stiffness against stretch, relative, where known ({known.mean():.0%})", fontsize=10)
    if known.any():
        logs = np.log10(stiffness[known] / np.median(stiffness[known]))
        most = max(float(np.abs(logs).max()), 1e-3)
        shown = axes[1].scatter(*places[known].T, c=logs, s=40, cmap="coolwarm", vmin=-most, vmax=most, lw=0)
        figure.colorbar(shown, ax=axes[1], shrink=0.7, label="log₁₀ over the median")
    lines = [
        f"{name}: {value:.3g}" if isinstance(value, float) else f"{name}: {value}"
        for name, value in found.measures.items()
    ]
    axes[2].axis("off")
    axes[2].text(0, 1, "\n".join(lines), va="top", family="monospace", fontsize=7.5, transform=axes[2].transAxes)
    return figure


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
