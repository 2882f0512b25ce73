"""A batch of clips given on the command line: finding them, going on after a failure, and progress."""

import argparse
import functools
import io
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import cv2
from rich.console import Console
from rich.progress import Progress

from palpate.common.command_line import progress_bars, say
from palpate.common.distributed import run_distributed
from palpate.common.doors import INTERRUPTED, interruptible, plain, program
from palpate.common.files import digest_of, file_sha256
from palpate.common.options import filled, flag_of
from palpate.common.workers import WorkerLost, run_tasks
from palpate.data.clip import STAGES, ClipStream
from palpate.data.contact.shaft import NOT_SEEN, ShaftRuler
from palpate.data.prepared import PreparedFrame
from palpate.data.source.bags import is_bag
from palpate.data.source.discovery import discover
from palpate.data.source.frames import name_of, open_source
from palpate.data.source.images import printable
from palpate.data.source.sequence import is_sequence, open_sequence
from palpate.data.source.sequence_checks import require_fit
from palpate.estimators.calibration_file import read_calibration
from palpate.estimators.contract import ClipInfo, Output, Preparation
from palpate.estimators.force_scale import ClipLength
from palpate.estimators.open import ESTIMATORS, preparation
from palpate.estimators.records import FrameEstimate
from palpate.estimators.session import estimates_of
from palpate.results import store
from palpate.results.alarm import ForceAlarm
from palpate.results.bag import write_bag
from palpate.results.calibrated import NEWTONS, ClipCalibration
from palpate.results.columns import UNITS
from palpate.results.options import require_able
from palpate.results.outcome import DONE, FAILED, UP_TO_DATE, Outcome, conclude, counts_of, plural, wording
from palpate.results.record import build_record, depends_on, model_of
from palpate.results.sequence import PARTICLES, causes_of, write_sequence
from palpate.results.writer import ClipResults

Options = tuple[tuple[str, Any], ...]
"""The command line's options with their values, for another process."""


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
        # Stages run side by side: OpenCV's threads of each would wait for one another.
        cv2.setNumThreads(max(1, (options.threads or os.cpu_count() or 1) // STAGES))
        self.calibration = None if options.force_scale is None else read_calibration(options.force_scale)
        self.folders: dict[Path, Path] = {}
        """Folders of clips' results, given out before several processes write into the same output."""
        values = vars(options)
        self.estimator = filled(ESTIMATORS[options.estimator], values).build()
        require_able(self.estimator, values)
        if options.scheduler is not None and options.jobs > 1:
            raise ValueError("--jobs are processes here, --scheduler has workers of its own; leave one of them out.")
        self.settings = preparation(self.estimator, filled(Preparation, values))
        self.store = store.ResultStore(options.output)
        self.fields = self.estimator.tells_field

    def process(self, path: Path, progress: Progress, place: str) -> Outcome:
        """Estimate every frame and every run of contact of a clip and write the results; arguments as of `attempt`."""
        if is_sequence(path):
            return self._sequence(path, progress, place)
        source = open_source(path, self.settings.layout)
        folder = self.folders.get(path) or self.store.folder(source.name, path)
        causes = depends_on(path, self.settings, self.estimator)
        chosen = {name: getattr(self.options, name) for name in ("force_limit", "shaft_diameter", "export")}
        causes |= {name: value for name, value in chosen.items() if value is not None}
        newtons, known = None, None
        if self.calibration is not None:
            given = self.calibration.of_clip(path, self.settings.layout.topic)
            causes["force_scale"] = [file_sha256(file) for file in given.files] or str(given.path)
            known, newtons = given.measured, ClipCalibration(given)
        if store.is_up_to_date(folder, digest_of(causes), self._files(newtons), overwrite=self.options.overwrite):
            return self._kept_results(source.name, folder)
        task = progress.add_task(f"{place} {plain(source.name)[:36]}", total=source.length or None)
        try:
            options: dict[str, Any] = {"overlay": self.options.overlay, "calibration": newtons}
            options |= {"fields": self.fields, "export": self.options.export}
            options["waits"] = self.estimator.name in ("direct", "network")
            if self.options.bag is not None:
                options["bag"] = functools.partial(write_bag, self.options.bag, source)
            if self.estimator.force_seconds is not None:
                options["seconds"] = self.estimator.force_seconds
                if self.options.force_limit is not None:
                    unit = UNITS["force"] if self.calibration is None else NEWTONS
                    options["alarm"] = ForceAlarm(self.options.force_limit, unit, options["seconds"])
            with ClipResults(folder, source.size, source.fps, **options) as results:
                clip, started = ClipStream(source, self.settings), time.perf_counter()
                length = ClipLength.of(clip)
                if newtons is not None:
                    newtons.length = length
                diameter = self.options.shaft_diameter
                if diameter is not None and length.metres is not None:
                    raise ValueError(f"--shaft-diameter has no effect where {length.by} tells metres; leave it out.")
                ruler = None if diameter is None else ShaftRuler(diameter / 1000, clip)
                told = ruler.metres if ruler else lambda: length.metres and (length.metres, length.log_sd)
                session = self.estimator.start(replace(ClipInfo.of(clip), force=known, metres=told))
                frames: deque[PreparedFrame] = deque()
                stream = iter(clip) if self.options.threads == 1 else clip.overlapped()
                stream = ruler.watched(stream) if ruler else stream
                for item in estimates_of(session, _kept(stream, frames, lambda: progress.advance(task))):
                    _write(results, frames, item)
                if ruler is not None:
                    metres, log_sd = ruler.metres() or (None, 0.0)
                    by = NOT_SEEN if metres is None else f"a shaft of {diameter:g} mm"
                    length = replace(length, metres=metres, log_sd=log_sd, by=by)
                results.calibrate(length)
                seconds = {**clip.seconds, **session.seconds, **results.seconds}
                seconds["total"] = time.perf_counter() - started + clip.seconds["scale"]
                record = build_record(clip, causes, model_of(self.estimator), results, seconds)
                results.finish(record, title=source.name)
        finally:
            progress.remove_task(task)
        for warning in record["warnings"]:
            say(self.console, f"{source.name}: {warning}")
        for reason, count in results.unexplained.most_common(3):
            total = results.counts.total()
            said = f"no estimate of {count} of {total} {plural(total, 'contact')}: {reason}"
            say(self.console, f"{source.name}: {said}")
        return Outcome(source.name, DONE, str(folder), counts_of(record))

    def _sequence(self, path: Path, progress: Progress, place: str) -> Outcome:
        """The same of a sequence beside a robot."""
        if not self.estimator.tells_field:
            raise ValueError(f"{printable(path)} is a sequence, which is for --estimator online; give that.")
        chosen = filled(Preparation, vars(self.options))
        for field in fields(chosen):
            if getattr(chosen, field.name) not in (None, field.default) and field.name not in ("threads", "device"):
                said = f"is for videos, and {printable(path)} is a sequence; leave it out"
                raise ValueError(f"{flag_of(field.name)} {said}.")
        name, sequence = name_of(path), open_sequence(path)
        require_fit(sequence)
        folder = self.folders.get(path) or self.store.folder(name, path)
        causes = causes_of(sequence, self.estimator.described)
        files = (store.TABLE, PARTICLES, store.RECORD)
        if store.is_up_to_date(folder, digest_of(causes), files, overwrite=self.options.overwrite):
            return self._kept_results(name, folder)
        task = progress.add_task(f"{place} {plain(name)[:36]}", total=None)
        try:
            done = functools.partial(progress.advance, task)
            record = write_sequence(sequence, self.estimator.settings, folder, causes, done)
        finally:
            progress.remove_task(task)
            with suppress(store.OutputError):
                store.settle(folder)
        for warning in record["warnings"]:
            say(self.console, f"{name}: {warning}")
        return Outcome(name, DONE, str(folder), counts_of(record))

    def _kept_results(self, name: str, folder: Path) -> Outcome:
        """Say that a clip's results are up to date, which is its outcome."""
        say(self.console, f"{name}: up to date in {folder}; --overwrite computes it again")
        return Outcome(name, UP_TO_DATE, str(folder), counts_of(store.read_record(folder)))

    def clips(self) -> tuple[list[Path], list[Outcome]]:
        """Clips under the given inputs, and an outcome for every input that has none."""
        found: dict[Path, None] = {}
        failed = []
        for given in self.options.inputs:
            try:
                found |= dict.fromkeys(discover([given], self.settings.layout))
            except ValueError as error:
                failed.append(self._failure(given, error))
        if self.options.topic is not None and not any(map(is_bag, found)):
            raise ValueError("--topic is of the pictures in a bag, and there is none among the inputs; leave it out.")
        paths, known = list(found), self.calibration
        if known is not None and known.of_one_clip and len(paths) > 1:
            raise ValueError(f"{known.path} tells of a force in one clip, and there are {len(paths)}; give that alone.")
        if self.options.jobs > 1 or self.options.scheduler:
            for path in paths:
                with suppress(ValueError):  # reported when it is the clip's turn
                    self.folders[path] = self.store.folder(name_of(path), path)
        return paths, failed

    def outcomes(self, paths: Sequence[Path], progress: Progress) -> Iterator[Outcome]:
        """How the clips went: one after the other, or with --jobs as they are done, in processes of their own."""
        scheduler = self.options.scheduler
        if not paths or (self.options.jobs == 1 and scheduler is None):
            for number, path in enumerate(paths, start=1):
                yield self.attempt(path, progress, f"{number}/{len(paths)}")
            return
        left = dict.fromkeys(paths)
        jobs = min(self.options.jobs, len(left))
        share = max(1, (self.options.threads or os.cpu_count() or 1) // jobs) if scheduler is None else 1
        options = tuple((vars(self.options) | {"threads": share, "inputs": ()}).items())
        tasks = [(options, path, self.folders.get(path)) for path in left]
        bar = progress.add_task("clips", total=len(tasks))
        try:
            if scheduler is None:
                results = run_tasks(_attempt_in_worker, tasks, jobs, threads=share)
            else:
                results = run_distributed(_attempt_in_worker, tasks, scheduler)
            for path, outcome, lines in results:
                for line in lines:
                    say(self.console, line)
                progress.advance(bar)
                del left[path]
                yield outcome
        except WorkerLost as error:
            yield from (self._failure(path, ValueError(str(error))) for path in left)
        finally:
            for path in left.keys() & self.folders.keys():  # what interrupted workers left
                with suppress(store.OutputError):
                    store.settle(self.folders[path])

    def _files(self, newtons: ClipCalibration | None) -> list[str]:
        """Names of what is written for a clip."""
        wanted = {store.OVERLAY: self.options.overlay, store.FIELDS: self.fields}
        wanted |= {name: kind == self.options.bag for kind, name in store.BAGS.items()}
        wanted |= {store.CALIBRATED: newtons is not None}
        return [name for name in store.WRITTEN if wanted.get(name, True)]

    def attempt(self, path: Path, progress: Progress, place: str) -> Outcome:
        """Process a clip; whatever goes wrong with it is said in one sentence, and the batch goes on.

        Args:
            place: of the clip in the batch, for the progress bar.
        """
        try:
            with interruptible():
                return self.process(path, progress, place)
        except Exception as error:
            if self.options.debug:
                raise
            return self._failure(path, error)

    def _failure(self, path: Path, error: Exception) -> Outcome:
        text = wording(error)
        if not isinstance(error, (ValueError, OSError)):
            text = f"unexpected {type(error).__name__} ({text}); run with --debug and report what it prints."
        sentence = text if printable(path) in text else f"{printable(path)}: {text}"
        say(self.console, f"failed: {sentence}")
        name = name_of(path) if is_sequence(path) else path.name  # many are a sequence.yaml
        return Outcome(name, FAILED, sentence)


def _attempt_in_worker(task: tuple[Options, Path, Path | None]) -> tuple[Path, Outcome, list[str]]:
    """How a clip went in this process, and what there is to say of it, for the one that has the terminal."""
    options, path, folder = task
    batch = _opened(options)
    batch.folders = {} if folder is None else {path: folder}
    with batch.console.capture() as said:
        outcome = batch.attempt(path, progress_bars(batch.console, disable=True), "")
    return path, outcome, said.get().splitlines()


@functools.cache
def _opened(options: Options) -> Batch:
    """The batch, opened once in a worker."""
    return Batch(argparse.Namespace(**dict(options)), Console(file=io.StringIO()))


def _kept(
    stream: Iterable[PreparedFrame], frames: deque[PreparedFrame], done: Callable[[], None]
) -> Iterator[PreparedFrame]:
    """A clip's frames, each of which is kept until its estimate is written."""
    for frame in stream:
        frames.extend((*frame.skipped, frame))
        yield frame
        done()


def _write(results: ClipResults, frames: deque[PreparedFrame], item: Output) -> None:
    """Write an estimate; those of frames come in order."""
    if isinstance(item, FrameEstimate):
        results.write(frames.popleft(), item)
    else:
        results.add(item)


def run(options: argparse.Namespace) -> int:
    """Work through a batch and return the program's exit status."""
    console = Console(stderr=True)
    if options.scheduler is not None:  # its workers run elsewhere
        given = {name: value.absolute() for name, value in vars(options).items() if isinstance(value, Path)}
        vars(options).update(given, inputs=[path.absolute() for path in options.inputs])
    try:
        batch = Batch(options, console)
        paths, outcomes = batch.clips()
    except (ValueError, OSError) as error:
        say(console, f"{program()}: {wording(error)}")
        return 2
    if not paths:
        return 2
    interrupted = False
    with progress_bars(console) as progress:
        try:
            for outcome in batch.outcomes(paths, progress):
                outcomes.append(outcome)
        except KeyboardInterrupt:
            interrupted = True
        except ValueError as error:  # of the scheduler; a clip's is in its outcome
            say(console, f"{program()}: {wording(error)}")
            return 2
    conclude(options.output, outcomes, console)
    if interrupted:
        finished = sum(outcome.state != FAILED for outcome in outcomes)
        say(console, f"Interrupted: {finished} of {len(paths)} clips are complete; run the same command to continue.")
        return INTERRUPTED
    return int(any(outcome.state == FAILED for outcome in outcomes))
