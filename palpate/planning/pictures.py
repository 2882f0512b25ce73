"""The plan drawn: tissue and ways."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from palpate.planning.roadmap import MILLI, Plan
from palpate.planning.scene import PlanScene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_plan(scene: PlanScene, ways: Mapping[str, Plan]) -> Figure:
    """Draw the plane with tissue and both ways, the planned one and the shortest."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon

    figure = Figure(figsize=(7, 5), layout="constrained")
    axes = figure.subplots()
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for piece, colour in [(piece, "mistyrose") for _, piece in scene.pieces] + [(p, "0.4") for p in scene.obstacles]:
        outline = MILLI * piece.outside_frame(corners * piece.half)
        axes.add_patch(Polygon(outline, facecolor=colour, edgecolor="indianred"))
    for (name, found), (form, colour) in zip(ways.items(), (("o-", "navy"), ("--", "0.3")), strict=True):
        axes.plot(*(MILLI * found.places.T), form, color=colour, markersize=3, label=f"{name}: cost {found.cost:.1f}")
    for place in MILLI * np.array([scene.start, scene.goal]):
        axes.add_patch(Circle(tuple(place), MILLI * scene.tip_radius, fill=False, color="navy"))
    low, high = MILLI * np.array(scene.area)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    plan = ways["planned"]
    axes.set_title(f"α = {scene.alpha:g}: deformation {plan.deformation:.2f} mJ, way {plan.way:.1f} mm")
    axes.legend(fontsize=8, loc="upper left")
    return figure
