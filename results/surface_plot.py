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


def draw_surface_errors(
    places: np.ndarray, fitted: np.ndarray, softer: np.ndarray | None, hole: float, title: str
) -> Figure:
    """Draw how far measured points lie from simulated surfaces, all panels on one scale of colours.

    Means over cells are drawn, in which a sensor's noise cancels and what a wrong stiffness leaves does not. The
    difference of both surfaces is without noise: the points are the same.

    Args:
        places: across the force, from the contact, shape [P, 2] [mm].
        fitted: distances from the body as fitted; positive outside, not a number where the tool hides the surface,
            shape [P] [mm].
        softer: from one half as stiff; none = it can't bear the force.
        hole: radius of what the tool hides [mm].
        title: of the figure.
    """
    from matplotlib.patches import Circle

    panels = {"as fitted": fitted}
    if softer is not None:
        panels |= {"half as stiff": softer, "half as stiff less as fitted": softer - fitted}
    near, drawn = np.linalg.norm(places, axis=1) < HOLE_MARGIN * hole, []
    scale = "All panels on one scale, means over cells; > 0: measured outside the simulated one."
    circles = "Dashed: what the tool hides, left out. Dotted: next to the tool."
    figure = new_figure(4.6 * len(panels) + 1, 6.2, title, f"{scale} {circles}")
    rows = figure.subplots(1, len(panels), squeeze=False, sharex=True, sharey=True)[0]
    for axes, (name, distance) in zip(rows, panels.items(), strict=True):
        visible = np.isfinite(distance)
        cells = {"gridsize": CELLS, "cmap": "RdBu_r", "linewidths": 0.2}
        drawn.append(axes.hexbin(*places[visible].T, C=distance[visible], **cells))
        axes.add_patch(Circle((0, 0), hole, fill=False, linestyle="--", color=MUTED))
        axes.add_patch(Circle((0, 0), HOLE_MARGIN * hole, fill=False, linestyle=":", color=MUTED))
        mean = float(np.mean(distance[visible & near])) if (visible & near).any() else np.nan
        axes.set_title(f"{name}\n{mean:+.2f} mm next to the tool", fontsize=12)
        axes.set(xlabel="across the force [mm]", aspect="equal")
    rows[0].set_ylabel("across the force [mm]")
    limit = max(float(np.abs(np.quantile(np.asarray(each.get_array()), (0.02, 0.98))).max()) for each in drawn)
    for each in drawn:
        each.set_clim(-limit, limit)
    figure.colorbar(
        drawn[0],
        ax=list(rows),
        label=f"measured less simulated surface, up to {limit:.2f} mm",
        extend="both",
        shrink=0.8,
    )
    return figure
