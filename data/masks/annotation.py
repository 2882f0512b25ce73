"""Masks stored with a clip's frames: classes by colour or by value, and label images of a layout.

Only the annotation's binary partition into tool and tissue is used (Bini 2026, section 3.1).
"""

from os.path import isfile
from pathlib import Path

import cv2
import numpy as np

from palpate.data.labels import OTHER, TISSUE, TOOL, MaskError
from palpate.data.masks.class_table import CLASSES
from palpate.data.masks.request import MaskClasses, MaskRequest
from palpate.data.source.frames import Frame
from palpate.data.source.images import read_image
from palpate.data.source.layout import ClipLayout, InputError, companion, matches


class AnnotationMasks:
    """Masks stored with the frames of a clip, by the layout's patterns and the classes' colours."""

    def __init__(self, asked: MaskRequest) -> None:
        layout, classes, clip = asked.layout, asked.classes, asked.clip
        if not clip.is_dir() or not layout.mask_patterns:
            what = "the layout names" if clip.is_dir() else "a video has"
            raise InputError(f"{what} no annotation masks; use --masks automatic, FOLDER, outlines or a model.")
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
        return read_annotation(file, pattern, size, self.layout, self.classes)


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
    """Return whether a clip's folder holds at least one annotation mask."""
    return any(matches(clip, pattern) for pattern in layout.mask_patterns)


def read_annotation(
    file: Path, pattern: str, size: tuple[int, int], layout: ClipLayout, classes: MaskClasses
) -> np.ndarray:
    """Label map of a mask by a pattern of a layout, of a frame of a size (height, width).

    Raises:
        MaskError: as in `read_label_mask` and `read_class_mask`.
    """
    if pattern == layout.label_mask:
        return read_label_mask(file, size, layout)
    return read_class_mask(file, size, classes)


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
    # Least share of what a mask shows that is a class, where nothing is tool or tissue: other colours are another code.
    if drawn and np.sum([_drawn_as(name, mask, classes.tolerance) for name in CLASSES]) < 0.5 * drawn:
        raise MaskError(f"{path} holds hardly a class of CholecSeg8k; for other masks give a layout with label_mask.")
    return labels


def _drawn_as(name: str, mask: np.ndarray, tolerance: int) -> np.ndarray:
    """Pixels of a mask that show a class, bool [H, W]."""
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
