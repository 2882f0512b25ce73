"""One prepared frame, which training preparation stores and inference consumes."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

from palpate.data.contact.geometry import FrameGeometry, GeometrySettings, GeometryStatus, dent_geometry
from palpate.data.contact.tips import free_ends
from palpate.data.labels import TOOL
from palpate.data.shading.registration import View
from palpate.data.source.camera import Camera
from palpate.data.source.frames import Frame
from palpate.data.tracks.following import Shown

STATUSES = ("ok", "no_tool", "no_tissue", "no_contact", "bad_depth", "unreadable", "no_mask", "repeated")
"""Statuses of a frame: `ok` means in contact; others name the reason for no contact, `repeated` for no new picture or
depth."""
OUT_OF_CONTACT = ("no_tool", "no_contact")
"""Statuses of frames known to be out of contact; for all others but `ok` that is unknown."""


def _unknown() -> np.ndarray:
    return np.full(3, np.nan)


@dataclass
class PreparedFrame:
    """A frame with its depth, labels, contact and motion; the motion is filled in once the next frame is known."""

    frame: Frame
    """The frame, its image free of lens distortion."""
    status: str
    """One of STATUSES."""
    detail: str
    """Reason for a status other than `ok`, or for a dubious contact, one sentence; empty if there is none."""
    depth: np.ndarray
    """z on the grid, shape [h, w], float32 in [0, 1] [scene units]; 0 = invalid."""
    labels: np.ndarray
    """Label map on the grid, shape [h, w], uint8."""
    picture_labels: np.ndarray | None = None
    """Label map at the image's size, or None where there is no image or no mask."""
    geometry: FrameGeometry | None = None
    """Contact and mesh where the status is `ok`."""
    contact_probability: float = math.nan
    """Probability of contact, by whether tissue moves with the tool (`data.contact.evidence`); NaN where outlines and
    depth already exclude contact."""
    undecided: bool = False
    """True if the tool hovered before, and since then neither motion nor depth decides about contact."""
    make_light: Callable[[], np.ndarray] | None = None
    """Function for the logarithm of the tissue's light, as in `data.shading.light.log_light`; None if it isn't used."""
    light_view: View | None = None
    """View in which that light lies on its lattice; None = the frame's own, of a camera that stands still."""
    press: tuple[int, int] | None = None
    """Grid pixel (u, v) of the dent by whose darkening a press was found; None if outlines decide about contact."""
    distance: float = math.nan
    """Distance of tool and tissue [scene units]; NaN where it was not measured."""
    displacement: np.ndarray = field(default_factory=_unknown)
    """Observed motion of the contact from this frame to the next, shape [3] [scene units]; NaN where it is unknown."""
    backward: np.ndarray = field(default_factory=_unknown)
    """Observed motion of this frame's contact back to the preceding frame, shape [3] [scene units]; NaN where it is
    unknown."""
    rigid: np.ndarray = field(default_factory=_unknown)
    """Motion to the next frame if the contact moved rigidly with the tissue far from it, shape [3] [scene units]."""
    consecutive: bool = False
    """True if a next frame exists and has the next number."""
    track_start: int = -1
    """Index of the frame where this run of contact began, kept after its release; -1 where no onset was observed."""
    track_position: np.ndarray = field(default_factory=_unknown)
    """Current position of the tissue point that was the contact at `track_start`, shape [3] [scene units]; NaN once it
    is lost."""
    skipped: tuple["PreparedFrame", ...] = ()
    """Frames right before it that measure nothing: their picture repeats, or their depth jumps."""
    instruments: np.ndarray | None = None
    """Number of the instrument at every pixel of the grid (`data.contact.instruments`), 0 = none, uint8 [h, w]."""

    @property
    def light(self) -> np.ndarray | None:
        """Logarithm of the tissue's light by `make_light`, if any."""
        return None if self.make_light is None else self.make_light()

    def follows(self, number: int) -> bool:
        """Return whether it is the next measurement after the frame of that number."""
        return self.frame.number - len(self.skipped) - number == 1

    def reject(self, detail: str) -> None:
        """Take it that nothing touches the tissue, for a reason."""
        self.status, self.detail, self.geometry = "no_contact", detail, None

    def dismiss(self, detail: str) -> None:
        """Reject a contact that only outlines show, for a reason; no probability of it is left."""
        self.reject(detail)
        self.contact_probability, self.undecided = math.nan, False

    def accept(self, geometry: FrameGeometry | None) -> None:
        """Take it that an instrument touches the tissue there."""
        self.status, self.detail, self.geometry = "ok", "", geometry

    def press_at(self, pixel: tuple[int, int], camera: Camera, settings: GeometrySettings) -> bool:
        """Take the tissue at a grid pixel (u, v) with a dent for the contact; return whether that gives a mesh."""
        try:
            self.geometry = dent_geometry(self.depth, self.labels, pixel, camera, settings)
            self.status, self.detail = "ok", ""
        except GeometryStatus as status:
            self.status, self.detail, self.geometry = status.status, status.detail, None
        return self.in_contact

    @property
    def time_s(self) -> float:
        """Time stamp [s]."""
        return self.frame.time_s

    @property
    def in_contact(self) -> bool:
        """True if the tool touches the tissue."""
        return self.geometry is not None

    @property
    def hovers(self) -> bool:
        """True if the tool is at tissue in the picture that does not move with it."""
        return not self.in_contact and math.isfinite(self.contact_probability)

    @property
    def out_of_contact(self) -> bool:
        """True if this very frame shows that there is no contact; that a tool hovers is known some frames later."""
        return self.status in OUT_OF_CONTACT and not self.hovers

    @property
    def contact(self) -> FrameGeometry:
        """The geometry of a frame that is in contact; ValueError where it isn't."""
        if self.geometry is None:
            raise ValueError(f"Frame {self.frame.number} is not in contact: {self.detail}")
        return self.geometry

    @property
    def visible(self) -> bool:
        """True if the frame has an image and labels, so that tissue can be tracked into it."""
        return self.picture_labels is not None

    @cached_property
    def shown(self) -> Shown:
        """Image and label map of a frame that is visible, made small once for all; ValueError where it isn't."""
        if self.picture_labels is None:
            raise ValueError(f"Frame {self.frame.number} has no labels: {self.detail}")
        return Shown.of_view((self.frame.picture, self.picture_labels))

    @cached_property
    def ends(self) -> np.ndarray | None:
        """Mask of the free ends of instruments, which may touch, bool [h, w]; None if there is none."""
        return self.ends_within(None)

    def ends_within(self, reach: float | None) -> np.ndarray | None:
        """Parts of instruments within `reach` grid pixels of their tips; None = as in `tips.free_ends`."""
        tool = self.labels == TOOL
        if not (self.visible and tool.any()):
            return None
        size = self.labels.shape[::-1]
        lit = cv2.resize(self.shown.lit.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        return free_ends(tool, lit, reach)

    @property
    def instrument(self) -> int | None:
        """Number of the instrument that touches; None where none does."""
        if self.geometry is None or self.instruments is None or not self.instruments.any():
            return None
        places = np.argwhere(self.instruments)
        nearest = np.square(places - np.array(self.geometry.pixel[::-1])).sum(axis=1).argmin()
        return int(self.instruments[tuple(places[nearest])])

    @property
    def has_depth(self) -> bool:
        """True if any pixel has a depth, so that the frame can be part of a window."""
        return bool(self.depth.any())
