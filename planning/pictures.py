"""The plan drawn: tissue, ways and forces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from planning.press import PressCurve
from planning.roadmap import Plan
from planning.scene import Placed, PlanScene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_plan(
    scene: PlanScene, plan: Plan, direct: Plan, presses: Sequence[tuple[str, PressCurve, Placed, float]]
) -> Figure:
    """A figure: the plane with both ways and the tissue pushed aside along the plan's, and the forces over its presses.

    Args:
        scene: as read.
        plan: what was found.
        direct: the shortest way.
        presses: of the plan: label, simulated curve, the piece, and the height of the plane over its foot [m].
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon

    figure = Figure(figsize=(11, 5), layout="constrained")
    axes, forces = figure.subplots(1, 2, width_ratios=[3, 2])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for piece, colour in [(piece, "mistyrose") for _, piece in scene.tissue] + [(p, "0.4") for p in scene.obstacles]:
        outline = 1000 * piece.outside_frame(corners * piece.half)
        axes.add_patch(Polygon(outline, facecolor=colour, edgecolor="indianred"))
    for label, curve, piece, height in presses:
        moved = curve.skin.vertices + curve.displacement
        # Only what lies around the plane shows in it.
        near = np.abs(curve.skin.vertices[:, 2] - height) < 0.0015
        place = 1000 * piece.outside_frame(moved[near, :2])
        axes.scatter(*place.T, s=4, color="firebrick", label=f"{label} pushed aside")
        forces.plot(1000 * curve.lengths, curve.force, marker="o", markersize=3, label=label)
    axes.plot(*(1000 * direct.places.T), "--", color="0.3", label=f"shortest: {direct.cost:.1f}")
    axes.plot(*(1000 * plan.places.T), "-o", color="navy", markersize=3, label=f"planned: {plan.cost:.1f}")
    for place in (scene.start, scene.goal):
        axes.add_patch(Circle(tuple(1000 * place), 1000 * scene.tip_radius, fill=False, color="navy"))
    low, high = 1000 * scene.area
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    axes.set_title(f"α = {scene.alpha:g}: deformation {plan.deformation:.2f} mJ, way {plan.way:.1f} mm")
    axes.legend(fontsize=8, loc="upper left")
    forces.set(xlabel="pressed [mm]", ylabel="force of the tip [N]", title="along the planned way")
    if presses:
        forces.legend(fontsize=8)
    else:
        forces.text(0.5, 0.5, "it touches nothing", ha="center", transform=forces.transAxes)
    return figure
