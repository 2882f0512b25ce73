"""Choice of the source of masks: annotation, a folder, a network, outlines, or the automatic mode for raw video."""

from os.path import isfile
from pathlib import Path
from typing import Any

from palpate.common.registry import Registry
from palpate.data.masks.annotation import has_masks
from palpate.data.masks.request import MaskClasses, MaskRequest, MaskSource
from palpate.data.source.layout import ClipLayout, InputError

FILES = {".onnx": "onnx", ".yaml": "outlines", ".yml": "outlines", ".json": "outlines", "/": "folder"}
"""Sources of masks from a file, by its ending: segmentation models, and outlines; and from a folder."""
SOURCES = Registry(
    "mask source",
    "palpate.masks",
    {
        "annotation": "palpate.data.masks.annotation:AnnotationMasks",
        "automatic": "palpate.data.masks.sources:open_automatic",
        "folder": "palpate.data.masks.folder:FolderMasks",
        "onnx": "palpate.data.masks.sources:open_network",
        "outlines": "palpate.data.masks.sources:open_outlines",
    },
)
"""Classes or functions that open the masks of one clip, and take a `MaskRequest`."""


def open_masks(kind: str, layout: ClipLayout, classes: MaskClasses, clip: Path, **where: Any) -> MaskSource:
    """Open the mask source of one clip.

    Args:
        kind: auto, a name of SOURCES, or the path of an ONNX segmentation model (`data.masks.onnx`), of outlines
            (`data.masks.outlined`) or of a folder of masks (`data.masks.folder`).
        layout, classes, clip, where: fields of `MaskRequest`.

    Raises:
        InputError: an unknown kind, a file that can't be used, or a clip without annotation masks.
    """
    file = mask_source_file(kind)
    name = chosen_kind(kind, clip, layout) if file is None else FILES[_ending(file)]
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
    """Return the file or folder that a kind of masks names; None for a kind that needs none.

    Raises:
        InputError: an unknown kind, or a file that does not exist.
    """
    if kind in mask_names():
        return None
    ending = _ending(Path(kind))
    if ending not in FILES:
        known = ", ".join(mask_names())
        files = "an .onnx model, outlines in .yaml, or a folder of masks"
        raise InputError(f"masks '{kind}' is unknown; choose {known}, or {files}.")
    if ending != "/" and not isfile(Path(kind)):
        raise InputError(f"{kind} does not exist; check the path of the masks' file.")
    return Path(kind)


def _ending(file: Path) -> str:
    return "/" if file.is_dir() else file.suffix.lower()


def chosen_kind(kind: str, clip: Path, layout: ClipLayout) -> str:
    """Kind of masks that `open_masks(kind, …)` uses for a clip: auto is annotation if there is any, else automatic."""
    if kind != "auto":
        return kind
    return "annotation" if clip.is_dir() and has_masks(clip, layout) else "automatic"
