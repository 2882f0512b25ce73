"""How well θ predicts the picture: depth some frames ahead, made by physics alone, against noise-free truth.

    python -m evaluation.next_depth [--suite noisy] [--clips 30] [--seed N] [--horizon 4]

The last depth map is carried along by the rollout of θ (`models.carried_depth`), as the GAN's decoder physics starts
from it: once with the true θ, once with what the network says in that very frame. Compared are the pixels within reach
of the contact whose depth changes by more than twice its noise. The rivals copy the last map, or the mean of all maps
so far. When the tool lets go is taken as seen later; the estimates don't know it.
"""

from __future__ import annotations

from physics.doors import INTERRUPTED, enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from rich.console import Console

from data.command_line import path_option, progress_bars, say, whole_number
from data.contact.film import window_around
from data.contact.interaction import Interaction
from data.labels import TISSUE
from data.prepared import PreparedFrame
from data.synthetic.clip import draw_press, synthetic_clip
from data.synthetic.scene import Scene, SceneError
from data.synthetic.source import open_synthetic
from data.synthetic.truth import PressedMotion
from estimators.contract import ClipInfo
from estimators.estimate import FrameEstimate
from estimators.onset import STAMP
from estimators.open import EstimatorOptions
from estimators.worker_pool import WorkerLost, run_tasks
from evaluation.recovery.bounds import MECHANICS
from evaluation.recovery.estimators import opened
from evaluation.recovery.evaluate import PREPARE, observed_contacts
from evaluation.recovery.suites import LARGEST_SEED, SPLITS, SUITES, suite_clip_seed
from evaluation.tables import to_markdown
from models.carried_depth import carried
from models.onnx_session import SHIPPED, ModelFileError, open_model
from physics.msd.batch import MeshBatch, PressBatch

NOISES = 2.0
"""Pixels count whose depth changes by more than so many times its noise."""
FIRST = 2
"""Frames after the onset from which on the network says something."""
RIVALS = ("last map copied", "mean map copied", "carried by the true θ", "carried by the network's θ")
"""What the depth some frames ahead is taken to be."""


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


@dataclass(frozen=True)
class NextDepthErrors:
    """Of one clip."""

    pixels: int
    """Pixels that count, of all its frames."""
    total: np.ndarray
    """Sum of their absolute errors, by RIVALS, shape [4] [scene units]."""


def next_depth_errors(task: NextDepthTask) -> NextDepthErrors:
    """Errors of one clip; no pixels where it has no contact whose onset was seen."""
    suite = SUITES[task.suite]
    try:
        scene, motion = draw_press(suite.truth_settings(task.index), task.seed)
    except SceneError:
        return NextDepthErrors(0, np.zeros(len(RIVALS)))
    settings = suite.settings(task.index)
    quiet = dataclasses.replace(settings, depth_noise=0.0, scale_flicker=0.0, depth_bits=16)
    (frames, info), (truth, _) = (
        _observed(dataclasses.replace(scene, settings=chosen), motion, task.seed) for chosen in (settings, quiet)
    )
    contact = observed_contacts(frames, info).get(motion.onset_frame)
    if contact is None:
        return NextDepthErrors(0, np.zeros(len(RIVALS)))
    session = opened(task.network).start(info)
    said = [item for frame in frames for item in session.push(frame) if isinstance(item, FrameEstimate)]
    estimates = {item.frame: item.estimate.theta for item in said if item.estimate is not None}
    pixels, total = 0, np.zeros(len(RIVALS))
    for now in range(motion.onset_frame + FIRST, len(frames) - task.horizon):
        theta = estimates.get(frames[now].frame.number)
        since = (now - motion.onset_frame) / settings.fps
        if theta is None or since + task.horizon / settings.fps > MECHANICS.seconds:
            continue
        made = [
            frames[now].depth,
            np.mean([frame.depth for frame in frames[: now + 1]], axis=0),
            *(
                ahead(contact, frames[now].depth, since, task.horizon / settings.fps, by)
                for by in (motion.theta, theta)
            ),
        ]
        later = truth[now + task.horizon].depth
        counted = moving(contact, frames, now, task.horizon, truth)
        pixels += int(counted.sum())
        total += [np.abs(depth - later)[counted].sum() for depth in made]
    return NextDepthErrors(pixels, total)


def ahead(contact: Interaction, depth: np.ndarray, since: float, seconds: float, theta: np.ndarray) -> np.ndarray:
    """A depth map [h, w] seen some time after the onset, carried so many seconds ahead by θ [3]."""
    steps = np.rint(np.array([[since, since + seconds]]) / MECHANICS.time_step).astype(np.int64)
    sheet = MeshBatch.from_meshes([contact.mesh]), PressBatch.of([contact.load])
    given = torch.from_numpy(depth)[None, None], torch.tensor(theta[None], dtype=torch.float32)
    with torch.no_grad():
        return carried(*given, *sheet, torch.from_numpy(steps), MECHANICS)[0, 0].numpy()


def moving(
    contact: Interaction, frames: Sequence[PreparedFrame], now: int, horizon: int, truth: Sequence[PreparedFrame]
) -> np.ndarray:
    """Tissue near the contact, seen in both frames, whose depth truly changes by more than NOISES, [h, w], bool."""
    here, then = truth[now], truth[now + horizon]
    near = np.zeros(here.depth.shape, bool)
    near[window_around(contact.mesh.pixels[contact.vertex])] = True
    seen = (frames[now].labels == TISSUE) & (then.labels == TISSUE) & (frames[now].depth > 0) & (then.depth > 0)
    return near & seen & (np.abs(then.depth - here.depth) > NOISES * contact.noise)


def _observed(scene: Scene, motion: PressedMotion, seed: int) -> tuple[list[PreparedFrame], ClipInfo]:
    clip = open_synthetic(synthetic_clip(scene, motion, seed), PREPARE)
    return list(clip), ClipInfo.of(clip)


def main(arguments: list[str] | None = None) -> int:
    """Measure and print the table; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.next_depth", description=__doc__.split("\n")[0])
    add = parser.add_argument
    add("--suite", nargs="+", choices=list(SUITES), default=["clean", "noisy"], help="suites (default clean noisy)")
    add("--clips", type=whole_number(1), default=30, metavar="N", help="clips of each (default %(default)s)")
    add("--seed", type=whole_number(0, LARGEST_SEED), default=0, metavar="N", help="(default %(default)s)")
    add("--split", choices=list(SPLITS), default="test", help="stream of seeds (default %(default)s)")
    add("--horizon", type=whole_number(1), default=4, metavar="N", help="frames ahead (default %(default)s)")
    add(
        "--model", type=path_option, default=SHIPPED, metavar="FILE", help="network (default: the one that comes along)"
    )
    add("--workers", type=whole_number(0), default=2, metavar="N", help="processes; 0 = in this one (%(default)s)")
    options = parser.parse_args(arguments)
    network = EstimatorOptions("network", model=options.model, onset=STAMP, threads=1)
    tasks = [
        NextDepthTask(suite, index, suite_clip_seed(options.split, options.seed, index), options.horizon, network)
        for suite in options.suite
        for index in range(options.clips)
    ]
    console = Console(stderr=True)
    try:
        open_model(options.model, 1)
        with progress_bars(console) as progress:
            run = run_tasks(next_depth_errors, tasks, options.workers, ordered=True)
            found = list(progress.track(run, len(tasks), description="clips"))
    except (ModelFileError, WorkerLost) as error:
        say(console, str(error), "red")
        return 1
    except KeyboardInterrupt:
        return INTERRUPTED
    columns = ("suite", "clips", "pixels", *RIVALS, "true θ / better copy", "network's / better copy")
    places = range(0, len(found), options.clips)
    rows = [_row(suite, found[at : at + options.clips]) for suite, at in zip(options.suite, places, strict=True)]
    print(f"Depth {options.horizon} frames ahead: mean absolute errors [scene units] of pixels that move")
    print(to_markdown(columns, rows))
    return 0


def _row(suite: str, errors: Sequence[NextDepthErrors]) -> list[str]:
    used = [item for item in errors if item.pixels]
    pixels = sum(item.pixels for item in used)
    mean = np.sum([item.total for item in used], axis=0) / max(pixels, 1)
    ratios = mean[2:] / max(float(mean[:2].min()), 1e-12)
    return [
        suite,
        str(len(used)),
        str(pixels),
        *(f"{value:.5f}" for value in mean),
        *(f"{value:.2f}" for value in ratios),
    ]


if __name__ == "__main__":
    run_door(main)
