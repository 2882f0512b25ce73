"""Panels of grips and of fields of stiffness, and what pictures of results have in common.

matplotlib is imported where something is drawn, so that a program starts, and may end, without it.
"""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from palpate.estimators.estimate import LEAST_SKILL, NINETY
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.online.particle_field import FieldEstimate
from palpate.results.verdicts import digits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, MUTED, GRID = "#1f2937", "#6b7280", "#e5e7eb"
NOTICE = "palpate: research software, not a medical device."
OBSERVED, SIMULATED, RELEASE, FAR_COLOR = "#4b5563", "#7c3aed", "#ea580c", "#dc2626"
FIELD_COLORS = "#2563eb", "#0d9488"
"""Of stiffness against stretch and against bending."""
MOST_ARROWS = 300
"""About so many followed points are drawn with their motion."""
MAP_RANGE = 3.0
"""Largest ratio with a colour of its own in maps of stiffness."""


def draw_grip(axes: Axes, grip: GripEstimate) -> None:
    """Force at the grip over time, over that of the last frame."""
    low, high = grip.force - NINETY * grip.force_sd, grip.force + NINETY * grip.force_sd
    axes.fill_between(grip.times, low, high, color=SIMULATED, alpha=0.25, lw=0, label="90 % interval")
    axes.plot(grip.times, grip.force, "o-", ms=4, lw=1.5, color=SIMULATED, label="force along that of the last frame")
    name_axes(axes, "force at the grip\nover the last one [1]", "upper left")


def draw_explained(axes: Axes, found: FieldEstimate) -> None:
    """How far tissue moved and by how much the simulation missed that, a frame; and both in the last one."""
    whole, axes = axes, axes.inset_axes((0.04, 0, 0.46, 1))
    whole.set_axis_off()
    observed, predicted, left = found.course.T
    draw_curve(axes, found.times, observed, OBSERVED, "observed")
    draw_curve(axes, found.times, predicted, SIMULATED, "simulated, moved by the instrument alone")
    axes.fill_between(found.times, 0, left, color=FAR_COLOR, alpha=0.2, lw=0, label="difference of both")
    axes.set_ylim(0, 1.25 * top_of(observed, predicted, left))
    name_axes(axes, "motion of the tissue around\n(root mean square) [px]", "upper left")
    shown = _picture_axes(whole.inset_axes((0.54, 0, 0.46, 1)), found.picture)
    apart = max(1, round(len(found.points) / MOST_ARROWS))
    visible = np.flatnonzero(np.isfinite(found.observed).all(axis=1))[::apart]
    for motion, color, name in ((found.observed, "white", "observed"), (found.predicted, SIMULATED, "simulated")):
        (column, row), (right, down) = found.points[visible].T, motion[visible].T
        shown.quiver(
            column, row, right, down, angles="xy", scale_units="xy", scale=1, width=0.004, color=color,
            label=name, edgecolor=INK, lw=0.3,
        )  # fmt: skip
    shown.legend(loc="lower right", framealpha=0.85, fontsize=10, facecolor="#9ca3af")
    shown.set_xlabel("motion until the last frame, from where tissue was at rest", loc="left", fontsize=10, color=INK)


def draw_field(axes: Axes, found: FieldEstimate) -> None:
    """How much is explained and determined over time, quantiles of stiffness, and its map at rest."""
    whole, axes = axes, axes.inset_axes((0.04, 0, 0.25 if found.determined else 0.55, 1))
    whole.set_axis_off()
    names = ("distance_stiffness", "shape_stiffness")
    rows = found.numbers
    axes.axhline(LEAST_SKILL, color=FAR_COLOR, lw=1, ls="--", label=f"least that counts, {LEAST_SKILL:.0%}")
    draw_curve(axes, found.times, rows["skill"], SIMULATED, "motion explained so far")
    kinds = list(zip(names, FIELD_COLORS, ("against stretch", "against bending"), strict=True))
    for (_, color, label), share in zip(kinds, ("field_known", "shape_known"), strict=True):
        axes.plot(found.times, rows[share], "s-", ms=3, lw=1, color=color, label=f"particles determined {label}")
    axes.set(ylim=(-0.05, 1.6), yticks=np.linspace(0, 1, 5), xlim=(found.times[0], max(found.times[-1], 1e-3)))
    name_axes(axes, "share [1]", "upper left", 8.5)
    if found.determined:
        course = whole.inset_axes((0.37, 0, 0.22, 1))
        for name, color, label in kinds:
            low, middle, high = (rows[f"{name}{end}"] for end in ("_low", "", "_high"))
            if np.isnan(middle).all():
                continue
            draw_curve(course, found.times, middle, color, f"{label}, median")
            course.fill_between(found.times, low, high, color=color, alpha=0.2, lw=0, label="10 to 90 %")
        course.set(yscale="log", xlim=axes.get_xlim())
        name_axes(course, "stiffness where it is\ndetermined [relative]", size=8.5)
    shape = not found.last.known.any() and found.last.shape_known.any()
    _draw_particles(whole.inset_axes((0.62, 0, 0.34, 1)), found, shape=bool(shape))


def _draw_particles(axes: Axes, found: FieldEstimate, *, shape: bool) -> None:
    """Stiffness over its median where it is determined, on the run's first picture; that of shapes if asked for."""
    from matplotlib.colors import LogNorm

    _picture_axes(axes, found.picture, darkened=0.6)
    values, known = (found.last.shape, found.last.shape_known) if shape else (found.last.distance, found.last.known)
    faces = found.last.faces[known[found.last.faces].all(axis=1)]
    what = "bending" if shape else "stretch"
    if len(faces):
        ratio = np.exp(np.log(values[faces] / np.median(values[known])).mean(axis=1))
        drawn = axes.tripcolor(
            *found.places.T, faces, facecolors=ratio, cmap="coolwarm", norm=LogNorm(1 / MAP_RANGE, MAP_RANGE),
            alpha=0.8, edgecolors="none", antialiased=False,
        )  # fmt: skip
        _ratio_bar(axes, drawn)
        title = f"stiffness against {what} over its median; darkened: not determined"
    else:
        title = "stiffness: determined nowhere"
    axes.set_title(title, loc="left", fontsize=10, color=INK)


def _picture_axes(axes: Axes, picture: np.ndarray, darkened: float = 0.0) -> Axes:
    """Axes in a picture's pixels, with the picture, darkened by a share."""
    height, width = picture.shape[:2]
    axes.imshow(((1 - darkened) * picture).astype(np.uint8), extent=(0, width, height, 0))
    axes.set(xticks=[], yticks=[], xlim=(0, width), ylim=(height, 0))
    return axes


def _ratio_bar(axes: Axes, drawn: Any) -> None:
    """A scale of ratios next to a map."""
    ends = np.array([1 / MAP_RANGE, 0.5, 1, 2, MAP_RANGE])
    bar = axes.figure.colorbar(drawn, cax=axes.inset_axes((1.02, 0, 0.03, 1)), ticks=ends, extend="both")
    bar.set_ticklabels([f"×{digits(end, 2)}" for end in ends])
    bar.minorticks_off()


def name_axes(axes: Axes, quantity: str, place: Literal["best", "upper left"] = "best", size: float = 10) -> None:
    """A quantity over a contact's time: names of the axes, a legend and a grid."""
    axes.set(xlabel="time since the first frame in contact [s]", ylabel=quantity)
    axes.legend(loc=place, framealpha=0.85, fontsize=size)
    axes.grid(color=GRID, lw=0.8)


def draw_curve(axes: Axes, times: np.ndarray, values: np.ndarray, color: str, label: str) -> None:
    """Values over time, a dot each."""
    axes.plot(times, values, "o-", ms=4, lw=1, color=color, label=label)


def top_of(*values: np.ndarray) -> float:
    """Upper end of an axis that begins at 0 and has room above the values; 1 without any."""
    return 1.12 * float(np.fmax.reduce(np.concatenate(values), initial=0.0)) or 1.0


def new_figure(width: float, height: float, title: str, subtitle: str) -> Figure:
    """A figure of a size [inches of 100 px] with a title above what will be drawn and a footer below it."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = Figure(figsize=(width, height), dpi=100, layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12))
    heading = "\n".join(lines_of(title, round(3.5 * width)))
    figure.suptitle(heading, x=0.01, ha="left", fontsize=18, fontweight="bold", color=INK)
    footer = "\n".join([*lines_of(subtitle, round(9.33 * width)), NOTICE])
    figure.supxlabel(footer, x=0.01, ha="left", fontsize=10, color=MUTED, linespacing=1.4)
    return figure


def lines_of(text: str, width: int = 140) -> list[str]:
    """A text in lines of at most `width` characters, as matplotlib shows it letter by letter."""
    # Stand-ins for bytes of file names that are not UTF-8 can't be drawn, and a pair of $ would begin a formula.
    return [line.replace("$", r"\$") for line in textwrap.wrap(text.encode("utf-8", "replace").decode(), width)]
