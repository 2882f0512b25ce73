"""The plan drawn: tissue, ways and forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from palpate.planning.press import PressCurve
from palpate.planning.roadmap import MILLI, Plan
from palpate.planning.scene import Placed, PlanScene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAMPLES = 400
"""Of a way, in addition to the places where a simulated force is known."""


@dataclass(frozen=True, eq=False)
class Pressed:
    """A press on the way."""

    kind: str
    """Name of the tissue."""
    piece: Placed
    height: float
    """Of the plane over the block's foot [m]."""
    curve: PressCurve
    """Simulated."""
    begin: float
    """Where on the whole way the tip touches [m]."""
    length: float
    """How far it presses [m]."""


def force_along(presses: Sequence[Pressed], way: float) -> tuple[np.ndarray, np.ndarray]:
    """Force that the tip presses with along its line; 0 where it touches nothing, and once the tissue has let it by.

    Args:
        presses: of one way.
        way: its length [m].

    Returns:
        How far the tip has gone [m], rising, and the force [N], shapes [S].
    """
    known = [each.begin + np.append(each.curve.lengths, each.length) for each in presses]
    gone = np.unique(np.clip(np.concatenate([np.linspace(0, way, SAMPLES), *known]), 0, way)).astype(float)
    force = np.zeros(len(gone))
    for each in presses:
        pressed = gone - each.begin
        let_by = min(each.length, each.curve.lengths[-1]) + 1e-9
        force += np.where(pressed <= let_by, np.interp(pressed, each.curve.lengths, each.curve.force), 0)
    return gone, force


def draw_plan(scene: PlanScene, ways: Mapping[str, tuple[Plan, Sequence[Pressed]]]) -> Figure:
    """A figure: the plane with both ways and the tissue pushed aside along the plan's, and the forces along both.

    Args:
        scene: as read.
        ways: what was found, planned, and the shortest, with the presses of either.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon

    figure = Figure(figsize=(11, 5), layout="constrained")
    axes, forces = figure.subplots(1, 2, width_ratios=[3, 2])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for piece, colour in [(piece, "mistyrose") for _, piece in scene.pieces] + [(p, "0.4") for p in scene.obstacles]:
        outline = MILLI * piece.outside_frame(corners * piece.half)
        axes.add_patch(Polygon(outline, facecolor=colour, edgecolor="indianred"))
    plan, presses = ways["planned"]
    for each in presses:
        moved = each.curve.skin.vertices + each.curve.displacement
        # Only what lies around the plane shows in it.
        near = np.abs(each.curve.skin.vertices[:, 2] - each.height) < 0.0015
        place = MILLI * each.piece.outside_frame(moved[near, :2])
        axes.scatter(*place.T, s=4, color="firebrick", label=f"{each.kind} pushed aside")
    styles = {"color": "navy", "marker": "o", "markersize": 3}, {"color": "0.3", "linestyle": "--"}
    for (name, (found, felt)), style in zip(ways.items(), styles, strict=True):
        axes.plot(*(MILLI * found.places.T), label=f"{name}: cost {found.cost:.1f}", **style)
        gone, force = force_along(felt, found.way / MILLI)
        peak = f"up to {force.max():.2f} N" if felt else "touches nothing, 0 N"
        forces.plot(MILLI * gone, force, label=f"{name}: {peak}", **style | {"marker": ""})
    for place in MILLI * np.array([scene.start, scene.goal]):
        axes.add_patch(Circle(tuple(place), MILLI * scene.tip_radius, fill=False, color="navy"))
    low, high = MILLI * np.array(scene.area)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    axes.set_title(f"α = {scene.alpha:g}: deformation {plan.deformation:.2f} mJ, way {plan.way:.1f} mm")
    axes.legend(fontsize=8, loc="upper left")
    forces.set(xlabel="distance along the way [mm]", ylabel="force of the tip [N]", title="Force along both ways")
    forces.set_ylim(top=1.25 * forces.get_ylim()[1])  # room for the legend
    forces.legend(fontsize=8, loc="upper left")
    return figure
