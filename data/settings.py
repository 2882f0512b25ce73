"""Everything that decides how a clip's frames are prepared."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

from data.contact.geometry import GeometrySettings
from data.depth.normalise import DepthSettings
from data.masks.sources import MaskClasses
from data.source.layout import ClipLayout

PREPROCESSING_VERSION = 3
"""Raised when the same pixels would give a network another input; exported models carry it."""


@dataclass(frozen=True)
class PrepareSettings:
    """Everything that decides how a clip's frames are prepared."""

    depth: DepthSettings = field(default_factory=DepthSettings)
    """Depth source and normalisation."""
    geometry: GeometrySettings = field(default_factory=GeometrySettings)
    """Grid, mesh and contact."""
    masks: str = "auto"
    """annotation, automatic, auto (annotation where the clip has it), or the path of an ONNX segmentation model."""
    classes: MaskClasses = field(default_factory=MaskClasses)
    """Which annotated classes are tool and tissue."""
    layout: ClipLayout = field(default_factory=ClipLayout)
    """How the clip's files are named."""
    bridge_frames: int = 2
    """Contact that is missing on up to this many frames in a row counts as flicker: the run of contact goes on."""
    track_seconds: float = 1.0
    """How long the contact's tissue point is followed from its onset, beyond its release [s]."""

    def __post_init__(self) -> None:
        if self.bridge_frames < 0:
            raise ValueError(f"bridge_frames is {self.bridge_frames}; give 0 or more.")
        if not (math.isfinite(self.track_seconds) and self.track_seconds >= 0):
            raise ValueError(f"track_seconds is {self.track_seconds}; give a number of seconds of at least 0.")


NUMBERS = tuple(item.name for item in fields(PrepareSettings) if type(item.default) in (int, float))
"""Its fields that are plain numbers; exported models carry them by these names."""
