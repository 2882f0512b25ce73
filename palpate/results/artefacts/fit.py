"""fit.png: every contact of a clip with its verdict, its numbers and its motion.

matplotlib is imported where something is drawn, so that a program starts, and may end, without it.
"""

from __future__ import annotations

import importlib
import textwrap
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

import numpy as np

from palpate.estimators.records import InteractionEstimate
from palpate.estimators.result import values_of
from palpate.physics.identifiability import NINETY
from palpate.results import store
from palpate.results.artefacts.base import Artefact
from palpate.results.verdicts import NOTES, OWN_UNITS, in_words, numbers, state

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MOST_PANELS = 12
"""Number of contacts that are drawn."""
OBSERVED, SIMULATED = "#4b5563", "#7c3aed"


class FitPicture(Artefact):
    """Picture of contacts, those with a motion first."""

    name = store.FIT

    def open(self) -> None:
        self.drawn: list[InteractionEstimate] = []
        # What `finish` needs is loaded meanwhile: it takes most of a second.
        Thread(target=importlib.import_module, args=("matplotlib.figure",)).start()

    def contact(self, run: InteractionEstimate) -> None:
        shown = [*self.drawn, run]
        self.drawn = sorted(shown, key=lambda item: item.simulated is None and not item.verdict)[:MOST_PANELS]

    def finish(self) -> None:
        write_figure(self.path, draw_fits(self.drawn, self.clip.counts, self.clip.source.name))


def draw_fits(runs: Sequence[InteractionEstimate], counts: Counter[str], title: str) -> Figure:
    """Draw contacts one below the other: in words, and with their motion where there is an estimate.

    Args:
        runs: those that are drawn.
        counts: of all of the clip by `state`.
        title: name of the clip.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    total, words = counts.total(), [_described(run) for run in runs]
    drawn = f"{len(runs)} are drawn, interactions.csv has all. " if len(runs) < total else ""
    heights = [0.9 + 0.2 * len(lines) + 2.8 * _moves(run) for run, (_, lines) in zip(runs, words, strict=True)]
    figure = Figure(figsize=(15, sum(heights) + 1.4), dpi=100, layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12))
    figure.suptitle("\n".join(_lines(title, 52)), x=0.01, ha="left", fontsize=18, fontweight="bold")
    footer = f"Contacts: {total}, with an estimate: {total - counts['no_estimate']}. {drawn}{OWN_UNITS}."
    figure.supxlabel(f"{footer} Research software, not a medical device.", x=0.01, ha="left", fontsize=10)
    if not runs:
        return figure
    rows = figure.subplots(len(runs), height_ratios=heights, squeeze=False)[:, 0]
    for axes, run, (heading, lines) in zip(rows, runs, words, strict=True):
        axes.set_title("\n".join(lines), loc="left", fontsize=10.5)
        axes.annotate(
            heading, (0, 1), (0, 9 + 14.7 * len(lines)), "axes fraction", "offset points", fontsize=13,
            fontweight="bold", va="bottom", color=np.divide(NOTES[state(run)].color, 255), annotation_clip=False,
        )  # fmt: skip
        if _moves(run):
            _draw_motion(axes, run)
            axes.set_xlabel("time since the first frame in contact [s]")
            axes.legend(framealpha=0.85)
            axes.grid(color="#e5e7eb", lw=0.8)
        else:
            axes.set_axis_off()
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


def _moves(run: InteractionEstimate) -> bool:
    """Return whether a contact has a motion to draw."""
    return run.beside is not None or run.simulated is not None


def _described(run: InteractionEstimate) -> tuple[str, list[str]]:
    """Return the heading of a contact, verdict first, and lines of explanation."""
    press, pull, explained = run.estimate, run.grip, ""
    heading = f"{in_words(state(run))}: contact from frame {run.onset_frame}"
    if pull is not None and run.beside is pull:
        explained = f"Skill {pull.skill:.2f} in frames that were not fitted (1: exact). No k_s, k_d or |F|."
    elif press is not None and run.beside is None:
        sure, explained = "doubtful" if run.verdict == "determined" and run.detail else run.verdict, press.explanation
        values = values_of(press.numbers) | {"determined": press.determined}
        heading += ", " + ", ".join(map(" ".join, numbers(sure, values)))
    return "\n".join(_lines(heading, 110)), _lines(f"{run.detail} {explained}".strip())


def _draw_motion(axes: Axes, run: InteractionEstimate) -> None:
    """Draw the force of a pull, the motion of a field, or that of a press along its force, observed and simulated."""
    contact, estimate, pull, field = run.interaction, run.estimate, run.grip, run.field
    if pull is not None and run.beside is pull:
        axes.fill_between(pull.times, *pull.curves[1:], color=SIMULATED, alpha=0.25, lw=0)
        axes.plot(pull.times, pull.force, "o-", color=SIMULATED, label="force along that of the last frame")
        axes.set_ylabel("force at the grip\nover the last one, 90 % interval")
    elif field is not None:
        for index, (name, color) in enumerate({"observed": OBSERVED, "simulated": SIMULATED}.items()):
            axes.plot(field.times, field.course[:, index], "o-", color=color, label=name)
        axes.set_ylabel("motion of the tissue around\n(root mean square) [px]")
    elif contact is not None and estimate is not None and run.simulated is not None:
        sign, times = np.sign(estimate.theta[2]), contact.observation.times
        if np.isfinite(contact.along).any():
            half, name = NINETY * estimate.noise, "observed, 90 % interval of the noise"
            axes.errorbar(times, sign * contact.along, half, fmt="o", color=OBSERVED, label=name)
        axes.plot(run.simulated[0], sign * run.simulated[1], lw=2, color=SIMULATED, label="simulated with the fit")
        release = contact.load_seconds + estimate.course.delays[1]
        if contact.released and release < times[-1]:
            axes.axvline(release, color="#ea580c", lw=1.5, ls="--", label=f"release, {release:.3f} s")
        axes.set_ylabel("displacement along the force\n[scene units (normalised)]")


def _lines(text: str, width: int = 140) -> list[str]:
    """Wrap a text into lines that matplotlib shows letter by letter."""
    # Stand-ins for bytes of file names that are not UTF-8 can't be drawn, and a pair of $ would begin a formula.
    return [line.replace("$", r"\$") for line in textwrap.wrap(text.encode("utf-8", "replace").decode(), width)]
