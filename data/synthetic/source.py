"""A synthetic clip in memory as a source of frames, so that benchmarks of a thousand clips write no files."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from palpate.data.clip import ClipStream
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.depth.model import RawDepth
from palpate.data.depth.normalise import DepthSettings
from palpate.data.depth.sources import DepthSource
from palpate.data.labels import OTHER, TISSUE, TOOL
from palpate.data.masks.class_table import CLASSES
from palpate.data.settings import PrepareSettings
from palpate.data.source.frames import Frame, FrameSource
from palpate.data.synthetic.clip import SyntheticClip

PREPARE = PrepareSettings(DepthSettings("stored"), GeometrySettings(smoothing=4, rigid_motion="subtract"))
"""Preparation of the benchmarks' clips, for which the contact posterior is trained."""


class SyntheticSource(FrameSource):
    """Pictures of a synthetic clip."""

    def __init__(self, clip: SyntheticClip) -> None:
        self._images = clip.images
        self.name = f"synthetic-{clip.seed}"
        self.path = Path(self.name)
        self.size = clip.images.shape[2], clip.images.shape[1]
        self.fps = clip.scene.settings.fps
        self.length = len(clip.images)
        self.warnings = []

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order, from the beginning."""
        return (Frame(index, index, index / self.fps, image) for index, image in enumerate(self._images))


class _Depth(DepthSource):
    """Observed depth of a synthetic clip."""

    identity, known_scale = "synthetic", 1.0

    def __init__(self, clip: SyntheticClip) -> None:
        self._depth = clip.depth

    def observe(self, frame: Frame) -> RawDepth:
        """Observed z of a frame."""
        return RawDepth(self._depth[frame.index])


class _Masks:
    """Observed masks of a synthetic clip."""

    identity = "synthetic"

    def __init__(self, clip: SyntheticClip) -> None:
        by_code = np.full(256, OTHER, np.uint8)
        by_code[CLASSES["grasper"].grey], by_code[CLASSES["gallbladder"].grey] = TOOL, TISSUE
        self._labels = by_code[clip.labels]

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map of a frame."""
        return self._labels[frame.index]

    def reset(self) -> None:
        """Nothing is remembered from frame to frame."""


def open_synthetic(clip: SyntheticClip, settings: PrepareSettings) -> ClipStream:
    """A synthetic clip as a stream of prepared frames, with its own depth, labels and camera."""
    return ClipStream(SyntheticSource(clip), settings, masks=_Masks(clip), depth=_Depth(clip), camera=clip.camera)
