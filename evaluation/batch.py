"""A batch of clips given on the command line: finding them, going on after a failure, progress and closing table."""

from __future__ import annotations

import argparse
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from data.camera import load_camera
from data.clip import PrepareSettings
from data.depth_presets import preset_names
from data.frames import CAMERA_PREFIX, discover, printable
from data.layout import ClipLayout, InputError, load_layout
from data.preparation import FrameRate
from estimators.model_settings import check_sources
from evaluation.drawing import limit_threads
from evaluation.result_store import ResultStore
from evaluation.run_record import program_version

DONE, UP_TO_DATE, FAILED = "done", "up to date", "failed"
INTERRUPTED = 130


@dataclass
class Outcome:
    """How one clip, or one input without any, went."""

    name: str
    state: str
    where: str
    """Folder of the results, or why there are none."""
    counts: dict[str, int] = field(default_factory=dict)
    """What was found in the clip: number of frames by status, or of contacts."""


class Batch(ABC):
    """One run of a program: what was asked for, opened and checked. Each program says what it does with a clip.

    Raises:
        ValueError: something asked for can't be used.
    """

    program: ClassVar[str]
    """Name that starts complaints about wrong usage, and by which results are known."""
    counted: ClassVar[str]
    """What the closing table counts."""
    words: ClassVar[dict[str, str]] = {
        "depth.model": "--depth-model",
        "depth.preset": "--depth-preset",
        "depth.source": "--depth",
    }
    """Settings and the options that they are on the command line, for messages."""

    def __init__(self, options: argparse.Namespace, console: Console) -> None:
        self.options, self.console = options, console
        limit_threads(options.threads)
        self.settings = self.preparation()
        check_sources(self.settings)
        self.store = ResultStore(options.output, self.program)

    @abstractmethod
    def preparation(self) -> PrepareSettings:
        """How clips are prepared, as asked for."""

    @abstractmethod
    def process(self, path: Path, progress: Progress, place: str) -> Outcome:
        """Process a clip, whatever goes wrong raises; arguments as of `attempt`."""

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

    def _failure(self, path: Path, error: Exception) -> Outcome:
        told = self.sentence(error)
        if not isinstance(error, (ValueError, OSError)):
            told = f"unexpected {type(error).__name__} ({told}); run with --debug and report what it prints."
        sentence = told if printable(path) in told else f"{printable(path)}: {told}"
        self.say(f"failed: {sentence}")
        return Outcome(path.name, FAILED, sentence)

    def say(self, sentence: str) -> None:
        """Print one line as it is: no markup, no wrapping, whatever bytes a file name holds."""
        self.console.print(Text(_encodable(sentence)), soft_wrap=True)

    @classmethod
    def sentence(cls, error: Exception) -> str:
        """An error's message in this program's words: settings are options here."""
        told = str(error)
        for setting, option in cls.words.items():
            told = told.replace(setting, option)
        return told or type(error).__name__


def run(kind: type[Batch], options: argparse.Namespace) -> int:
    """Work through a batch and return the program's exit status."""
    console = Console(stderr=True)
    try:
        batch = kind(options, console)
        paths, outcomes = batch.clips()
    except (ValueError, OSError) as error:
        console.print(Text(_encodable(f"{kind.program}: {kind.sentence(error)}")), soft_wrap=True)
        return 2
    except KeyboardInterrupt:
        return INTERRUPTED
    if not paths:
        return 2
    interrupted = False
    with _progress(console) as progress:
        try:
            for number, path in enumerate(paths, start=1):
                outcomes.append(batch.attempt(path, progress, f"{number}/{len(paths)}"))
        except KeyboardInterrupt:
            interrupted = True
    Console().print(_table(outcomes, kind.counted), soft_wrap=True)
    if interrupted:
        finished = sum(outcome.state != FAILED for outcome in outcomes)
        batch.say(f"Interrupted: {finished} of {len(paths)} clips are complete; run the same command to continue.")
        return INTERRUPTED
    return int(any(outcome.state == FAILED for outcome in outcomes))


ONSET_HELP = (
    "when a press begins: between frames, up to a frame's time from the first frame in contact (default, as in real "
    "videos), or at that frame's time stamp (as in data.synthetic's clips)"
)


def add_input_options(add: Callable[..., Any], depth_default: str) -> None:
    """Options that say which clips to read and how, common to all programs.

    Args:
        add: a parser's `add_argument`.
        depth_default: what --depth is where it isn't given.
    """
    add("inputs", nargs="+", type=_input, metavar="INPUT", help="video files, frame folders, or folders of those")
    add("--output", type=Path, required=True, metavar="DIR", help="folder of the results, one folder a clip")
    sources = f"auto, stored, {', '.join(preset_names())}, or a depth model's .onnx file"
    add("--depth", metavar="SOURCE", help=f"{sources} (default: {depth_default})")
    add("--depth-model", metavar="FILE", help="the .onnx file of a preset that ships none")
    add("--depth-preset", metavar="PRESET", help="preset or .yaml file that says how to read --depth MODEL.onnx")
    sources = "annotation, automatic, or a segmentation model's .onnx file"
    add(
        "--masks",
        metavar="SOURCE",
        help=f"{sources} (default: annotation where there is one, else automatic)",
    )
    add("--layout", type=Path, metavar="FILE", help="YAML file that names a folder's files (default: CholecSeg8k)")
    add("--camera", type=Path, metavar="FILE", help="camera (YAML or JSON) for clips that bring none of their own")
    add("--threads", type=_count, default=0, metavar="N", help="CPU threads; 0 = all (default)")
    add("--overwrite", action="store_true", help="compute clips again whose results are up to date")
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


def _progress(console: Console) -> Progress:
    name = TextColumn("{task.description}", markup=False)
    return Progress(name, BarColumn(), MofNCompleteColumn(), FrameRate(), TimeRemainingColumn(), console=console)


def _table(outcomes: list[Outcome], counted: str) -> Table:
    """Clips with what was counted in them, and where the results lie."""
    table = Table(title="Clips", title_justify="left")
    for column in ("clip", "result", counted):
        table.add_column(column, no_wrap=True)
    table.add_column("results in, or why not", overflow="fold")
    for outcome in outcomes:
        # A line a status: a column each would leave no room for the rest on a narrow terminal.
        counts = "\n".join(f"{count} {status}" for status, count in outcome.counts.items())
        cells = (short(outcome.name, 24), outcome.state, outcome.where)
        name, state, where = (Text(_encodable(cell)) for cell in cells)
        table.add_row(name, state, counts, where)
    return table


def _encodable(text: str) -> str:
    return " ".join(text.split()).encode("utf-8", "replace").decode()
