"""A batch of clips given on the command line: finding them, going on after a failure, and progress."""

import argparse
import functools
import io
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
from rich.console import Console
from rich.progress import Progress
from threadpoolctl import threadpool_limits

from palpate.common.command_line import progress_bars, say
from palpate.common.distributed import run_distributed
from palpate.common.doors import INTERRUPTED, interruptible, plain, program
from palpate.common.files import digest_of
from palpate.common.options import filled
from palpate.common.workers import WorkerLost, run_tasks
from palpate.data.clip import STAGES
from palpate.data.source.bags import is_bag
from palpate.data.source.discovery import discover
from palpate.data.source.frames import name_of
from palpate.data.source.images import printable
from palpate.data.source.sequence import is_sequence
from palpate.estimators.calibration_file import read_calibration
from palpate.estimators.contract import Preparation
from palpate.estimators.open import ESTIMATORS, preparation
from palpate.results import store
from palpate.results.options import require_able
from palpate.results.outcome import DONE, FAILED, UP_TO_DATE, Outcome, conclude, wording
from palpate.results.sequence import SequenceClip
from palpate.results.video import VideoClip

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
        # Stages run side by side: the libraries' threads of each would wait for one another, those of BLAS busily.
        threads = max(1, (options.threads or os.cpu_count() or 1) // STAGES)
        cv2.setNumThreads(threads)
        threadpool_limits(threads, user_api="blas")
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

    def process(self, path: Path, progress: Progress, place: str) -> Outcome:
        """Estimate a clip and write its results; arguments as in `attempt`."""
        kind: Any = SequenceClip if is_sequence(path) else VideoClip
        clip = kind(path, self)
        folder = self.folders.get(path) or self.store.folder(clip.name, path)
        if store.is_up_to_date(folder, digest_of(clip.causes), clip.files, overwrite=self.options.overwrite):
            say(self.console, f"{clip.name}: up to date in {folder}; --overwrite computes it again")
            return Outcome.of(clip.name, UP_TO_DATE, folder)
        task = progress.add_task(f"{place} {plain(clip.name)[:36]}", total=clip.length or None)
        try:
            record = clip.write(folder, lambda: progress.advance(task))
        finally:
            progress.remove_task(task)
            with suppress(store.OutputError):
                store.settle(folder)
        for sentence in (*record["warnings"], *clip.remarks):
            say(self.console, f"{clip.name}: {sentence}")
        return Outcome.of(clip.name, DONE, folder)

    def clips(self) -> tuple[list[Path], list[Outcome]]:
        """Return clips under the given inputs, and an outcome for every input that has none."""
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
        """Yield outcomes of the clips: one after the other, or with --jobs as they are done, in processes of their
        own."""
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
    """Process a clip in this process; return its outcome and the lines to print, for the process that has the
    terminal."""
    options, path, folder = task
    batch = _opened(options)
    batch.folders = {} if folder is None else {path: folder}
    with batch.console.capture() as printed:
        outcome = batch.attempt(path, progress_bars(batch.console, disable=True), "")
    return path, outcome, printed.get().splitlines()


@functools.cache
def _opened(options: Options) -> Batch:
    """Open the batch, once in a worker."""
    return Batch(argparse.Namespace(**dict(options)), Console(file=io.StringIO()))


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
