"""Per-frame tissue stiffness, damping and tool force from laparoscopic video, with a trained and exported network.

    python infer.py INPUT... --output DIR [--model parameters.onnx]

Exit status: 0 all clips done, 1 some failed (named; the others are complete), 2 wrong usage, 130 interrupted (finished
clips stay, and the same command continues).
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from data.camera import load_camera
from data.clip import PrepareSettings, stream
from data.depth_presets import preset_names
from data.frames import CAMERA_PREFIX, discover, open_source, printable
from data.layout import ClipLayout, InputError, load_layout
from data.preparation import FrameRate
from estimators.amortized import AmortizedEstimator
from estimators.model_settings import check_sources, preparation_settings
from evaluation.drawing import limit_threads
from evaluation.result_store import ResultStore, read_record
from evaluation.results import ClipResults
from evaluation.run_record import Provenance, build_record, describe, program_version, sha256_of, units_of
from models.onnx_session import ParameterModel

DONE, UP_TO_DATE, FAILED = "done", "up to date", "failed"
INTERRUPTED = 130


@dataclass
class Outcome:
    """How one clip, or one input without any, went."""

    name: str
    state: str
    where: str
    """Folder of the results, or why there are none."""
    statuses: dict[str, int] = field(default_factory=dict)
    """Number of frames by status."""


class Batch:
    """One run of this program: what was asked for, opened and checked.

    Raises:
        ValueError: something asked for can't be used.
    """

    def __init__(self, options: argparse.Namespace, console: Console) -> None:
        self.options, self.console = options, console
        limit_threads(options.threads)
        self.model = ParameterModel(options.model, threads=options.threads or None)
        self.settings = self._settings()
        self.estimator = AmortizedEstimator(self.model)
        check_sources(self.settings)
        self.store = ResultStore(options.output)
        self.model_sha256 = sha256_of(self.model.path)

    def _settings(self) -> PrepareSettings:
        options = self.options
        layout = load_layout(options.layout) if options.layout else ClipLayout()
        if options.camera:
            load_camera(options.camera)
            layout = replace(layout, camera=str(options.camera.resolve()))
        chosen = {"source": options.depth, "model": options.depth_model, "preset": options.depth_preset}
        depth = {name: value for name, value in chosen.items() if value is not None} | {"threads": options.threads}
        return preparation_settings(self.model, layout=layout, masks=options.masks, depth=depth)

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
            return self._process(path, progress, place)
        except Exception as error:
            if self.options.debug:
                raise
            return self._failure(path, error)

    def _process(self, path: Path, progress: Progress, place: str) -> Outcome:
        source, output = open_source(path, self.settings.layout), self.options.output
        folder = self.store.folder(source.name, path)
        provenance = Provenance(sha256_of(path, exclude=output.resolve()), self.model_sha256, self.settings)
        if not self.options.overwrite and self.store.is_complete(folder, provenance.fingerprint, self.options.overlay):
            self.say(f"{source.name}: up to date in {folder}; --overwrite computes it again")
            return Outcome(source.name, UP_TO_DATE, str(folder), read_record(folder).get("statuses", {}))
        task = progress.add_task(f"{place} {_short(source.name)}", total=source.length or None)
        units = units_of(self.model)
        try:
            with ClipResults(folder, source.size, source.fps, units, overlay=self.options.overlay) as results:
                clip, started = stream(source, self.settings), time.perf_counter()
                for result in self.estimator.run(clip):
                    results.write(result)
                    progress.advance(task)
                seconds = {**clip.seconds, **self.estimator.seconds, **results.seconds}
                seconds["total"] = time.perf_counter() - started + clip.seconds["scale"]
                record = build_record(clip, provenance, self.model, results, seconds)
                results.finish(record, title=source.name, subtitle=describe(record))
        finally:
            progress.remove_task(task)
        for warning in record["warnings"]:
            self.say(f"{source.name}: {warning}")
        return Outcome(source.name, DONE, str(folder), record["statuses"])

    def _failure(self, path: Path, error: Exception) -> Outcome:
        told = _sentence(error)
        if not isinstance(error, (ValueError, OSError)):
            told = f"unexpected {type(error).__name__} ({told}); run with --debug and report what it prints."
        sentence = told if printable(path) in told else f"{printable(path)}: {told}"
        self.say(f"failed: {sentence}")
        return Outcome(path.name, FAILED, sentence)

    def say(self, sentence: str) -> None:
        """Print one line as it is: no markup, no wrapping, whatever bytes a file name holds."""
        self.console.print(Text(_encodable(sentence)), soft_wrap=True)


def main(arguments: list[str] | None = None) -> int:
    """Run the program and return its exit status."""
    options = _parser().parse_args(arguments)
    console = Console(stderr=True)
    try:
        batch = Batch(options, console)
        paths, outcomes = batch.clips()
    except (ValueError, OSError) as error:
        console.print(Text(_encodable(f"infer.py: {_sentence(error)}")), soft_wrap=True)
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
    Console().print(_table(outcomes), soft_wrap=True)
    if interrupted:
        finished = sum(outcome.state != FAILED for outcome in outcomes)
        batch.say(f"Interrupted: {finished} of {len(paths)} clips are complete; run the same command to continue.")
        return INTERRUPTED
    return int(any(outcome.state == FAILED for outcome in outcomes))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description="Estimate tissue stiffness, damping and tool force for every frame of laparoscopic clips. "
        "Research software, not a medical device.",
        epilog="Exit status: 0 all clips done, 1 some failed, 2 wrong usage, 130 interrupted.",
    )
    add = parser.add_argument
    add("inputs", nargs="+", type=_input, metavar="INPUT", help="video files, frame folders, or folders of those")
    add("--output", type=Path, required=True, metavar="DIR", help="folder of the results, one folder a clip")
    add("--model", type=Path, default=Path("parameters.onnx"), help="file from train.py export (default: %(default)s)")
    sources = f"auto, stored, {', '.join(preset_names())}, or a depth model's .onnx file"
    add("--depth", metavar="SOURCE", help=f"{sources} (default: as the model was trained)")
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
    add("--no-overlay", dest="overlay", action="store_false", help="leave the overlay video out")
    add("--debug", action="store_true", help="stop at the first failure with its traceback")
    add("--version", action="version", version=f"palpate {program_version()}")
    return parser


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


def _table(outcomes: list[Outcome]) -> Table:
    """Clips with their counts by status, and where the results lie."""
    table = Table(title="Clips", title_justify="left")
    for column in ("clip", "result", "frames"):
        table.add_column(column, no_wrap=True)
    table.add_column("results in, or why not", overflow="fold")
    for outcome in outcomes:
        # A line a status: a column each would leave no room for the rest on a narrow terminal.
        counts = "\n".join(f"{count} {status}" for status, count in outcome.statuses.items())
        cells = (_short(outcome.name, 24), outcome.state, outcome.where)
        name, state, where = (Text(_encodable(cell)) for cell in cells)
        table.add_row(name, state, counts, where)
    return table


def _sentence(error: Exception) -> str:
    """An error's message in this door's words: settings are options here."""
    told = str(error).replace("depth.model", "--depth-model").replace("depth.preset", "--depth-preset")
    return told.replace("depth.source", "--depth") or type(error).__name__


def _encodable(text: str) -> str:
    return " ".join(text.split()).encode("utf-8", "replace").decode()


def _short(name: str, width: int = 36) -> str:
    return name if len(name) <= width else name[: width - 1] + "…"


if __name__ == "__main__":
    sys.exit(main())
