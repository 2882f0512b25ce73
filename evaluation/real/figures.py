"""What was found on a real clip, as pictures."""

from __future__ import annotations

import cv2
import numpy as np
from matplotlib.figure import Figure

from palpate.evaluation.real.predicted import Prediction

ARROWS = 5
"""Every so many points along an axis get an arrow."""
OBSERVED, EXPECTED = "#ffd166", "#00c2ff"


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
