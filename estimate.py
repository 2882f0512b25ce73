"""Tissue stiffness, damping and tool force of every contact in a clip, fitted to its motion without a trained network.

    python estimate.py direct INPUT... --output DIR

Exit status: 0 all clips done, 1 some failed (named; the others are complete), 2 wrong usage, 130 interrupted (finished
clips stay, and the same command continues).
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

from rich.console import Console
from rich.progress import Progress, TaskID

from data.clip import ClipStream, PrepareSettings, stream
from data.collected import CollectedClip
from data.depth import DepthSettings
from data.frames import open_source
from data.geometry import GeometrySettings
from data.prepared import PreparedFrame
from data.samples import ContactCase, SampleSettings, contact_cases
from estimators.direct import LEAST_SIGMA, DirectSettings, fit_contact
from estimators.estimate import FrameEstimate, NoEstimate
from estimators.onset import BETWEEN, ONSETS
from evaluation.batch import (
    DONE,
    ONSET_HELP,
    UP_TO_DATE,
    Batch,
    Outcome,
    add_input_options,
    add_version,
    chosen_depth,
    chosen_layout,
    run,
    short,
)
from evaluation.contact_results import (
    COLUMNS,
    FILES,
    ContactResult,
    ContactRun,
    contact_runs,
    count_contacts,
    doubts,
    load_seconds,
    write_contacts,
)
from evaluation.result_store import read_record
from evaluation.run_record import UNITS, Provenance, clip_record, clip_warnings, sha256_of, versions

SMOOTHING = 4.0
"""Default of --smoothing [grid pixels]."""
NO_ONSET = (
    "The onset of the contact was not seen, and without it the rest shape and the beginning of the load are unknown."
)
NOT_FOLLOWED = "The tissue at the contact could not be followed after its onset."


class DirectFits(Batch):
    """Physics fitted to every run of contact of each clip.

    Raises:
        ValueError: something asked for can't be used.
    """

    program, counted = "estimate.py", "contacts"
    words: ClassVar = {**Batch.words, "geometry.smoothing": "--smoothing", "give the noise": "give --noise"}

    def __init__(self, options: argparse.Namespace, console: Console) -> None:
        self.direct = DirectSettings(noise=options.noise)
        self.matched = self.direct
        """The same for the current clip's frame rate."""
        super().__init__(options, console)

    def preparation(self) -> PrepareSettings:
        """Smoothed tissue, the camera's motion taken off, and otherwise what the user chooses."""
        return PrepareSettings(
            depth=DepthSettings(**chosen_depth(self.options)),
            geometry=GeometrySettings(smoothing=self.options.smoothing, rigid_motion="subtract"),
            masks=self.options.masks or "auto",
            layout=chosen_layout(self.options),
        )

    def process(self, path: Path, progress: Progress, place: str) -> Outcome:
        """Fit every contact of a clip and write its results."""
        source, output = open_source(path, self.settings.layout), self.options.output
        folder = self.store.folder(source.name, path)
        self.matched = self.direct.matched(source.fps, self.options.onset)
        estimator = {"name": "direct", "onset": self.options.onset, **dataclasses.asdict(self.matched)}
        provenance = Provenance(sha256_of(path, exclude=output.resolve()), "", self.settings, estimator)
        if not self.options.overwrite and self.store.is_complete(folder, provenance.fingerprint, FILES):
            self.say(f"{source.name}: up to date in {folder}; --overwrite computes it again")
            return Outcome(source.name, UP_TO_DATE, str(folder), read_record(folder).get("contacts", {}))
        task = progress.add_task(f"{place} {short(source.name)}", total=source.length or None)
        try:
            clip, frames, started = stream(source, self.settings), [], time.perf_counter()
            collected = CollectedClip(source.name, source.fps, _noting(clip, frames, progress, task), onsets_only=True)
            prepared = time.perf_counter()
            results = self._fit(collected, progress, task, f"{place} fitting {short(source.name)}")
            seconds = {**clip.seconds, "fit": time.perf_counter() - prepared, "total": time.perf_counter() - started}
            record = self._record(clip, provenance, frames, results, seconds)
            write_contacts(folder, results, self.matched.mechanics, record, source.name)
        finally:
            progress.remove_task(task)
        for warning in record["warnings"]:
            self.say(f"{source.name}: {warning}")
        return Outcome(source.name, DONE, str(folder), record["contacts"])

    def _fit(self, clip: CollectedClip, progress: Progress, task: TaskID, description: str) -> list[ContactResult]:
        """Every run of contact of a clip, fitted or with the reason why not."""
        geometry = self.settings.geometry
        samples = SampleSettings(observation="trajectory", geometry=geometry, mechanics=self.matched.mechanics)
        runs, cases = contact_runs(clip, self.settings.bridge_frames), contact_cases(clip, samples)
        results = []
        progress.reset(task, total=len(runs), description=description)
        for found in runs:
            results.append(self._result(clip, found, cases.get(found.first)))
            progress.advance(task)
        return results

    def _result(self, clip: CollectedClip, found: ContactRun, case: ContactCase | None) -> ContactResult:
        number, seconds = int(clip.numbers[found.first]), float(clip.times[found.first])
        load, remark = load_seconds(clip, found), clip.details.get(found.first, "")
        if case is None:
            reason = f"{remark} {NOT_FOLLOWED}".strip() if found.onset_seen else remark or NO_ONSET
            return ContactResult(number, seconds, load, None, None, reason)
        try:
            estimate = fit_contact(case, self.matched)
        except NoEstimate as reason:
            return ContactResult(number, seconds, load, case, None, f"{remark} {self.sentence(reason)}".strip())
        ranges = (self.direct.stiffness, self.direct.damping, self.direct.force)
        return ContactResult(number, seconds, load, case, estimate, f"{remark} {doubts(estimate, ranges)}".strip())

    def _record(
        self,
        clip: ClipStream,
        provenance: Provenance,
        frames: list[FrameEstimate],
        results: list[ContactResult],
        seconds: dict[str, float],
    ) -> dict[str, Any]:
        """The content of `run.json`."""
        record = clip_record(clip, provenance, self.program, frames)
        warnings = clip_warnings(clip.source, frames, clip.sources)
        if not results:
            counts = ", ".join(f"{count} {status}" for status, count in record["statuses"].items())
            warnings.append(f"no contact was found, so there is nothing to fit ({counts or 'no frames'})")
        return {
            **record,
            "estimator": provenance.estimator,
            "units": UNITS,
            "columns": COLUMNS,
            "contacts": count_contacts(results),
            "warnings": warnings,
            "timings_s": {stage: round(value, 4) for stage, value in seconds.items()},
            "versions": versions(),
        }


def _noting(clip: ClipStream, frames: list[FrameEstimate], progress: Progress, task: TaskID) -> Iterator[PreparedFrame]:
    """The clip's frames, each noted in `frames` with its status as it passes."""
    for prepared in clip:
        frame = prepared.frame
        frames.append(FrameEstimate(frame.number, frame.time_s, prepared.status, prepared.detail))
        progress.advance(task)
        yield prepared


def main(arguments: list[str] | None = None) -> int:
    """Run the program and return its exit status."""
    return run(DirectFits, _parser().parse_args(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description="Estimate tissue stiffness, damping and tool force of laparoscopic clips without a trained "
        "network. Research software, not a medical device.",
        epilog="Exit status: 0 all clips done, 1 some failed, 2 wrong usage, 130 interrupted.",
    )
    add_version(parser)
    ways = parser.add_subparsers(dest="way", required=True, metavar="WAY")
    direct = ways.add_parser(
        "direct",
        help="fit the simulator to every contact, one after the other",
        description="Fit the simulator to the motion of every run of contact, from its onset. Writes contacts.csv, "
        "fit.png and run.json for each clip. Research software, not a medical device.",
    )
    add = direct.add_argument
    add_input_options(add, "stored depth where there is some, else photometric")
    add(
        "--smoothing",
        type=_smoothing,
        default=SMOOTHING,
        metavar="PIXELS",
        help="smooth the tissue's resting shape over this many grid pixels, which also measures the depth's noise "
        "(default: %(default)g)",
    )
    add("--onset", choices=ONSETS, default=BETWEEN, help=ONSET_HELP)
    add("--noise", type=_noise, metavar="X", help="noise of the depth [scene units] (default: as measured)")
    return parser


def _smoothing(text: str) -> float:
    return _number(text, "a width in pixels; give 0 or more", 0.0)


def _noise(text: str) -> float:
    return _number(text, f"a noise above the simulator's own error; give {LEAST_SIGMA:g} or more", LEAST_SIGMA)


def _number(text: str, wanted: str, least: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not least <= value < math.inf:
        raise argparse.ArgumentTypeError(f"'{text}' is not {wanted}")
    return value


if __name__ == "__main__":
    sys.exit(main())
