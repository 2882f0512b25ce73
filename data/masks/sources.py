"""Tool and tissue masks of a frame: annotation, an ONNX model, outlines, or the automatic mode for raw video.

Label maps are uint8 [H, W]: 0 other, 1 tissue, 2 tool (Bini 2026, section 3.1: only the binary tool/tissue partition
of the annotation is used).
"""

from dataclasses import dataclass
from os.path import isfile
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from palpate.data.labels import OTHER, TISSUE, TOOL, MaskError
from palpate.data.masks.class_table import CLASSES
from palpate.data.source.frames import Frame
from palpate.data.source.images import read_image
from palpate.data.source.layout import ClipLayout, InputError, companion, matches

KINDS = ("annotation", "automatic", "auto")
"""Kinds of masks that need no file; auto is annotation where the clip has masks, else automatic."""
LEAST_OF_CLASS = 0.5
"""Least share of what a mask shows that is a class, where nothing is tool or tissue: other colours are another code."""
FILES = (".onnx", ".yaml", ".yml", ".json")
"""Endings of files that give masks: segmentation models, and outlines."""


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
            names = getattr(self, field)
            unknown = [f"'{name}', which is no class" for name in names if name not in CLASSES]
            if unknown or not names:
                wrong = unknown[0] if unknown else "no class"
                raise ValueError(f"classes.{field} names {wrong}; choose from {', '.join(CLASSES)}.")
        both = sorted(set(self.tool) & set(self.tissue))
        if both:
            raise ValueError(f"classes.tool and classes.tissue both name '{both[0]}'; a class is one or the other.")
        if not 0 <= self.tolerance <= 42:
            raise ValueError(f"classes.tolerance is {self.tolerance}; give 0 to 42 (some colours differ by only 85).")


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


def open_masks(
    kind: str,
    layout: ClipLayout,
    classes: MaskClasses,
    clip: Path,
    *,
    threads: int = 0,
    device: str = "cpu",
    every: int = 1,
) -> MaskSource:
    """Open the mask source of one clip.

    Args:
        kind: one of KINDS, or the path of an ONNX segmentation model (see data.masks.onnx for its settings) or of
            outlines (see data.masks.outlined).
        layout: how the clip's files are named.
        classes: which annotated classes are tool and tissue.
        clip: the clip's folder or video file.
        threads, device: of a network, as of `data.picture_network.PictureNetwork`.
        every: of automatic masks, as of `data.settings.PrepareSettings`.

    Raises:
        InputError: an unknown kind, a file that can't be used, or a clip without annotation masks.
    """
    file = mask_source_file(kind)
    if file is not None:
        return open_mask_file(file, threads=threads, device=device)
    if chosen_kind(kind, clip, layout) == "annotation":
        return AnnotationMasks(layout, classes, clip)
    from palpate.data.masks.automatic import AutomaticMasks

    return AutomaticMasks(every=every, threads=threads, device=device)


def open_mask_file(file: Path, *, threads: int = 0, device: str = "cpu") -> MaskSource:
    """Open an ONNX segmentation model, or outlines; threads and device as of `open_masks`.

    Raises:
        InputError: it can't be used.
    """
    # The imports stand here because only the dependencies of the chosen source are needed.
    if file.suffix.lower() == ".onnx":
        from palpate.data.masks.automatic import AutomaticMasks
        from palpate.data.masks.onnx import OnnxMasks
        from palpate.data.picture_network import PictureNetwork

        own = PictureNetwork(file, threads=threads, device=device, raw=True).outlines_instruments
        return (AutomaticMasks if own else OnnxMasks)(file, threads=threads, device=device)
    from palpate.data.masks.outlined import OutlinedMasks

    return OutlinedMasks(file)


def mask_source_file(kind: str) -> Path | None:
    """The file that a kind of masks names; None for a kind that needs none.

    Raises:
        InputError: an unknown kind, or a file that does not exist.
    """
    if kind in KINDS:
        return None
    if not kind.lower().endswith(FILES):
        raise InputError(
            f"masks '{kind}' is unknown; choose {', '.join(KINDS)}, or a file: an .onnx model or outlines in .yaml."
        )
    if not isfile(Path(kind)):
        raise InputError(f"{kind} does not exist; check the path of the masks' file.")
    return Path(kind)


def chosen_kind(kind: str, clip: Path, layout: ClipLayout) -> str:
    """The kind of masks that `open_masks(kind, …)` uses for a clip, "auto" being resolved."""
    if kind != "auto":
        return kind
    return "annotation" if clip.is_dir() and has_masks(clip, layout) else "automatic"


class AnnotationMasks:
    """Masks stored with the frames of a clip, by the layout's patterns and the classes' colours."""

    def __init__(self, layout: ClipLayout, classes: MaskClasses, clip: Path) -> None:
        if not clip.is_dir() or not layout.mask_patterns:
            what = "the layout names" if clip.is_dir() else "a video has"
            raise InputError(f"{what} no annotation masks; use --masks automatic, outlines or a segmentation model.")
        if not has_masks(clip, layout):
            expected = layout.mask_patterns[0]
            raise InputError(
                f"{clip} holds no annotation masks ({expected}); use --masks automatic, outlines or a model."
            )
        self.layout, self.classes = layout, classes
        self.identity = f"annotation:{classes}:{layout.mask_patterns}"

    def reset(self) -> None:
        """Nothing is remembered from frame to frame."""

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map of a frame of the clip's folder (see MaskSource)."""
        (file, pattern), size = mask_file(self.layout, frame), frame.picture.shape[:2]
        if pattern == self.layout.label_mask:
            return read_label_mask(file, size, self.layout)
        return read_class_mask(file, size, self.classes)


def mask_file(layout: ClipLayout, frame: Frame) -> tuple[Path, str]:
    """The annotation mask of a folder's frame, and its pattern: the first of the layout's for which a file exists.

    Raises:
        MaskError: no pattern has a file.
    """
    if frame.path is None:
        raise MaskError(f"Frame {frame.number} has no image file, so it has no annotation mask.")
    files = [(companion(layout, frame.path, pattern), pattern) for pattern in layout.mask_patterns]
    for file, pattern in files:
        if isfile(file):
            return file, pattern
    raise MaskError(f"{files[0][0]} does not exist; add the mask of frame {frame.number}.")


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
        MaskError: unusable file (see read_mask), or one of which most shows no class of the data set at all.
    """
    mask = read_mask(path, size)
    labels = np.zeros(size, np.uint8)
    for label, names in ((TISSUE, classes.tissue), (TOOL, classes.tool)):
        for name in names:
            labels[_drawn_as(name, mask, classes.tolerance)] = label
    drawn = 0 if labels.any() else mask.reshape(*size, -1).any(axis=2).sum()
    if drawn and np.sum([_drawn_as(name, mask, classes.tolerance) for name in CLASSES]) < LEAST_OF_CLASS * drawn:
        raise MaskError(f"{path} holds hardly a class of CholecSeg8k; for other masks give a layout with label_mask.")
    return labels


def _drawn_as(name: str, mask: np.ndarray, tolerance: int) -> np.ndarray:
    """Where a mask shows a class, bool [H, W]."""
    if mask.ndim == 2:
        return mask == CLASSES[name].grey
    apart = cv2.absdiff(mask, np.array([*CLASSES[name].color, 0.0]))
    return cv2.transform(apart, np.ones((1, 3))) <= tolerance  # a sum above 255 counts as 255


def read_label_mask(path: Path, size: tuple[int, int], layout: ClipLayout) -> np.ndarray:
    """Label map of a grey mask with the layout's tool and tissue values, false tool blobs removed by an opening.

    Pixels that the opening removes become neither tool nor tissue: they may be the corner of a true tool.

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
