"""Tool and tissue masks of a frame: annotation colours, an ONNX model, or the automatic mode for raw video.

Label maps are uint8 [H, W]: 0 other, 1 tissue, 2 tool (Bini 2026, section 3.1: only the binary tool/tissue partition
of the annotation is used).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from data.labels import OTHER, TISSUE, TOOL
from data.masks.class_table import CLASSES
from data.source.frames import Frame, read_image
from data.source.layout import ClipLayout, InputError, clip_folder, companion, is_file, matches


class MaskError(InputError):
    """The mask of one frame is missing or unusable; the clip's other frames go on."""


@dataclass(frozen=True)
class MaskClasses:
    """Which annotated classes count as tool and as tissue (Bini 2026, section 3.1: grasper and gallbladder)."""

    tool: tuple[str, ...] = ("grasper",)
    """Names of class_table.CLASSES that are tool."""
    tissue: tuple[str, ...] = ("gallbladder",)
    """Names of class_table.CLASSES that are tissue."""
    tolerance: int = 5
    """Largest L1 distance of a mask's colour from its class's colour, over the three channels."""

    def __post_init__(self) -> None:
        for field in ("tool", "tissue"):
            names = tuple(getattr(self, field))
            object.__setattr__(self, field, names)
            unknown = [name for name in names if name not in CLASSES]
            if unknown or not names:
                wrong = f"'{unknown[0]}', which is no class" if unknown else "no class"
                raise ValueError(f"classes.{field} names {wrong}; choose from {', '.join(CLASSES)}.")
        both = sorted(set(self.tool) & set(self.tissue))
        if both:
            raise ValueError(f"classes.tool and classes.tissue both name '{both[0]}'; a class is one or the other.")
        if not 0 <= self.tolerance <= 42:
            raise ValueError(f"classes.tolerance is {self.tolerance}; give 0 to 42 (some colours differ by only 85).")


class MaskSource(Protocol):
    """Gives the label map of a frame; frames come in order, since a source may look at their motion."""

    identity: str
    """What the result depends on besides the frame, for cache keys and reports."""

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map uint8 [H, W] of a readable frame, at its size.

        Raises:
            MaskError: this frame has no usable mask.
            InputError: the clip can't be masked this way at all.
        """

    def reset(self) -> None:
        """Forget the clip seen so far."""


def open_masks(kind: str, layout: ClipLayout, classes: MaskClasses) -> MaskSource:
    """Open a mask source.

    Args:
        kind: "annotation", "automatic", "auto" (annotation where the clip has masks, else automatic), or the path of an
            ONNX segmentation model (see data.masks.onnx for its settings).

    Raises:
        InputError: an unknown kind, or a model that can't be used.
    """
    # Imported here: only the chosen source's dependencies are needed.
    if kind == "annotation":
        return AnnotationMasks(layout, classes)
    if kind == "automatic":
        from data.masks.automatic import AutomaticMasks

        return AutomaticMasks()
    if kind == "auto":
        return AnnotationElseAutomatic(layout, classes)
    if kind.lower().endswith(".onnx"):
        from data.masks.onnx import OnnxMasks

        return OnnxMasks(Path(kind))
    raise InputError(f"masks '{kind}' is unknown; choose annotation, automatic, auto or the path of an .onnx model.")


class AnnotationMasks:
    """Masks stored beside the frames, by the layout's patterns and the classes' colours."""

    def __init__(self, layout: ClipLayout, classes: MaskClasses) -> None:
        self.layout, self.classes = layout, classes
        self.identity = f"annotation:{classes}:{layout.mask_patterns}"
        self._checked: Path | None = None

    def reset(self) -> None:
        """Look at the clip's folder anew."""
        self._checked = None

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map of a frame (see MaskSource)."""
        if frame.path is None or not self.layout.mask_patterns:
            what = "a video or camera has" if frame.path is None else "the layout names"
            raise InputError(f"{what} no annotation masks; use --masks automatic or a segmentation model.")
        clip = clip_folder(self.layout, frame.path)
        if clip != self._checked:
            if not has_masks(clip, self.layout):
                expected = companion(self.layout, frame.path, self.layout.mask_patterns[0]).name
                raise InputError(
                    f"{clip} holds no annotation masks (such as {expected}); use --masks automatic or a model."
                )
            self._checked = clip
        files = [companion(self.layout, frame.path, pattern) for pattern in self.layout.mask_patterns]
        file = next((path for path in files if is_file(path)), None)
        if file is None:
            raise MaskError(f"{files[0]} does not exist; add the mask of frame {frame.number}.")
        size = frame.picture.shape[:2]
        if file == files[0] and self.layout.label_mask is not None:
            return read_label_mask(file, size, self.layout)
        return read_class_mask(file, size, self.classes)


class AnnotationElseAutomatic:
    """Annotation where the clip's folder has any mask, else the automatic mode; decided once a clip."""

    def __init__(self, layout: ClipLayout, classes: MaskClasses) -> None:
        self.layout = layout
        self._annotation = AnnotationMasks(layout, classes)
        self._automatic = open_masks("automatic", layout, classes)
        self._chosen: MaskSource | None = None
        self.identity = f"auto:{self._annotation.identity}:{self._automatic.identity}"

    def reset(self) -> None:
        """Forget the clip and the choice."""
        self._chosen = None
        self._annotation.reset()
        self._automatic.reset()

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map of a frame (see MaskSource)."""
        if self._chosen is None:
            annotated = frame.path is not None and has_masks(clip_folder(self.layout, frame.path), self.layout)
            self._chosen = self._annotation if annotated else self._automatic
        return self._chosen(frame)


def chosen_kind(kind: str, clip: Path, layout: ClipLayout) -> str:
    """What `open_masks(kind, …)` uses for a clip, given its folder or video file: "auto" is resolved."""
    if kind != "auto":
        return kind
    return "annotation" if clip.is_dir() and has_masks(clip, layout) else "automatic"


def has_masks(clip: Path, layout: ClipLayout) -> bool:
    """Whether a clip's folder holds at least one annotation mask."""
    return any(matches(clip, pattern) for pattern in layout.mask_patterns)


def read_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Mask image as stored, uint8 [H, W] (grey) or [H, W, 3] (RGB); alpha is dropped, equal channels become grey.

    Args:
        size: (height, width) of the frame.

    Raises:
        MaskError: unreadable, of another size, or not 8-bit.
    """
    try:
        mask = read_image(path, cv2.IMREAD_UNCHANGED)
    except InputError as error:
        raise MaskError(str(error)) from error
    if mask.shape[:2] != size:
        found, expected = f"{mask.shape[1]}x{mask.shape[0]}", f"{size[1]}x{size[0]}"
        raise MaskError(f"{path} is {found} while its frame is {expected}; export the mask at the frame's size.")
    if mask.dtype != np.uint8:
        raise MaskError(f"{path} is {mask.dtype}, not an 8-bit mask; export it with 8 bits a channel.")
    if mask.ndim == 3 and mask.shape[2] < 3:
        mask = mask[..., 0]
    if mask.ndim == 2:
        return mask
    rgb = mask[..., 2::-1]
    grey = np.array_equal(rgb[..., 0], rgb[..., 1]) and np.array_equal(rgb[..., 0], rgb[..., 2])
    return rgb[..., 0] if grey else rgb


def read_class_mask(path: Path, size: tuple[int, int], classes: MaskClasses) -> np.ndarray:
    """Label map of a CholecSeg8k colour mask (RGB or RGBA) or class-value mask (grey, or grey stored as RGB).

    A colour belongs to a class within an L1 distance of `classes.tolerance` (Bini 2026, section 3.1); grey values must
    match exactly. Unlabelled pixels and unknown values are other.

    Raises:
        MaskError: unusable file (see read_mask).
    """
    mask = read_mask(path, size)
    labels = np.zeros(size, np.uint8)
    for label, names in ((TISSUE, classes.tissue), (TOOL, classes.tool)):
        for name in names:
            if mask.ndim == 2:
                labels[mask == CLASSES[name].grey] = label
            else:
                labels[color_distance(mask, CLASSES[name].color) <= classes.tolerance] = label
    return labels


def color_distance(image: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """L1 distance of every pixel [H, W, 3] from a colour, uint16 [H, W]."""
    # absdiff saturates nothing here, and a sum over three uint8 needs more than 8 bits.
    difference = cv2.absdiff(np.ascontiguousarray(image), np.array([*color, 0], np.float64))
    return difference.sum(axis=2, dtype=np.uint16)


def read_label_mask(path: Path, size: tuple[int, int], layout: ClipLayout) -> np.ndarray:
    """Label map of a grey mask with the layout's tool and tissue values, false tool blobs removed by an opening.

    What the opening removes is neither tool nor tissue: it may be the corner of a true tool.

    Raises:
        MaskError: unusable file (see read_mask), or one in colour.
    """
    mask = read_mask(path, size)
    if mask.ndim == 3:
        raise MaskError(f"{path} is a colour image, not a label mask of single values; correct layout.label_mask.")
    tool = np.isin(mask, layout.tool_values)
    labels = np.where(np.isin(mask, layout.tissue_values), np.uint8(TISSUE), np.uint8(OTHER))
    if layout.mask_opening_px > 1:
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (layout.mask_opening_px,) * 2)
        tool = cv2.morphologyEx(tool.astype(np.uint8), cv2.MORPH_OPEN, kernel).astype(bool)
    labels[tool] = TOOL
    return labels
