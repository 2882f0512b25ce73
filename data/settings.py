"""Everything that decides how a clip's frames are prepared."""

from dataclasses import dataclass, field
from typing import Annotated

from palpate.common.settings import LARGEST, Checked, NotNegative
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.depth.normalise import DepthSettings
from palpate.data.masks.request import MaskClasses
from palpate.data.source.layout import ClipLayout

PREPROCESSING_VERSION = 3
"""Version of preparation, which rises when the same pixels give a network another input; exported models hold it."""


@dataclass(frozen=True)
class PrepareSettings(Checked):
    """Everything that decides how a clip's frames are prepared."""

    depth: DepthSettings = field(default_factory=DepthSettings)
    """Depth source and normalisation."""
    geometry: GeometrySettings = field(default_factory=GeometrySettings)
    """Grid, mesh and contact."""
    masks: str = "auto"
    """Source of masks: annotation, automatic, auto (annotation where the clip has it), or the path of an ONNX
    segmentation model, of outlines or of a folder (`data.masks.sources`)."""
    classes: MaskClasses = field(default_factory=MaskClasses)
    """Annotated classes that are tool and tissue."""
    layout: ClipLayout = field(default_factory=ClipLayout)
    """Names of the clip's files."""
    bridge_frames: Annotated[int, 0, LARGEST] = 2
    """Largest number of frames in a row without contact that count as flicker and don't end a run of contact."""
    track_seconds: NotNegative = 1.0
    """Time for which the contact's tissue point is followed from its onset, also after its release [s]."""
    every: Annotated[int, 1, LARGEST] = 1
    """Interval at which automatic masks and guessed depth are computed [frames]; in between depth is kept, and
    instruments move along with the picture."""


NUMBERS = ("bridge_frames", "track_seconds")
"""Fields of `PrepareSettings` that exported models hold under these names."""
