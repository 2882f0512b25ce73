"""The static pictures of a clip: `fit.png` of its contacts, verdicts first, and estimated next to measured forces."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.estimate import NINETY
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.known_force import KnownForce
from palpate.estimators.online.particle_field import FieldEstimate
from palpate.estimators.records import InteractionEstimate
from palpate.results.calibrated import Curve
from palpate.results.panels import (
    FAR_COLOR,
    INK,
    OBSERVED,
    RELEASE,
    SIMULATED,
    draw_explained,
    draw_field,
    draw_grip,
    lines_of,
    name_axes,
    new_figure,
)
from palpate.results.verdicts import COLORS, FAR, in_words, numbers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 15.0
"""Width of the pictures [inches of 100 px]."""
MOST_PANELS = 12
"""Runs of contact that are drawn."""


def draw_fits(runs: Sequence[InteractionEstimate], counts: Counter[str], title: str) -> Figure:
    """Draw runs of contact one below the other: in words, and with their motion where there is an estimate.

    Below a field's motion are its course and its map.

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
    heights = []
    for run, (_, sentences, _) in zip(panels, words, strict=True):
        heights += [_height(run, sentences), *[4.0] * (run is not None and run.field is not None)]
    figure = new_figure(WIDTH, sum(heights) + 1.4, title, subtitle)
    rows = iter(figure.subplots(len(heights), height_ratios=heights, squeeze=False)[:, 0])
    for words_of, run in zip(words, panels, strict=True):
        row = next(rows)
        _head(row, *words_of)
        _draw_motion(row, run)
        if run is not None and run.field is not None:
            draw_field(next(rows), run.field)
    return figure


def _height(run: InteractionEstimate | None, sentences: str) -> float:
    """Of a run's panel [inches]: its words, its motion, and its map."""
    found = None if run is None else run.main_estimate
    motion = isinstance(found, GripEstimate | FieldEstimate) or (run is not None and run.simulated is not None)
    field = isinstance(found, FieldEstimate)
    return 0.9 + 0.2 * len(lines_of(sentences)) + 2.8 * motion + 1.2 * field


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
    figure = new_figure(WIDTH, 5.9, title, subtitle)
    axes = figure.subplots()
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


def write_figure(path: Path, figure: Figure) -> None:
    """Store a figure as PNG.

    Raises:
        OSError: it can't be written.
    """
    with warnings.catch_warnings():
        # A letter of a clip's name that the font lacks is drawn as a box, which is all there is to say about it.
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        figure.savefig(path)


def _head(axes: Axes, heading: str, sentence: str, state: str) -> None:
    """Write a heading in the colour of a state above a panel, and sentences below the heading."""
    lines = lines_of(sentence)
    axes.set_title("\n".join(lines), loc="left", fontsize=10.5, color=INK, linespacing=1.3)
    axes.annotate(
        "\n".join(lines_of(heading, 110)), (0, 1), (0, 9 + 14.7 * len(lines)), "axes fraction", "offset points",
        fontsize=13, fontweight="bold", va="bottom", color=np.divide(COLORS[state], 255), annotation_clip=False,
    )  # fmt: skip


def _described_run(run: InteractionEstimate | None) -> tuple[str, str, str]:
    """Heading of a run of contact, the verdict first and no number surer than it, sentences, and a key of COLORS."""
    if run is None:
        return "no contact was found", "", "no_estimate"
    place, estimate = f"contact from frame {run.onset_frame} ({run.onset_time_s:.3f} s)", run.estimate
    if isinstance(grip := run.main_estimate, GripEstimate):
        sentence = f"Skill {grip.skill:.2f} in frames that were not fitted (1: exact). No k_s, k_d or |F|."
        return f"{in_words(grip.verdict)}: {place}", f"{sentence} {run.detail}".strip(), grip.verdict
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
        skill = f", skill {run.skill:.2f} (0: as if nothing moved)" if np.isfinite(run.skill) else ""
        sentences.append(f"Misfit {estimate.misfit:.2g} (1: it fits){skill}; {estimate.explanation}.")
    if estimate.covariance is not None:
        sentences.append("Ranges and ± are 90 % intervals.")
    heading = f"{estimate.verdict}{', but doubtful' if doubtful else ''}: {place}, {values}"
    return heading, " ".join(filter(None, sentences)), sure


def _draw_motion(axes: Axes, run: InteractionEstimate | None) -> None:
    """Motion along the force, positive where it follows it: observed, with its noise, and simulated; the release."""
    if run is not None and isinstance(run.main_estimate, GripEstimate):
        draw_grip(axes, run.main_estimate)
        return
    if run is not None and isinstance(run.main_estimate, FieldEstimate):
        draw_explained(axes, run.main_estimate)
        return
    if run is None or run.simulated is None or run.interaction is None or run.estimate is None:
        axes.set_axis_off()
        return
    contact, estimate, (simulated_times, simulated) = run.interaction, run.estimate, run.simulated
    sign, times = np.sign(estimate.theta[2]), contact.observation.times
    at, far = _far(contact, run.simulated, estimate.noise)
    tracked = np.isfinite(contact.along).any()
    if tracked:
        half, name = NINETY * estimate.noise, "observed, 90 % interval of the noise"
        axes.errorbar(times, sign * contact.along, half, fmt="o", ms=5, color=OBSERVED, label=name)
    label = f"simulated with the fit{'' if tracked else ' to the shading, which observes no displacement'}"
    axes.plot(simulated_times, sign * simulated, "-", lw=2, color=SIMULATED, label=label)
    if far.any():
        axes.plot(times[far], sign * at[far], "x", ms=9, mew=2, color=FAR_COLOR, label="far from the observed one")
    release = contact.load_seconds + (*estimate.delays, 0.0, 0.0)[1]
    if contact.released and release < times[-1]:
        axes.axvline(release, color=RELEASE, lw=1.5, ls="--", label=f"release, {release:.3f} s")
    axes.set_xlim(0, 1.01 * times[-1])
    name_axes(axes, "displacement along the force\n[scene units (normalised)]")


def _far(contact: Interaction, simulated: tuple[np.ndarray, np.ndarray], noise: float) -> tuple[np.ndarray, np.ndarray]:
    """What is simulated at the observed times, and where that is FAR and off by more than twice the noise, [T] each."""
    observed, at = contact.along, np.interp(contact.observation.times, *simulated)
    apart = np.abs(at - 1.25 * observed) > 0.75 * np.abs(observed)  # beyond half and twice, of either sign
    return at, apart & (np.abs(at - observed) > 2 * noise)
