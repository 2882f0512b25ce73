"""The static pictures of a clip: `summary.png` over its frames and `fit.png` of its contacts, verdicts first.

matplotlib is imported where something is drawn, so that a program starts, and may end, without it.
"""

from __future__ import annotations

import textwrap
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.estimate import LEAST_SKILL, NINETY
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.grip.stiffness_fit import StiffnessField
from palpate.estimators.known_force import KnownForce
from palpate.estimators.online.particle_field import FieldEstimate
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.results.calibrated import Curve
from palpate.results.columns import UNITS
from palpate.results.verdicts import COLORS, FAR, digits, in_words, is_far, numbers, state

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 15.0
"""Width of the pictures [inches of 100 px]."""
INK, MUTED, GRID = "#1f2937", "#6b7280", "#e5e7eb"
OBSERVED, SIMULATED, RELEASE, FAR_COLOR = "#4b5563", "#7c3aed", "#ea580c", "#dc2626"
FIELD_COLORS = "#2563eb", "#0d9488"
"""Of stiffness against stretch and against bending."""
MOST_ARROWS = 300
"""About so many followed points are drawn with their motion."""
PANELS = {
    "stiffness": ("Stiffness $k_s$", "#2563eb"),
    "damping": ("Damping $k_d$", "#0d9488"),
    "force": ("Force $|F|$", "#ea580c"),
}
"""Title and colour of the panels with intervals, by attribute of a FrameEstimate."""
NOTICE = "palpate: research software, not a medical device."
MOST_PANELS = 12
"""Runs of contact that are drawn."""
CELLS = 16
"""Across a picture of surface errors, in each of which points' distances are averaged."""
BESIDE = 1.5
"""Radius of what is next to the tool in it, over that of its hole."""
NO_RUNS: Counter[str] = Counter()
MAP_STEP, MAP_RANGE = 4, 3.0
"""Of maps of stiffness: side of their squares [px], and the largest ratio that has a colour of its own."""


def draw_summary(
    estimates: Sequence[FrameEstimate],
    counts: Counter[str] = NO_RUNS,
    runs: Sequence[InteractionEstimate] = (),
    *,
    title: str,
    subtitle: str = "",
) -> Figure:
    """Draw a clip's verdicts, parameters and displacements over time, or verdicts alone where frames have no estimate.

    Below them is what is known of grips: how the force at each changed, and where the tissue is stiffer; and fields of
    stiffness over time and on the picture.

    Args:
        estimates: one a frame, in order.
        counts: of runs of contact by `state`; they are the heading where no frame has an estimate.
        runs: those whose grips and fields are drawn.
        title: name of the clip.
        subtitle: what made the numbers.
    """
    estimated = any(estimate.estimate is not None for estimate in estimates)
    heights = [1.1, 2.8, 2.8, 2.8, 3.0] if estimated else [2.2]
    gripped = [
        (run, found)
        for run in runs
        if isinstance(found := run.main_estimate, FieldEstimate)
        or (isinstance(found, GripEstimate) and found.determined)
    ]
    figure, rows = _figure([*heights, *[4.0] * len(gripped)], title, subtitle)
    strip, *panels = rows[: len(heights)]
    for axes in panels:
        axes.sharex(strip)
    for axes in rows[: len(heights) - 1]:
        axes.tick_params(labelbottom=False)
    for axes, (run, found) in zip(rows[len(heights) :], gripped, strict=True):
        axes.set_title("\n".join(_lines(_described_run(run)[0], 120)), loc="left", fontsize=12)
        if isinstance(found, GripEstimate):
            _draw_grip(axes, found)
        elif isinstance(found, FieldEstimate):
            _draw_field(axes, found)
    times = _column(estimates, "time_s")
    interval = max(float(np.median(np.diff(times))), 1e-3) if len(times) > 1 else 0.04
    edges = np.append(times, times[-1] + interval) if len(times) else np.array([0.0, 1.0])
    _draw_states(strip, edges, estimates, below=0.5 if estimated else 4.5)
    _head(strip, *_described(estimates, NO_RUNS if estimated else counts))
    if estimated:
        for axes, (name, (label, color)) in zip(panels, PANELS.items(), strict=False):
            _draw_parameter(axes, times, estimates, name, color)
            _finish(axes, label, name)
        _draw_displacements(panels[-1], times, estimates)
        _finish(panels[-1], "Displacement of the contact", "displacement")
    rows[len(heights) - 1].set(xlim=(edges[0], edges[-1]), xlabel="time [s]")
    return figure


def draw_fits(runs: Sequence[InteractionEstimate], counts: Counter[str], title: str) -> Figure:
    """Draw runs of contact one below the other: in words, and with their motion where there is an estimate.

    Args:
        runs: those that are drawn.
        counts: of all of the clip by `state`.
        title: name of the clip.
    """
    total = counts.total()
    subtitle = f"Runs of contact: {total}, with an estimate: {total - counts['no_estimate']}."
    if len(runs) < total:
        subtitle += f" {len(runs)} are drawn, interactions.csv has all."
    panels = list(runs) or [None]
    words = [_described_run(run) for run in panels]
    heights = [_height(run, sentences) for run, (_, sentences, _) in zip(panels, words, strict=True)]
    figure, rows = _figure(heights, title, subtitle)
    for axes, words_of, run in zip(rows, words, panels, strict=True):
        _head(axes, *words_of)
        _draw_motion(axes, run)
    return figure


def _height(run: InteractionEstimate | None, sentences: str) -> float:
    """Of a run's panel [inches]: its words, its motion, and its map."""
    found = None if run is None else run.main_estimate
    motion = isinstance(found, GripEstimate | FieldEstimate) or (run is not None and run.simulated is not None)
    field = isinstance(found, FieldEstimate) or (isinstance(found, GripEstimate) and found.stiffness is not None)
    return 0.9 + 0.2 * len(_lines(sentences)) + 2.8 * motion + 1.2 * field


def draw_comparison(measured: KnownForce, curves: Sequence[Curve], known: KnownForce | None, title: str) -> Figure:
    """Draw measured and estimated forces over time.

    Args:
        measured: all that was measured.
        curves: estimated.
        known: those that gave the scale.
        title: name of the clip.
    """
    unit = curves[0].unit if curves else "N"
    subtitle = "Measured and estimated forces." if curves else "No force was estimated where forces were measured."
    figure, (axes,) = _figure([4.5], title, subtitle)
    axes.plot(measured.times, measured.force, color=OBSERVED, label="measured [N]")
    if known is not None:
        axes.plot(known.times, known.force, color=RELEASE, linewidth=4, alpha=0.4, label="which gave the scale")
    other = axes if unit == "N" else axes.twinx()
    for index, curve in enumerate(curves):
        name = f"estimated [{curve.unit}]" if not index else None
        other.plot(curve.times, curve.force, color=SIMULATED, label=name)
        if np.isfinite(curve.low).all():
            other.fill_between(curve.times, curve.low, curve.high, color=SIMULATED, alpha=0.15, linewidth=0)
    axes.set(xlabel="time [s]", ylabel="force [N]")
    if other is not axes:
        other.set_ylabel(f"estimated force [{unit}]", color=SIMULATED)
    figure.legend(loc="outside upper right", ncols=3, frameon=False)
    return figure


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
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine
    from matplotlib.patches import Circle

    panels = {"as fitted": fitted}
    if softer is not None:
        panels |= {"half as stiff": softer, "half as stiff less as fitted": softer - fitted}
    layout = ConstrainedLayoutEngine(rect=(0, 0.12, 1, 0.8))  # between title and footer
    figure = Figure(figsize=(4.6 * len(panels) + 1, 6.2), dpi=100, layout=layout)
    figure.text(0.01, 0.98, "\n".join(_lines(title, 45 * len(panels))), va="top", fontsize=14, color=INK)
    near, drawn = np.linalg.norm(places, axis=1) < BESIDE * hole, []
    rows = figure.subplots(1, len(panels), squeeze=False, sharex=True, sharey=True)[0]
    for axes, (name, distance) in zip(rows, panels.items(), strict=True):
        visible = np.isfinite(distance)
        drawn.append(
            axes.hexbin(*places[visible].T, C=distance[visible], gridsize=CELLS, cmap="RdBu_r", linewidths=0.2)
        )
        axes.add_patch(Circle((0, 0), hole, fill=False, linestyle="--", color=MUTED))
        axes.add_patch(Circle((0, 0), BESIDE * hole, fill=False, linestyle=":", color=MUTED))
        mean = float(np.mean(distance[visible & near])) if (visible & near).any() else np.nan
        axes.set_title(f"{name}\n{mean:+.2f} mm next to the tool", fontsize=12)
        axes.set(xlabel="across the force [mm]", aspect="equal")
    rows[0].set_ylabel("across the force [mm]")
    limit = max(float(np.abs(np.quantile(np.asarray(each.get_array()), (0.02, 0.98))).max()) for each in drawn)
    for each in drawn:
        each.set_clim(-limit, limit)
    figure.colorbar(drawn[0], ax=list(rows), label="measured less simulated surface [mm]", extend="both", shrink=0.8)
    scale = (
        f"All panels on one scale of ± {limit:.2f} mm, means over cells; > 0: measured outside the simulated surface."
    )
    circles = "Dashed: what the tool hides, left out. Dotted: next to the tool."
    footer = "\n".join([*_lines(f"{scale} {circles}", 60 * len(panels)), NOTICE])
    figure.text(0.01, 0.02, footer, va="bottom", fontsize=10, color=MUTED)
    return figure


def write_figure(path: Path, figure: Figure) -> None:
    """Store a figure as PNG.

    Raises:
        OSError: it can't be written.
    """
    with warnings.catch_warnings():
        # A letter of a clip's name that the font lacks is drawn as a box, which is all there is to say about it.
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        figure.savefig(path)


def _figure(heights: Sequence[float], title: str, subtitle: str) -> tuple[Figure, Sequence[Axes]]:
    """A figure with one panel of each height [inches] below the other, a title above and a footer below them."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = Figure(
        figsize=(WIDTH, sum(heights) + 1.4), dpi=100, layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12)
    )
    figure.suptitle("\n".join(_lines(title, 52)), x=0.01, ha="left", fontsize=18, fontweight="bold", color=INK)
    footer = "\n".join([*_lines(subtitle), NOTICE])
    figure.supxlabel(footer, x=0.01, ha="left", fontsize=10, color=MUTED, linespacing=1.4)
    panels = figure.subplots(len(heights), height_ratios=heights, squeeze=False)
    return figure, list(panels[:, 0])


def _lines(text: str, width: int = 140) -> list[str]:
    """A text in lines of at most `width` characters, as matplotlib shows it letter by letter."""
    # Stand-ins for bytes of file names that are not UTF-8 can't be drawn, and a pair of $ would begin a formula.
    return [line.replace("$", r"\$") for line in textwrap.wrap(text.encode("utf-8", "replace").decode(), width)]


def _color(name: str) -> tuple[float, ...]:
    return tuple(channel / 255 for channel in COLORS[name])


def _head(axes: Axes, heading: str, sentence: str, state: str) -> None:
    """Write a heading in the colour of a state, or in ink for none, above a panel, and sentences below the heading."""
    lines = _lines(sentence)
    axes.set_title("\n".join(lines), loc="left", fontsize=10.5, color=INK, linespacing=1.3)
    axes.annotate(
        "\n".join(_lines(heading, 110)), (0, 1), (0, 9 + 14.7 * len(lines)), "axes fraction", "offset points",
        fontsize=13, fontweight="bold", va="bottom", color=_color(state) if state else INK, annotation_clip=False,
    )  # fmt: skip


def _finish(axes: Axes, label: str, quantity: str) -> None:
    """Title with unit, a grid, and a legend above on the right."""
    axes.set_title(f"{label}   [{UNITS[quantity]}]", loc="left", fontsize=12, color=INK)
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False, fontsize=10, borderaxespad=0.2)
    axes.grid(color=GRID, lw=0.8)


def _label(axes: Axes, quantity: str, place: Literal["best", "upper left"] = "best", size: float = 10) -> None:
    """A quantity over a contact's time: names of the axes, a legend and a grid."""
    axes.set(xlabel="time since the first frame in contact [s]", ylabel=quantity)
    axes.legend(loc=place, framealpha=0.85, fontsize=size)
    axes.grid(color=GRID, lw=0.8)


def _draw_curve(axes: Axes, times: np.ndarray, values: np.ndarray, color: str, label: str) -> None:
    axes.plot(times, values, "o-", ms=4, lw=1, color=color, label=label)


def _draw_states(axes: Axes, edges: np.ndarray, estimates: Sequence[FrameEstimate], below: float) -> None:
    """What is said first about every frame, as a strip of colours with their counts, `below` [lines] under it."""
    states = np.array([state(estimate) for estimate in estimates])
    narrowest = (edges[-1] - edges[0]) / (100 * WIDTH)
    begin, width = np.minimum(edges[:-1], edges[-1] - narrowest), np.maximum(np.diff(edges), narrowest)
    for name in (name for name in COLORS if name in states):
        hit = states == name
        axes.broken_barh(
            list(zip(begin[hit], width[hit], strict=True)), (0, 1), color=_color(name), lw=0, antialiased=False,
            zorder=1 + 1 / hit.sum(), label=f"{in_words(name)}: {hit.sum()}",
        )  # fmt: skip
    axes.set(ylim=(0, 1), yticks=[])
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (0, 0), "borderaxespad": below}
    axes.legend(handles=axes.collections, ncols=6, frameon=False, fontsize=10, **place)


def _described(estimates: Sequence[FrameEstimate], runs: Counter[str]) -> tuple[str, str, str]:
    """Heading of a clip, sentences about it, and the one verdict of its runs of contact or frames in contact."""
    touching = [estimate for estimate in estimates if estimate.status == "ok"]
    counts = Counter(map(state, touching))
    found = ", ".join(f"{in_words(name)} on {counts[name]}" for name in COLORS if counts[name] and name != "ok")
    among = f"{len(touching)} frames in contact" if touching else "no frame is in contact"
    heading = f"{found} of {among}" if found else among
    if runs:
        found = ", ".join(f"{in_words(name)} on {runs[name]}" for name in COLORS if runs[name])
        heading, counts = f"{found} of {runs.total()} runs of contact; {among}", runs
    far, remarks = sum(map(is_far, touching)), [row for row in touching or estimates if row.detail]
    sentences = [f"The simulated displacement is {FAR} on {far} of these frames (×)."] if far else []
    if remarks:
        sentences.append(
            f"Frames with a remark: {len(remarks)}; the last, frame {remarks[-1].frame}: {remarks[-1].detail}"
        )
    return heading, " ".join(sentences), next(iter(counts)) if len(counts) == 1 else ""


def _draw_parameter(axes: Axes, times: np.ndarray, estimates: Sequence[FrameEstimate], name: str, color: str) -> None:
    """A parameter's values, as rings where they are not determined, and its intervals."""
    value, low, high = (_column(estimates, f"{name}{end}") for end in ("", "_low", "_high"))
    sure = [estimate.verdict == "determined" for estimate in estimates]
    axes.plot(times, value, "o-", ms=4, lw=1, color=(color, 0.5), mfc="white", label="not determined")
    axes.plot(times, np.where(sure, value, np.nan), "o", ms=4, color=color, label="determined")
    top = _top(value, np.minimum(high, 5 * value))  # a hundredfold interval would flatten the rest
    if np.isfinite(high).any():
        beyond = f", up to {digits(np.nanmax(high), 2)}" if np.nanmax(high) > top else ""
        axes.fill_between(times, low, high, color=color, alpha=0.2, lw=0, label=f"90 % interval{beyond}")
    axes.set_ylim(0, top)


def _draw_displacements(axes: Axes, times: np.ndarray, estimates: Sequence[FrameEstimate]) -> None:
    """Observed and simulated displacement, crosses where they are far from each other."""
    observed, simulated = (_column(estimates, f"{name}_displacement") for name in ("observed", "simulated"))
    far = np.where([is_far(estimate) for estimate in estimates], simulated, np.nan)
    _draw_curve(axes, times, observed, OBSERVED, "observed")
    _draw_curve(axes, times, simulated, SIMULATED, "simulated")
    axes.plot(times, far, "x", ms=9, mew=2, color=FAR_COLOR, label="far from the observed one")
    axes.set_ylim(0, _top(observed, simulated))


def _described_run(run: InteractionEstimate | None) -> tuple[str, str, str]:
    """Heading of a run of contact, the verdict first and no number surer than it, sentences, and a key of COLORS."""
    if run is None:
        return "no contact was found", "", "no_estimate"
    place, estimate = f"contact from frame {run.onset_frame} ({run.onset_time_s:.3f} s)", run.estimate
    if isinstance(grip := run.main_estimate, GripEstimate):
        sentence = f"Skill {grip.skill:.2f} in frames that were not fitted (1: exact). No k_s, k_d or |F|."
        heading = f"{in_words(grip.verdict)}: {place}"
        for name, words in (("reaction_over_young", "F/E"), ("foundation_over_stiffness", "foundation over stiffness")):
            if name in grip.determined:
                low, high = (digits(getattr(grip, f"{name}_{end}"), 2) for end in ("low", "high"))
                heading += f", {words} {low} to {high}"
        return heading, f"{sentence} {run.detail}", grip.verdict
    if isinstance(found := run.main_estimate, FieldEstimate):
        words = [in_words(found.verdict)]
        if not np.isnan(found.skill):
            words.append(f"{found.skill:.0%} of the motion explained")
        return f"{', '.join(words)}: {place}", run.detail, found.verdict
    if estimate is None:
        return f"no estimate: {place}", run.detail, "no_estimate"
    doubtful = estimate.verdict == "determined" and run.detail != ""
    sure = "doubtful" if doubtful else estimate.verdict
    values = ", ".join(" ".join(pair) for pair in numbers(sure, estimate.numbers()))
    sentences = [run.detail]
    if run.simulated is not None and run.interaction is not None:
        _, far = _far(run.interaction, run.simulated, estimate.noise)
        among = np.isfinite(run.interaction.along).sum()
        sentences += [f"The simulated displacement is {FAR} on {far.sum()} of {among} frames (×)."] if far.any() else []
    if np.isfinite(estimate.misfit):
        sentences.append(f"Misfit {estimate.misfit:.2g} (1: it fits); {estimate.explanation}.")
    if estimate.covariance is not None and sure != "determined":
        sentences.append("Ranges are 90 % intervals.")
    heading = f"{estimate.verdict}{', but doubtful' if doubtful else ''}: {place}, {values}"
    return heading, " ".join(filter(None, sentences)), sure


def _draw_motion(axes: Axes, run: InteractionEstimate | None) -> None:
    """Motion along the force, positive where it follows it: observed, with its noise, and simulated; the release."""
    if run is not None and isinstance(run.main_estimate, GripEstimate):
        _draw_grip(axes, run.main_estimate)
        return
    if run is not None and isinstance(run.main_estimate, FieldEstimate):
        _draw_explained(axes, run.main_estimate)
        return
    if run is None or run.simulated is None or run.interaction is None or run.estimate is None:
        axes.set_axis_off()
        return
    contact, estimate, (simulated_times, simulated) = run.interaction, run.estimate, run.simulated
    sign, times = np.sign(estimate.theta[2]), contact.observation.times
    at, far = _far(contact, run.simulated, estimate.noise)
    if np.isfinite(contact.along).any():  # the light of the tissue follows no point
        axes.errorbar(times, sign * contact.along, estimate.noise, fmt="o", ms=5, color=OBSERVED, label="observed ± σ")
    axes.plot(simulated_times, sign * simulated, "-", lw=2, color=SIMULATED, label="simulated with the fit")
    if far.any():
        axes.plot(times[far], sign * at[far], "x", ms=9, mew=2, color=FAR_COLOR, label="far from the observed one")
    release = contact.load_seconds + (*estimate.delays, 0.0, 0.0)[1]
    if contact.released and release < times[-1]:
        axes.axvline(release, color=RELEASE, lw=1.5, ls="--", label=f"release, {release:.3f} s")
    axes.set_xlim(0, 1.01 * times[-1])
    _label(axes, "displacement along the force\n[scene units (normalised)]")


def _far(contact: Interaction, simulated: tuple[np.ndarray, np.ndarray], noise: float) -> tuple[np.ndarray, np.ndarray]:
    """What is simulated at the observed times, and where that is FAR and off by more than twice the noise, [T] each."""
    observed, at = contact.along, np.interp(contact.observation.times, *simulated)
    apart = np.abs(at - 1.25 * observed) > 0.75 * np.abs(observed)  # beyond half and twice, of either sign
    return at, apart & (np.abs(at - observed) > 2 * noise)


def _draw_grip(axes: Axes, grip: GripEstimate) -> None:
    """Force at the grip over time, over that of the last frame; and where the tissue is stiffer, on the picture."""
    if grip.stiffness is not None:
        whole, axes = axes, axes.inset_axes((0, 0, 0.52, 1))
        whole.set_axis_off()
        _draw_stiffness(whole.inset_axes((0.54, 0, 0.42, 1)), grip.stiffness)
    low, high = grip.force - NINETY * grip.force_sd, grip.force + NINETY * grip.force_sd
    axes.fill_between(grip.times, low, high, color=SIMULATED, alpha=0.25, lw=0, label="90 % interval")
    axes.plot(grip.times, grip.force, "o-", ms=4, lw=1.5, color=SIMULATED, label="force along that of the last frame")
    _label(axes, "force at the grip\nover the last one [1]", "upper left")


def _draw_stiffness(axes: Axes, field: StiffnessField) -> None:
    """Stiffness over that of the tissue that moves, drawn on the run's first picture where it is known."""
    from matplotlib.colors import LogNorm

    height, width = field.picture.shape[:2]
    _picture_axes(axes, field.picture)
    rows, columns = np.mgrid[MAP_STEP // 2 : height : MAP_STEP, MAP_STEP // 2 : width : MAP_STEP]
    places = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)
    known = field.known(places).reshape(rows.shape)
    ratio = np.exp(field.at(places)[0]).reshape(rows.shape)
    place: dict[str, Any] = {"extent": (0, columns.shape[1] * MAP_STEP, rows.shape[0] * MAP_STEP, 0)}
    axes.imshow(np.where(known, np.nan, 0.35), cmap="gray", vmin=0, vmax=1, alpha=0.6, **place)
    shown = np.where(known, ratio, np.nan)
    drawn = axes.imshow(shown, cmap="coolwarm", norm=LogNorm(1 / MAP_RANGE, MAP_RANGE), alpha=0.65, **place)
    if known.any():
        _ratio_bar(axes, drawn)
    axes.set(xlim=(0, width), ylim=(height, 0))
    title = "stiffness over the mean of what moves, if attached\nhomogeneously; darkened: unknown"
    axes.set_title(title if known.any() else "stiffness: unknown everywhere", loc="left", fontsize=10, color=INK)


def _draw_explained(axes: Axes, found: FieldEstimate) -> None:
    """How far tissue moved and by how much the simulation missed that, a frame; and both in the last one."""
    whole, axes = axes, axes.inset_axes((0.04, 0, 0.46, 1))
    whole.set_axis_off()
    observed, predicted, left = found.course.T
    _draw_curve(axes, found.times, observed, OBSERVED, "observed")
    _draw_curve(axes, found.times, predicted, SIMULATED, "simulated, moved by the instrument alone")
    axes.fill_between(found.times, 0, left, color=FAR_COLOR, alpha=0.2, lw=0, label="difference of both")
    axes.set_ylim(0, 1.25 * _top(observed, predicted, left))
    _label(axes, "motion of the tissue around\n(root mean square) [px]", "upper left")
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


def _draw_field(axes: Axes, found: FieldEstimate) -> None:
    """How much is explained and determined over time, quantiles of stiffness, and its map at rest."""
    whole, axes = axes, axes.inset_axes((0.04, 0, 0.25 if found.determined else 0.55, 1))
    whole.set_axis_off()
    names = ("distance_stiffness", "shape_stiffness")
    rows = found.numbers
    axes.axhline(LEAST_SKILL, color=FAR_COLOR, lw=1, ls="--", label=f"least that counts, {LEAST_SKILL:.0%}")
    _draw_curve(axes, found.times, rows["skill"], SIMULATED, "motion explained so far")
    kinds = list(zip(names, FIELD_COLORS, ("against stretch", "against bending"), strict=True))
    for (_, color, label), share in zip(kinds, ("field_known", "shape_known"), strict=True):
        axes.plot(found.times, rows[share], "s-", ms=3, lw=1, color=color, label=f"particles determined {label}")
    axes.set(ylim=(-0.05, 1.6), yticks=np.linspace(0, 1, 5), xlim=(found.times[0], max(found.times[-1], 1e-3)))
    _label(axes, "share [1]", "upper left", 8.5)
    if found.determined:
        course = whole.inset_axes((0.37, 0, 0.22, 1))
        for name, color, label in kinds:
            low, middle, high = (rows[f"{name}{end}"] for end in ("_low", "", "_high"))
            if np.isnan(middle).all():
                continue
            _draw_curve(course, found.times, middle, color, f"{label}, median")
            course.fill_between(found.times, low, high, color=color, alpha=0.2, lw=0, label="10 to 90 %")
        course.set(yscale="log", xlim=axes.get_xlim())
        _label(course, "stiffness where it is\ndetermined [relative]", size=8.5)
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


def _column(estimates: Sequence[FrameEstimate], attribute: str) -> np.ndarray:
    """One of the values of all frames, shape [n], NaN where there is none."""
    return np.array([estimate.values.get(attribute) for estimate in estimates], dtype=float)


def _top(*values: np.ndarray) -> float:
    """Upper end of an axis that begins at 0 and has room above the values; 1 without any."""
    return 1.12 * float(np.fmax.reduce(np.concatenate(values), initial=0.0)) or 1.0
