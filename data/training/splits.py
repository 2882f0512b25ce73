"""Training, validation and test: by video, so that no patient is in two of them (Bini 2026, section 3.1)."""

import random
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, field
from itertools import combinations, islice
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np

from palpate.common.settings import Checked
from palpate.data.cache import PreparedClip
from palpate.data.depth.normalise import MOST_THREADS

SPLITS = ("train", "val", "test")
"""Names of the splits."""
FRACTIONS = (0.7, 0.2, 0.1)
"""Share of videos in each split (Bini 2026, section 3.1)."""

Item = TypeVar("Item")
Place = tuple[int, int]
"""A sample: index of its clip, index of its frame."""


@dataclass(frozen=True)
class NamedVideos:
    """Videos of each split; a name is a video's (video01) or one of its folders' (video01_00080).

    Other videos are left out, so that the names also record the curated clips (Bini 2026, section 3.1).
    """

    train: tuple[str, ...] = ()
    """Videos to train on; empty if none are named."""
    val: tuple[str, ...] = ()
    """Videos by which the best checkpoint is chosen."""
    test: tuple[str, ...] = ()
    """Videos to evaluate on."""

    def __post_init__(self) -> None:
        given = astuple(self)
        if any(given) and not self.train:
            raise ValueError("videos.train is empty while others are named; name videos to train on.")
        for (first, some), (second, others) in combinations(zip(SPLITS, given, strict=True), 2):
            shared = {name.split("_")[0] for name in some} & {name.split("_")[0] for name in others}
            if shared:
                raise ValueError(
                    f"videos.{first} and videos.{second} both name {', '.join(sorted(shared))}; one video belongs to "
                    "one split, or the same patient is in both."
                )

    def __bool__(self) -> bool:
        return bool(self.train)

    def divide(self, clips: Sequence[Path]) -> dict[str, list[Path]]:
        """Clips of each split, in their order.

        Raises:
            ValueError: a name is none of the clips'.
        """
        unknown = {name for names in astuple(self) for name in names}
        unknown -= {name for clip in clips for name in (clip.name, video_of(clip))}
        if unknown:
            raise ValueError(f"no clip is of {', '.join(sorted(unknown))}; name videos or folders that are there.")
        return {split: [clip for clip in clips if self.holds(split, clip)] for split in SPLITS}

    def holds(self, split: str, clip: Path) -> bool:
        """True if a clip belongs to a split."""
        return not {clip.name, video_of(clip)}.isdisjoint(getattr(self, split))


@dataclass(frozen=True)
class LoadingSettings(Checked):
    """Division of samples among the splits, and batches."""

    # Largest number of samples of a batch.
    batch_size: Annotated[int, 1, 2**16] = 2
    """Number of samples in a batch of one process."""
    num_workers: Annotated[int, 0, MOST_THREADS] = 0
    """Processes that load samples; 0 loads in the training process."""
    fractions: tuple[float, float, float] = FRACTIONS
    """Share of videos for train, val and test."""
    videos: NamedVideos = field(default_factory=NamedVideos)
    """Videos or folders of each split by name, instead of by share."""
    seed: int = 0
    """Seed of the split and of the order of the samples."""

    def __post_init__(self) -> None:
        super().__post_init__()
        off = abs(sum(self.fractions) - 1)
        # Shares may be rounded, as thirds to 0.33.
        if len(self.fractions) != len(SPLITS) or min(self.fractions) < 0 or self.fractions[0] <= 0 or not off < 0.015:
            raise ValueError(f"fractions are {list(self.fractions)}; give shares of train, val and test that add to 1.")


def video_of(clip: Path) -> str:
    """The video that a clip was cut from: videoNN of videoNN/videoNN_SSSSS, else the clip itself."""
    parent = clip.resolve().parent.name
    return parent if clip.name.startswith(f"{parent}_") else clip.stem


def part_sizes(total: int, fractions: Sequence[float]) -> list[int]:
    """Number of items of each split, by the largest remainders; none is left empty while there are enough.

    Args:
        total: number of items.
        fractions: share of each split, not all 0; a share of 0 stays empty.
    """
    exact = [total * fraction / sum(fractions) for fraction in fractions]
    sizes = [int(value + 1e-9) for value in exact]
    by_remainder = sorted(range(len(sizes)), key=lambda index: sizes[index] - exact[index])
    for index in by_remainder[: total - sum(sizes)]:
        sizes[index] += 1
    for index in range(len(sizes)):
        largest = int(np.argmax(sizes))
        if fractions[index] > 0 and sizes[index] == 0 and sizes[largest] > 1:
            sizes[index], sizes[largest] = 1, sizes[largest] - 1
    return sizes


def split_by_video(videos: Iterable[str], fractions: Sequence[float], seed: int) -> dict[str, list[str]]:
    """Videos of each split, drawn by `seed`; the same set of videos always gives the same split."""
    names = sorted(set(videos))
    random.Random(seed).shuffle(names)
    return split_in_time(names, fractions)


def split_in_time(items: Sequence[Item], fractions: Sequence[float]) -> dict[str, list[Item]]:
    """Items of each split: the earliest to train, the latest to test."""
    rest, sizes = iter(items), part_sizes(len(items), fractions)
    return {split: list(islice(rest, size)) for split, size in zip(SPLITS, sizes, strict=True)}


def split_samples(
    clips: Sequence[PreparedClip], found: Sequence[Place], loading: LoadingSettings
) -> tuple[dict[str, list[Place]], str]:
    """Samples of each split: as named, else by video, or in time if fewer than three videos have samples.

    Returns:
        The samples of each split, and a warning (it follows the data set's name) or an empty string.
    """
    if named := loading.videos:
        return {split: [place for place in found if named.holds(split, clips[place[0]].path)] for split in SPLITS}, ""
    videos = [video_of(clips[clip].path) for clip, _ in found]
    count = len(set(videos))
    if count >= 3:
        chosen = split_by_video(videos, loading.fractions, loading.seed)
        by_video = list(zip(found, videos, strict=True))
        return {split: [place for place, video in by_video if video in names] for split, names in chosen.items()}, ""
    places = split_in_time(found, loading.fractions)
    counted = "1 video" if count == 1 else f"{count} videos"
    warning = (
        f"has samples of {counted}, fewer than 3: it is split in time, so the splits show the same "
        "patient and neighbouring frames, and their errors look too good."
    )
    if not places["val"]:
        warning += " It has too few samples to validate; record more contact."
    return places, warning
