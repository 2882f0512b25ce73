"""A batch of clips given on the command line: finding them, going on after a failure, progress and closing table."""

from __future__ import annotations

import argparse
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

from data.clip import ClipStream
from data.command_line import path_option, progress_bars, say
from data.depth.preset import preset_names
from data.prepared import PreparedFrame
from data.source.camera import load_camera
from data.source.frames import CAMERA_PREFIX, discover, open_source, printable
from data.source.layout import ClipLayout, InputError, load_layout
from estimators.contract import Chosen, ClipInfo, Said
from estimators.estimate import FrameEstimate
from estimators.model_settings import check_sources
from estimators.open import EstimatorOptions, open_estimator
from models.onnx_session import ExportedModel
from physics.doors import INTERRUPTED, plain
from results.record import PROGRAM, Provenance, build_record, describe, program_version, sha256_of, units_of
from results.store import FIT, INTERACTIONS, OVERLAY, RECORD, SUMMARY, TABLE, ResultStore, read_record
from results.writer import ClipResults

WORDS = {
    "depth.model": "--depth-model",
    "depth.preset": "--depth-preset",
    "depth.source": "--depth",
    "geometry.smoothing": "--smoothing",
    "give the noise": "give --noise",
}
"""Settings and the options that they are on the command line, for messages."""
DONE, UP_TO_DATE, FAILED = "done", "up to date", "failed"


@dataclass
class Outcome:
    """How one clip, or one input without any, went."""

    name: str
    state: str
    where: str
    """Folder of the results, or why there are none."""
    counts: dict[str, int] = field(default_factory=dict)
    """What was found in the clip (see `counts_of`)."""


class Batch:
    """One run of the program: what was asked for, opened and checked.

    Args:
        options: of the command line.
        console: gets what is said on the way.

    Raises:
        ValueError: something asked for can't be used.
    """

    def __init__(self, options: argparse.Namespace, console: Console) -> None:
        self.options, self.console = options, console
        cv2.setNumThreads(options.threads or -1)
        self.estimator = open_estimator(
            EstimatorOptions(
                options.estimator, options.model, options.onset, options.noise, threads=options.threads or None
            )
        )
        if options.smoothing is not None and self.estimator.name != "direct":
            raise ValueError("--smoothing is for --estimator direct; a network's preparation is as it was trained.")
        self.model: ExportedModel | None = getattr(self.estimator, "model", None)
        self.model_sha256 = "" if self.model is None else sha256_of(self.model.path)
        chosen = Chosen(chosen_layout(options), options.masks, chosen_depth(options), options.smoothing)
        self.settings = self.estimator.preparation(chosen)
        check_sources(self.settings)
        self.store = ResultStore(options.output, PROGRAM)
        self.files = (TABLE, INTERACTIONS, SUMMARY, FIT, RECORD) + ((OVERLAY,) if options.overlay else ())

    def process(self, path: Path, progress: Progress, place: str) -> Outcome:
        """Estimate every frame and every run of contact of a clip and write the results; arguments as of `attempt`."""
        source = open_source(path, self.settings.layout)
        folder = self.store.folder(source.name, path)
        provenance = Provenance(sha256_of(path), self.model_sha256, self.settings, self.estimator.described)
        if self.is_up_to_date(source.name, folder, provenance.fingerprint, self.files):
            return Outcome(source.name, UP_TO_DATE, str(folder), counts_of(read_record(folder)))
        task = progress.add_task(f"{place} {short(plain(source.name))}", total=source.length or None)
        try:
            with ClipResults(
                folder, source.size, source.fps, units_of(self.model), overlay=self.options.overlay
            ) as results:
                clip, started = ClipStream(source, self.settings), time.perf_counter()
                session = self.estimator.start(ClipInfo.of(clip))
                frames: deque[PreparedFrame] = deque()
                for frame in clip:
                    frames.append(frame)
                    _write(results, frames, session.push(frame))
                    progress.advance(task)
                _write(results, frames, session.finish())
                seconds = {**clip.seconds, **session.seconds, **results.seconds}
                seconds["total"] = time.perf_counter() - started + clip.seconds["scale"]
                record = build_record(clip, provenance, self.model, results, seconds)
                results.finish(record, title=source.name, subtitle=describe(record))
        finally:
            progress.remove_task(task)
        for warning in record["warnings"]:
            self.say(f"{source.name}: {warning}")
        return Outcome(source.name, DONE, str(folder), counts_of(record))

    def clips(self) -> tuple[list[Path], list[Outcome]]:
        """Clips under the given inputs, and an outcome for every input that has none."""
        found: dict[Path, None] = {}
        failed = []
        for given in self.options.inputs:
            try:
                if str(given).startswith(CAMERA_PREFIX):
                    raise InputError(f"{given} is a live camera; record it to a video file and give that.")
                found |= dict.fromkeys(discover([given], self.settings.layout))
            except ValueError as error:
                failed.append(self._failure(given, error))
        return list(found), failed

    def attempt(self, path: Path, progress: Progress, place: str) -> Outcome:
        """Process a clip; whatever goes wrong with it is said in one sentence, and the batch goes on.

        Args:
            place: of the clip in the batch, for the progress bar.
        """
        try:
            return self.process(path, progress, place)
        except Exception as error:
            if self.options.debug:
                raise
            return self._failure(path, error)

    def is_up_to_date(self, name: str, folder: Path, fingerprint: str, files: Iterable[str]) -> bool:
        """Whether a clip's folder holds these files as results of exactly this already, which is then said.

        Raises:
            OutputError: it holds results that may not be replaced.
        """
        overwrite = self.options.overwrite
        if not overwrite and self.store.is_complete(folder, fingerprint, files):
            self.say(f"{name}: up to date in {folder}; --overwrite computes it again")
            return True
        self.store.require_replaceable(folder, fingerprint, files, overwrite=overwrite)
        return False

    def _failure(self, path: Path, error: Exception) -> Outcome:
        told = sentence_of(error)
        if not isinstance(error, (ValueError, OSError)):
            told = f"unexpected {type(error).__name__} ({told}); run with --debug and report what it prints."
        sentence = told if printable(path) in told else f"{printable(path)}: {told}"
        self.say(f"failed: {sentence}")
        return Outcome(path.name, FAILED, sentence)

    def say(self, sentence: str) -> None:
        """Print one line as it is: no markup, no wrapping, and harmless whatever a file name holds."""
        say(self.console, sentence)


def sentence_of(error: Exception) -> str:
    """An error's message in this program's words."""
    return in_options(str(error)) or type(error).__name__


def in_options(told: str) -> str:
    """Sentences in this program's words: settings are options here."""
    for setting, option in WORDS.items():
        told = told.replace(setting, option)
    return told


def counts_of(record: Mapping[str, Any]) -> dict[str, int]:
    """What the closing table tells of a clip: runs of contact by verdict, then frames by verdict or status."""
    contacts = {f"contacts {name}": count for name, count in record.get("contacts", {}).items()}
    frames = {name: count for name, count in record.get("statuses", {}).items() if name != "ok"}
    verdicts = record.get("verdicts", {})
    touching = record.get("statuses", {}).get("ok", 0) - sum(verdicts.values())
    return (
        contacts
        | {f"frames {name}": count for name, count in (verdicts | frames).items()}
        | ({"frames in contact": touching} if touching else {})
    )


def _write(results: ClipResults, frames: deque[PreparedFrame], said: Iterable[Said]) -> None:
    """Write what a session says; its frames' estimates come in order."""
    for item in said:
        if isinstance(item, FrameEstimate):
            results.write(frames.popleft(), item)
        else:
            results.add(replace(item, detail=in_options(item.detail)))


def run(options: argparse.Namespace) -> int:
    """Work through a batch and return the program's exit status."""
    console = Console(stderr=True)
    try:
        batch = Batch(options, console)
        paths, outcomes = batch.clips()
    except (ValueError, OSError) as error:
        say(console, f"{PROGRAM}: {sentence_of(error)}")
        return 2
    if not paths:
        return 2
    interrupted = False
    with progress_bars(console) as progress:
        try:
            for number, path in enumerate(paths, start=1):
                outcomes.append(batch.attempt(path, progress, f"{number}/{len(paths)}"))
        except KeyboardInterrupt:
            interrupted = True
    Console().print(_table(outcomes), soft_wrap=True)
    if interrupted:
        finished = sum(outcome.state != FAILED for outcome in outcomes)
        batch.say(f"Interrupted: {finished} of {len(paths)} clips are complete; run the same command to continue.")
        return INTERRUPTED
    return int(any(outcome.state == FAILED for outcome in outcomes))


ONSET_HELP = (
    "when a press begins: between frames, up to a frame's time from the first frame in contact (default, as in real "
    "videos), or at that frame's time stamp (as in data.synthetic's clips)"
)


def add_input_options(add: Callable[..., Any]) -> None:
    """Options that say which clips to read and how; `add` is a parser's `add_argument`."""
    add("inputs", nargs="+", type=_input, metavar="INPUT", help="video files, frame folders, or folders of those")
    add("--output", type=path_option, required=True, metavar="DIR", help="folder of the results, one folder a clip")
    sources = f"auto, stored, {', '.join(preset_names())}, or a depth model's .onnx file"
    add("--depth", metavar="SOURCE", help=f"{sources} (default: as the model was trained, else auto)")
    add("--depth-model", metavar="FILE", help="the .onnx file of a preset that ships none")
    add("--depth-preset", metavar="PRESET", help="preset or .yaml file that says how to read --depth MODEL.onnx")
    sources = "annotation, automatic, or a segmentation model's .onnx file"
    add(
        "--masks",
        metavar="SOURCE",
        help=f"{sources} (default: annotation where there is one, else automatic)",
    )
    add(
        "--layout",
        type=path_option,
        metavar="FILE",
        help="YAML file that names a folder's files (default: CholecSeg8k)",
    )
    add(
        "--camera",
        type=path_option,
        metavar="FILE",
        help="camera (YAML or JSON) for clips that bring none of their own",
    )
    add("--threads", type=_count, default=0, metavar="N", help="CPU threads; 0 = all (default)")
    add("--overwrite", action="store_true", help="compute all clips again and replace earlier results")
    add("--debug", action="store_true", help="stop at the first failure with its traceback")


def add_version(parser: argparse.ArgumentParser) -> None:
    """The option --version."""
    parser.add_argument("--version", action="version", version=f"palpate {program_version()}")


def chosen_layout(options: argparse.Namespace) -> ClipLayout:
    """How the clips' files are named, with the camera given on the command line.

    Raises:
        ValueError: a file can't be used.
    """
    layout = load_layout(options.layout) if options.layout else ClipLayout()
    if options.camera:
        load_camera(options.camera)
        layout = replace(layout, camera=str(options.camera.resolve()))
    return layout


def chosen_depth(options: argparse.Namespace) -> dict[str, Any]:
    """Fields of DepthSettings that were given on the command line."""
    chosen = {"source": options.depth, "model": options.depth_model, "preset": options.depth_preset}
    return {name: value for name, value in chosen.items() if value is not None} | {"threads": options.threads}


def short(name: str, width: int = 36) -> str:
    """A name or its beginning, at most `width` characters."""
    return name if len(name) <= width else name[: width - 1] + "…"


def _input(text: str) -> Path:
    if not text:  # an unset shell variable; as a path it would be the whole working folder
        raise argparse.ArgumentTypeError("an INPUT is empty; name a video file or a folder of frames")
    return Path(text)


def _count(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is not a number of threads; give 0 or more")
    return int(text)


def _table(outcomes: list[Outcome]) -> Table:
    """Clips with what was counted in them, and where the results lie."""
    table = Table(title="Clips", title_justify="left")
    for column in ("clip", "result", "found"):
        table.add_column(column, no_wrap=True)
    table.add_column("results in, or why not", overflow="fold")
    for outcome in outcomes:
        # A line a status: a column each would leave no room for the rest on a narrow terminal.
        counts = "\n".join(plain(f"{count} {status}") for status, count in outcome.counts.items())
        table.add_row(Text(short(plain(outcome.name), 24)), outcome.state, Text(counts), Text(plain(outcome.where)))
    return table
