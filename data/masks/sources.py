"""Tool and tissue masks of a frame: annotation, an ONNX model, outlines, or the automatic mode for raw video.

Label maps are uint8 [H, W]: 0 other, 1 tissue, 2 tool. Only the annotation's binary tool/tissue partition is used (Bini
2026, section 3.1).
"""

from dataclasses import dataclass
from os.path import isfile
from pathlib import Path
from typing import Annotated, Any, Protocol

import cv2
import numpy as np

from palpate.common.registry import Registry
from palpate.common.settings import Checked
from palpate.data.labels import OTHER, TISSUE, TOOL, MaskError
from palpate.data.masks.class_table import CLASSES
from palpate.data.source.frames import Frame
from palpate.data.source.images import read_image
from palpate.data.source.layout import ClipLayout, InputError, companion, matches

FILES = {".onnx": "onnx", ".yaml": "outlines", ".yml": "outlines", ".json": "outlines"}
"""Sources of masks from a file, by its ending: segmentation models, and outlines."""
SOURCES = Registry(
    "mask source",
    "palpate.masks",
    {
        "annotation": "palpate.data.masks.sources:AnnotationMasks",
        "automatic": "palpate.data.masks.sources:open_automatic",
        "onnx": "palpate.data.masks.sources:open_network",
        "outlines": "palpate.data.masks.sources:open_outlines",
    },
)
"""Classes or functions that open the masks of one clip, and take a `MaskRequest`."""


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
    """File that was chosen as the source, if any."""
    threads: int = 0
    """CPU threads of a network, as in `data.picture_network.PictureNetwork`."""
    device: str = "cpu"
    """Device of a network, as in `data.picture_network.PictureNetwork`."""
    every: int = 1
    """Number of frames for which one is masked, as in `data.settings.PrepareSettings`."""


def open_masks(kind: str, layout: ClipLayout, classes: MaskClasses, clip: Path, **where: Any) -> MaskSource:
    """Open the mask source of one clip.

    Args:
        kind: auto, a name of SOURCES, or the path of an ONNX segmentation model (`data.masks.onnx`) or of outlines
            (`data.masks.outlined`).
        layout, classes, clip, where: fields of `MaskRequest`.

    Raises:
        InputError: an unknown kind, a file that can't be used, or a clip without annotation masks.
    """
    file = mask_source_file(kind)
    name = chosen_kind(kind, clip, layout) if file is None else FILES[file.suffix.lower()]
    return SOURCES[name](MaskRequest(clip, layout, classes, file or Path(), **where))


def open_automatic(asked: MaskRequest) -> MaskSource:
    """Open the network that ships."""
    from palpate.data.masks.automatic import AutomaticMasks

    return AutomaticMasks(every=asked.every, threads=asked.threads, device=asked.device)


def open_network(asked: MaskRequest) -> MaskSource:
    """Open an ONNX segmentation model, or another network in the place of the one that ships."""
    from palpate.data.masks.automatic import AutomaticMasks
    from palpate.data.masks.onnx import OnnxMasks
    from palpate.data.picture_network import PictureNetwork

    where: dict[str, Any] = {"threads": asked.threads, "device": asked.device}
    own = PictureNetwork(asked.file, **where, raw=True).outlines_instruments
    return (AutomaticMasks if own else OnnxMasks)(asked.file, **where)


def open_outlines(asked: MaskRequest) -> MaskSource:
    """Open outlines of instruments, which are followed."""
    from palpate.data.masks.outlined import OutlinedMasks

    return OutlinedMasks(asked.file)


def check_masks(kind: str, **where: Any) -> None:
    """Open the file that a kind of masks names, if any; arguments and errors as in `open_masks`."""
    if mask_source_file(kind) is not None:
        open_masks(kind, ClipLayout(), MaskClasses(), Path(), **where)


def mask_names() -> list[str]:
    """Return the kinds of masks that need no file."""
    return ["auto", *(name for name in SOURCES.entries if name not in FILES.values())]


def mask_source_file(kind: str) -> Path | None:
    """Return the file that a kind of masks names; None for a kind that needs none.

    Raises:
        InputError: an unknown kind, or a file that does not exist.
    """
    if kind in mask_names():
        return None
    if Path(kind).suffix.lower() not in FILES:
        known = ", ".join(mask_names())
        raise InputError(f"masks '{kind}' is unknown; choose {known}, or a file: an .onnx model or outlines in .yaml.")
    if not isfile(Path(kind)):
        raise InputError(f"{kind} does not exist; check the path of the masks' file.")
    return Path(kind)


def chosen_kind(kind: str, clip: Path, layout: ClipLayout) -> str:
    """Kind of masks that `open_masks(kind, …)` uses for a clip: auto is annotation if there is any, else automatic."""
    if kind != "auto":
        return kind
    return "annotation" if clip.is_dir() and has_masks(clip, layout) else "automatic"


class AnnotationMasks:
    """Masks stored with the frames of a clip, by the layout's patterns and the classes' colours."""

    def __init__(self, asked: MaskRequest) -> None:
        layout, classes, clip = asked.layout, asked.classes, asked.clip
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
    """Return whether a clip's folder holds at least one annotation mask."""
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
