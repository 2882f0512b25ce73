"""How well θ predicts the picture: depth some frames ahead, by physics alone and by a trained generator, against truth.

The last depth map is carried along by the rollout of θ (`models.carried_depth`), as the GAN's decoder physics starts
from it: once with the true θ, once with what the network says in that very frame. Compared with noise-free truth are
the pixels within reach of the contact whose depth changes by more than twice its noise: mean absolute errors [scene
units]. The rivals copy the last map, or the mean of all maps so far. When the tool lets go is taken from later frames;
the estimates don't know it.

Of a checkpoint of `train.py fit` the same is measured: the last map carried by what its own head says, and the picture
that its decoder makes.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pandas as pd

from palpate.common.options import require_within
from palpate.common.settings import LARGEST
from palpate.estimators.onset import STAMP
from palpate.estimators.open import EstimatorOptions
from palpate.estimators.records import FrameEstimate
from palpate.evaluation.ablation.generated import TrainedGenerator, carried_ahead
from palpate.evaluation.ablation.watched import WatchedClip, watch
from palpate.evaluation.harness import Experiment, Report, Row
from palpate.evaluation.recovery.bounds import MECHANICS
from palpate.evaluation.recovery.estimators import opened
from palpate.evaluation.recovery.suites import LARGEST_SEED, SUITES, suite_clip_seed
from palpate.models.checkpoint import CheckpointError
from palpate.models.onnx_session import SHIPPED, open_model
from palpate.results.record import sha256_of

NOISES = 2.0
"""Pixels count whose depth changes by more than so many times its noise."""
COPIES = ("last map copied", "mean map copied")
CARRIED = ("carried by the true θ", "carried by the network's θ")
GENERATED = ("carried by its own θ", "generated")
"""What the depth some frames ahead is taken to be; the last two are a trained generator's."""


@functools.lru_cache(maxsize=1)
def trained(checkpoint: Path) -> TrainedGenerator:
    """The generator, opened once a process."""
    return TrainedGenerator(checkpoint)


def next_depth_errors(case: tuple[NextDepth, tuple[str, int]]) -> list[Row]:
    """Errors of one clip of a suite; no pixels where it has no contact whose onset was observed.

    Returns:
        A row with `pixels`: how many count, of all its frames; and `total`: the sum of their absolute errors, by
        COPIES, CARRIED and, of a trained generator, GENERATED [scene units].
    """
    asked, (suite, index) = case
    named: Row = {"suite": suite, "index": index}
    generator = None if asked.checkpoint is None else trained(asked.checkpoint)
    total = np.zeros(len(COPIES + CARRIED) + (0 if generator is None else len(GENERATED)))
    clip = watch(suite, index, suite_clip_seed(asked.split, asked.seed, index))
    if clip is None:
        return [named | {"pixels": 0, "total": total}]
    network = EstimatorOptions("network", model=asked.model, onset=STAMP, threads=1)
    session, frames = opened(network).start(clip.info), clip.frames
    outputs = [item for frame in frames for item in session.push(frame) if isinstance(item, FrameEstimate)]
    estimates = {item.frame: item.estimate.theta for item in outputs if item.estimate is not None}
    pixels = 0
    for now in clip.instants(asked.horizon):
        theta = estimates.get(frames[now].frame.number)
        if theta is None:
            continue
        by = [clip.motion.theta, theta]
        if generator is not None:
            by.append(generator.estimate(clip, now))
        made = copies(clip, now)
        made += [carried_ahead(clip, now, asked.horizon, each, MECHANICS) for each in by]
        if generator is not None:
            made.append(generator.picture(clip, now, by[-1]))
        counted, errors = absolute_errors(clip, now, asked.horizon, made)
        pixels, total = pixels + counted, total + errors
    return [named | {"pixels": pixels, "total": total}]


def copies(clip: WatchedClip, now: int) -> list[np.ndarray]:
    """COPIES, in that order, shape [h, w] each."""
    return [clip.frames[now].depth, np.mean([frame.depth for frame in clip.frames[: now + 1]], axis=0)]


def absolute_errors(clip: WatchedClip, now: int, horizon: int, made: Sequence[np.ndarray]) -> tuple[int, np.ndarray]:
    """How many pixels count, and the sums of their absolute errors in each of the maps made of them, shape [len]."""
    later = clip.truth[now + horizon].depth
    moved = np.abs(later - clip.truth[now].depth) > NOISES * clip.contact.noise
    counted = clip.tissue(now, horizon) & moved
    return int(counted.sum()), np.array([np.abs(depth - later)[counted].sum() for depth in made])


@dataclass(frozen=True)
class NextDepth(Experiment):
    """Which clips, how far ahead, and what is judged."""

    suite: tuple[str, ...] = ("clean", "noisy")
    """suites of presses"""
    clips: int = 30
    """clips of each"""
    seed: int = 0
    """another seed gives other clips"""
    split: Literal["training", "validation", "test"] = "test"
    """stream of seeds"""
    horizon: int = 4
    """frames ahead"""
    model: Path = SHIPPED
    """network"""
    checkpoint: Path | None = None
    """trained generator, a checkpoint of train.py fit, to be judged as well"""
    workers: int = 2
    """processes; 0 = in this one"""

    keys: ClassVar = ("suite", "index")
    work: ClassVar = staticmethod(next_depth_errors)
    refused: ClassVar = (CheckpointError,)

    def __post_init__(self) -> None:
        """Raise a ValueError where an option can't be used."""
        require_within(self, clips=(1, LARGEST), seed=(0, LARGEST_SEED), horizon=(1, LARGEST), workers=(0, LARGEST))
        if not set(self.suite) <= set(SUITES):
            raise ValueError(f"--suite {' '.join(self.suite)}: give some of {', '.join(SUITES)}.")

    def record(self) -> Mapping[str, Any]:
        """What the results depend on.

        Raises:
            CheckpointError: the generator predicts other frames, or can't be used at all.
            ModelFileError: the network can't be used.
        """
        if self.checkpoint is not None and trained(self.checkpoint).horizon != self.horizon:
            ahead = trained(self.checkpoint).horizon
            raise CheckpointError(f"{self.checkpoint} predicts {ahead} frames ahead; give --horizon {ahead}.")
        found = {"seed": self.seed, "split": self.split, "horizon": self.horizon}
        checkpoint = None if self.checkpoint is None else sha256_of(self.checkpoint)
        return found | {"model": open_model(self.model, 1).sha256, "checkpoint": checkpoint}

    @property
    def wanted(self) -> list[tuple[str, int]]:
        """Every clip of every suite."""
        return [(suite, index) for suite in self.suite for index in range(self.clips)]

    def report(self, rows: Mapping[tuple, Row]) -> Report:
        """A row a suite."""
        found = [rows[key] for key in self.wanted if key in rows]
        frame = table(found)
        return Report({"table.csv": frame}, [frame])


def table(rows: Sequence[Row]) -> pd.DataFrame:
    """A row a suite: mean errors over all pixels, and over the better copy's."""
    found = []
    for suite in dict.fromkeys(row["suite"] for row in rows):
        own = [row for row in rows if row["suite"] == suite]
        pixels = sum(row["pixels"] for row in own)
        mean = np.sum([row["total"] for row in own], axis=0) / max(pixels, 1)
        names = (COPIES + CARRIED + GENERATED)[: len(mean)]
        cells: Row = {"suite": suite, "clips": sum(row["pixels"] > 0 for row in own), "pixels": pixels}
        cells |= dict(zip(names, mean.tolist(), strict=True))
        copied = max(float(mean[: len(COPIES)].min()), 1e-12)
        cells |= {f"{name} / better copy": cells[name] / copied for name in names[len(COPIES) :]}
        found.append(cells)
    return pd.DataFrame(found)
