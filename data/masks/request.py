"""Requests for sources of masks, and the interface of these."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Protocol

import numpy as np

from palpate.common.settings import Checked
from palpate.data.masks.class_table import CLASSES
from palpate.data.source.frames import Frame
from palpate.data.source.layout import ClipLayout


@dataclass(frozen=True)
class MaskClasses(Checked, group="classes."):
    """Annotated classes that count as tool and as tissue (Bini 2026, section 3.1: grasper and gallbladder)."""

    tool: tuple[str, ...] = ("grasper",)
    """Names of class_table.CLASSES that are tool."""
    tissue: tuple[str, ...] = ("gallbladder",)
    """Names of class_table.CLASSES that are tissue."""
    tolerance: Annotated[int, 0, 42] = 5
    """Largest L1 distance of a mask's colour from its class's, over the three channels; some differ by only 85."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for field in ("tool", "tissue"):
            names = getattr(self, field)
            unknown = [f"'{name}', which is no class" for name in names if name not in CLASSES]
            if unknown or not names:
                wrong = unknown[0] if unknown else "no class"
                raise ValueError(f"classes.{field} names {wrong}; choose from {', '.join(CLASSES)}.")
        both = sorted(set(self.tool) & set(self.tissue))
        if both:
            raise ValueError(f"classes.tool and classes.tissue both name '{both[0]}'; a class is one or the other.")


class MaskSource(Protocol):
    """Gives the label map of a frame; frames come in order, since a source may look at their motion."""

    identity: str
    """Everything except the frame that the result depends on, for cache keys and reports."""

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map uint8 [H, W] of a readable frame, at its size, of values of `data.labels`.

        Raises:
            MaskError: this frame has no usable mask.
            InputError: the clip can't be masked this way at all.
        """

    def reset(self) -> None:
        """Forget the frames of the clip so far."""


@dataclass(frozen=True)
class MaskRequest:
    """Request to open the mask source of a clip."""

    clip: Path
    """The clip's folder or video file."""
    layout: ClipLayout
    """Names of the clip's files."""
    classes: MaskClasses
    """Annotated classes that are tool and tissue."""
    file: Path = Path()
    """File or folder that was chosen as the source, if any."""
    threads: int = 0
    """CPU threads of a network, as in `data.picture_network.PictureNetwork`."""
    device: str = "cpu"
    """Device of a network, as in `data.picture_network.PictureNetwork`."""
    every: int = 1
    """Number of frames for which one is masked, as in `data.settings.PrepareSettings`."""
