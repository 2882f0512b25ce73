"""The picture of how far measured points of tissue lie from simulated surfaces.

matplotlib is imported where something is drawn, so that a program starts, and may end, without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from palpate.results.panels import MUTED, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CELLS = 16
"""Across a picture of surface errors, in each of which points' distances are averaged."""
HOLE_MARGIN = 1.5
"""Radius of what is next to the tool in it, over that of its hole."""


def draw_surface_errors(places: np.ndarray, distance: np.ndarray, hole: float, title: str) -> Figure:
    """Draw how far measured points lie from the simulated surface; means over cells, in which a sensor's noise cancels.

    Args:
        places: across the force, from the contact, shape [P, 2] [mm].
        distance: from the body as fitted; positive outside, not a number where the tool hides the surface, shape [P]
            [mm].
        hole: radius of what the tool hides [mm].
        title: of the figure.
    """
    from matplotlib.patches import Circle

    visible, near = np.isfinite(distance), np.linalg.norm(places, axis=1) < HOLE_MARGIN * hole
    circles = "Dashed: what the tool hides, left out. Dotted: next to the tool."
    figure = new_figure(5.6, 6.2, title, f"Means over cells; > 0: measured outside the simulated surface. {circles}")
    axes = figure.subplots()
    drawn = axes.hexbin(*places[visible].T, C=distance[visible], gridsize=CELLS, cmap="RdBu_r", linewidths=0.2)
    axes.add_patch(Circle((0, 0), hole, fill=False, linestyle="--", color=MUTED))
    axes.add_patch(Circle((0, 0), HOLE_MARGIN * hole, fill=False, linestyle=":", color=MUTED))
    mean = float(np.mean(distance[visible & near])) if (visible & near).any() else np.nan
    axes.set_title(f"{mean:+.2f} mm next to the tool", fontsize=12)
    axes.set(xlabel="across the force [mm]", ylabel="across the force [mm]", aspect="equal")
    limit = float(np.abs(np.quantile(np.asarray(drawn.get_array()), (0.02, 0.98))).max())
    drawn.set_clim(-limit, limit)
    said = f"measured less simulated surface, up to {limit:.2f} mm"
    figure.colorbar(drawn, ax=axes, label=said, extend="both", shrink=0.8)
    return figure
