"""How well θ predicts the picture: depth some frames ahead, by physics alone and by a trained generator, against truth.

    python -m evaluation.next_depth [--suite noisy] [--clips 30] [--seed N] [--horizon 4] [--checkpoint FILE]

The last depth map is carried along by the rollout of θ (`models.carried_depth`), as the GAN's decoder physics starts
from it: once with the true θ, once with what the network says in that very frame. Compared with noise-free truth are
the pixels within reach of the contact whose depth changes by more than twice its noise. The rivals copy the last map,
or the mean of all maps so far. When the tool lets go is taken as seen later; the estimates don't know it.

Of a checkpoint of `train.py fit` the same is said: the last map carried by what its own head says, and the picture that
its decoder makes. A second table moves θ: from the true one to the farthest corner of the box, by which the generated
picture and the simulated one (the clip's own integrator, rendered without noise) each change over the horizon.
Correlated are these differences, over the pixels that move with either θ.
"""

from __future__ import annotations

from physics.doors import INTERRUPTED, enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from rich.console import Console

from data.command_line import path_option, progress_bars, say, whole_number
from data.synthetic.scene import SceneError
from estimators.estimate import FrameEstimate
from estimators.onset import STAMP
from estimators.open import EstimatorOptions
from estimators.worker_pool import WorkerLost, run_tasks
from evaluation.generated import TrainedGenerator, carried_ahead
from evaluation.recovery.bounds import MECHANICS
from evaluation.recovery.estimators import opened
from evaluation.tables import to_markdown
from evaluation.watched import WatchedClip, add_clip_options, chosen_clips, watch
from models.checkpoint import CheckpointError
from models.onnx_session import SHIPPED, ModelFileError, open_model
from models.records import farthest_corner

NOISES = 2.0
"""Pixels count whose depth changes by more than so many times its noise."""
FEWEST = 3
"""Pixels of a clip that a correlation is worth."""
COPIES = ("last map copied", "mean map copied")
CARRIED = ("carried by the true θ", "carried by the network's θ")
GENERATED = ("carried by its own θ", "generated")
"""What the depth some frames ahead is taken to be; the last two are a trained generator's."""


@dataclass(frozen=True)
class NextDepthTask:
    """One clip of a suite."""

    suite: str
    index: int
    seed: int
    """Seed of the clip."""
    horizon: int
    """Frames ahead."""
    network: EstimatorOptions
    checkpoint: Path | None = None
    """Of a trained generator, to be judged as well."""


@dataclass(frozen=True)
class NextDepthErrors:
    """Of one clip."""

    pixels: int
    """Pixels that count, of all its frames."""
    total: np.ndarray
    """Sum of their absolute errors, by COPIES, CARRIED and, of a trained generator, GENERATED [scene units]."""
    turned: np.ndarray = field(default_factory=lambda: np.empty((2, 0)))
    """How much further the depth of the pixels that move changes with the true θ than with another: generated, and
    simulated, shape [2, P] [scene units]."""


@functools.lru_cache(maxsize=1)
def trained(checkpoint: Path) -> TrainedGenerator:
    """The generator, opened once a process."""
    return TrainedGenerator(checkpoint)


def next_depth_errors(task: NextDepthTask) -> NextDepthErrors:
    """Errors of one clip; no pixels where it has no contact whose onset was seen."""
    generator = None if task.checkpoint is None else trained(task.checkpoint)
    total = np.zeros(len(COPIES + CARRIED) + (0 if generator is None else len(GENERATED)))
    clip = watch(task.suite, task.index, task.seed)
    if clip is None:
        return NextDepthErrors(0, total)
    session, frames = opened(task.network).start(clip.info), clip.frames
    said = [item for frame in frames for item in session.push(frame) if isinstance(item, FrameEstimate)]
    estimates = {item.frame: item.estimate.theta for item in said if item.estimate is not None}
    pixels = 0
    for now in clip.instants(task.horizon):
        theta = estimates.get(frames[now].frame.number)
        if theta is None:
            continue
        by = [clip.motion.theta, theta]
        if generator is not None:
            by.append(generator.estimate(clip, now))
        made = copies(clip, now)
        made += [carried_ahead(clip, now, task.horizon, each, MECHANICS) for each in by]
        if generator is not None:
            made.append(generator.picture(clip, now, by[-1]))
        counted, errors = absolute_errors(clip, now, task.horizon, made)
        pixels, total = pixels + counted, total + errors
    if generator is None:
        return NextDepthErrors(pixels, total)
    return NextDepthErrors(pixels, total, turned(clip, generator))


def copies(clip: WatchedClip, now: int) -> list[np.ndarray]:
    """COPIES, in that order, shape [h, w] each."""
    return [clip.frames[now].depth, np.mean([frame.depth for frame in clip.frames[: now + 1]], axis=0)]


def absolute_errors(clip: WatchedClip, now: int, horizon: int, made: Sequence[np.ndarray]) -> tuple[int, np.ndarray]:
    """How many pixels count, and the sums of their absolute errors in each of the maps made of them, shape [len]."""
    later = clip.truth[now + horizon].depth
    moved = np.abs(later - clip.truth[now].depth) > NOISES * clip.contact.noise
    counted = clip.tissue(now, horizon, clip.truth) & moved
    return int(counted.sum()), np.array([np.abs(depth - later)[counted].sum() for depth in made])


def turned(clip: WatchedClip, generator: TrainedGenerator) -> np.ndarray:
    """`NextDepthErrors.turned` of the farthest corner of the box; empty where that can't be simulated."""
    horizon, head = generator.horizon, generator.generator.head
    theta = torch.tensor(clip.motion.theta[None])
    corner = farthest_corner(theta, head.lower.double(), head.upper.double())[0].numpy()
    try:
        other = clip.truth_at(corner)
    except SceneError:
        return np.empty((2, 0))
    pairs = []
    for now in clip.instants(horizon):
        changes = [truth[now + horizon].depth - truth[now].depth for truth in (clip.truth, other)]
        tissue = clip.tissue(now, horizon, clip.truth) & clip.tissue(now, horizon, other)
        moved = np.max(np.abs(changes), axis=0) > NOISES * clip.contact.noise
        pictures = [generator.picture(clip, now, each) for each in (clip.motion.theta, corner)]
        pairs.append([np.subtract(*both)[tissue & moved] for both in (pictures, changes)])
    return np.concatenate(pairs, axis=1) if pairs else np.empty((2, 0))


def main(arguments: list[str] | None = None) -> int:
    """Measure and print the table; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.next_depth", description=__doc__.split("\n")[0])
    add = parser.add_argument
    add_clip_options(parser, clips=30)
    add("--horizon", type=whole_number(1), default=4, metavar="N", help="frames ahead (default %(default)s)")
    text = "network (default: the one that comes along)"
    add("--model", type=path_option, default=SHIPPED, metavar="FILE", help=text)
    text = "trained generator, a checkpoint of train.py fit, to be judged as well"
    add("--checkpoint", type=path_option, metavar="FILE", help=text)
    options = parser.parse_args(arguments)
    network = EstimatorOptions("network", model=options.model, onset=STAMP, threads=1)
    tasks = [NextDepthTask(*clip, options.horizon, network, options.checkpoint) for clip in chosen_clips(options)]
    console = Console(stderr=True)
    try:
        open_model(options.model, 1)
        if options.checkpoint is not None:
            require_horizon(options.checkpoint, options.horizon)
        with progress_bars(console) as progress:
            run = run_tasks(next_depth_errors, tasks, options.workers, ordered=True)
            found = list(progress.track(run, len(tasks), description="clips"))
    except (CheckpointError, ModelFileError, WorkerLost) as error:
        say(console, str(error), "red")
        return 1
    except KeyboardInterrupt:
        return INTERRUPTED
    names = COPIES + CARRIED + (() if options.checkpoint is None else GENERATED)
    columns = ("suite", "clips", "pixels", *names, *(f"{name} / better copy" for name in names[len(COPIES) :]))
    places = range(0, len(found), options.clips)
    rows = {suite: found[at : at + options.clips] for suite, at in zip(options.suite, places, strict=True)}
    print(f"Depth {options.horizon} frames ahead: mean absolute errors [scene units] of pixels that move")
    print(to_markdown(columns, [_row(suite, errors) for suite, errors in rows.items()]))
    if options.checkpoint is not None:
        print("\nθ moved to the farthest corner of the box: generated against simulated change of the picture")
        columns = ("suite", "clips", "pixels", "correlation", "median of clips", "slope")
        print(to_markdown(columns, [_turned_row(suite, errors) for suite, errors in rows.items()]))
    return 0


def require_horizon(checkpoint: Path, horizon: int) -> None:
    """Refuse a generator that predicts other frames.

    Raises:
        CheckpointError: it does, or can't be used at all.
    """
    trained_for = trained(checkpoint).horizon
    if trained_for != horizon:
        raise CheckpointError(f"{checkpoint} predicts {trained_for} frames ahead; give --horizon {trained_for}.")


def _row(suite: str, errors: Sequence[NextDepthErrors]) -> list[str]:
    used = [item for item in errors if item.pixels]
    pixels = sum(item.pixels for item in used)
    mean = np.sum([item.total for item in errors], axis=0) / max(pixels, 1)
    ratios = mean[len(COPIES) :] / max(float(mean[: len(COPIES)].min()), 1e-12)
    return [
        suite,
        str(len(used)),
        str(pixels),
        *(f"{value:.5f}" for value in mean),
        *(f"{value:.2f}" for value in ratios),
    ]


def _turned_row(suite: str, errors: Sequence[NextDepthErrors]) -> list[str]:
    """Over all pixels, the median of the clips' own, and the generated change a unit of the simulated one."""
    used = [item.turned for item in errors if item.turned.shape[1] >= FEWEST]
    if not used:
        return [suite, "0", "0", "", "", ""]
    generated, simulated = every = np.concatenate(used, axis=1)
    own = [np.corrcoef(each)[0, 1] for each in used]
    slope = (generated * simulated).sum() / np.square(simulated).sum()
    numbers = np.corrcoef(every)[0, 1], np.median(own), slope
    return [suite, str(len(used)), str(every.shape[1]), *(f"{value:.2f}" for value in numbers)]


if __name__ == "__main__":
    run_door(main)
