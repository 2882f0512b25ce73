"""How a clip's files are named and stored: patterns for frames, masks, depth and the camera file.

The default instance is CholecSeg8k; other sequences are described in a YAML file (`configs/layouts/`).
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

CLIP_FILE = "clip.json"
"""Optional file of a clip folder: fps, camera, depth scale and time stamps."""
IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"})


class InputError(ValueError):
    """A user's file or folder can't be used; the message is one sentence that names it and the remedy."""


@dataclass(frozen=True)
class ClipLayout:
    """Names of a clip's files relative to the clip's folder; `{number}` stands for the frame's digits."""

    image: str = "frame_{number}_endo.png"
    """Frame images. A folder in which nothing matches is read as plain images in natural order."""
    color_mask: str | None = "frame_{number}_endo_color_mask.png"
    """Class colours (class_table), keeping the zero padding of the image's number."""
    class_mask: str | None = "frame_{number}_endo_watershed_mask.png"
    """Grey class values (class_table), read where the colour mask is absent."""
    label_mask: str | None = None
    """Grey label image with the values below; it takes precedence over the two above."""
    tool_values: tuple[int, ...] = ()
    """Values of `label_mask` that mean tool."""
    tissue_values: tuple[int, ...] = ()
    """Values of `label_mask` that mean tissue."""
    mask_opening_px: int = 0
    """Diameter of the opening that removes false tool blobs from `label_mask` [px]; 0 leaves the mask as it is."""
    depth: str | None = "frame_{number}_endo_depth.png"
    """Stored depth: 8- or 16-bit PNG (divided by its type's largest value), .npy or .npz."""
    depth_key: str | None = None
    """Name of the array in an .npz file; by default its only one."""
    depth_kind: Literal["depth", "disparity"] = "depth"
    """Whether the file holds depth or disparity; 0 is invalid in both."""
    depth_factor: float = 1.0
    """depth = value · factor, or factor / disparity."""
    fps: float = 25.0
    """Frame rate where the clip does not give one [1/s]."""
    camera: str | None = None
    """Camera file (YAML or JSON) beside the layout file, else relative to the clip's folder."""

    def __post_init__(self) -> None:
        for name in ("tool_values", "tissue_values"):
            object.__setattr__(self, name, tuple(int(value) for value in getattr(self, name)))
        for name in ("image", "color_mask", "class_mask", "label_mask", "depth"):
            pattern = getattr(self, name)
            if pattern is not None and pattern.count("{number}") != 1:
                raise ValueError(f"layout.{name} is '{pattern}'; write {{number}} once where the frame's digits stand.")
        if not (math.isfinite(self.fps) and self.fps > 0):
            raise ValueError(f"layout.fps is {self.fps}; give a positive number of frames a second.")
        if not (math.isfinite(self.depth_factor) and self.depth_factor > 0):
            raise ValueError(f"layout.depth_factor is {self.depth_factor}; give a positive number.")
        if self.depth_kind not in ("depth", "disparity"):
            raise ValueError(f"layout.depth_kind is '{self.depth_kind}'; choose depth or disparity.")
        if self.mask_opening_px < 0:
            raise ValueError(f"layout.mask_opening_px is {self.mask_opening_px}; give 0 or more.")
        if self.label_mask is not None and not (self.tool_values and self.tissue_values):
            raise ValueError("layout.label_mask needs layout.tool_values and layout.tissue_values; give both.")

    @property
    def mask_patterns(self) -> tuple[str, ...]:
        """Patterns of the annotation masks, in order of precedence."""
        return tuple(pattern for pattern in (self.label_mask, self.color_mask, self.class_mask) if pattern is not None)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


_KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "str": ("text", lambda value: isinstance(value, str)),
    "int": ("a whole number", _is_whole),
    "float": ("a number", lambda value: _is_whole(value) or isinstance(value, float)),
    "tuple[int, ...]": (
        "a list of whole numbers",
        lambda value: isinstance(value, list) and all(map(_is_whole, value)),
    ),
}
"""What a field's annotation asks of a file: in words, and as a check."""


def load_layout(path: Path | str) -> ClipLayout:
    """Read a layout from a YAML file; a camera file beside it becomes an absolute path.

    Raises:
        InputError: unreadable file, unknown key or impossible value.
    """
    path = Path(path)
    values = read_mapping(path, "a clip layout")
    known = [field.name for field in dataclasses.fields(ClipLayout)]
    for key in values:
        if key not in known:
            raise InputError(f"{path} has the unknown key '{key}'; known are {', '.join(known)}.")
        wanted, fits = _KINDS.get(ClipLayout.__annotations__[key].removesuffix(" | None"), ("", None))
        if fits is not None and values[key] is not None and not fits(values[key]):
            raise InputError(f"{path} gives {key} {values[key]!r}; give {wanted}.")
    camera = values.get("camera")
    if isinstance(camera, str) and is_file(path.parent / camera):
        values["camera"] = str((path.parent / camera).resolve())
    try:
        return ClipLayout(**values)
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path} is not a clip layout: {error}") from error


def read_mapping(path: Path, meaning: str) -> dict[str, Any]:
    """Read a YAML or JSON file that holds one mapping; `meaning` names it in the error message."""
    try:
        text = path.read_text(encoding="utf-8")
        values = json.loads(text) if path.suffix.lower() == ".json" else yaml.safe_load(text)
    except OSError as error:
        raise InputError(f"{path} can't be read as {meaning} ({error.strerror}); check the path.") from error
    except (UnicodeDecodeError, json.JSONDecodeError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path} is not {meaning} ({reason}); correct the file.") from error
    if not isinstance(values, dict):
        raise InputError(f"{path} is not {meaning}; write a mapping of names to values.")
    return values


def read_clip_file(clip: Path) -> dict[str, Any]:
    """Content of the clip folder's `clip.json`, empty where there is none.

    Keys, all optional: `fps` [1/s], `times` [s] of the frames in order, `camera`, `depth_scale`.

    Raises:
        InputError: unreadable file, an impossible frame rate, or times that do not rise.
    """
    path = clip / CLIP_FILE
    if not is_file(path):
        return {}
    values = read_mapping(path, "a clip description")
    fps, times = values.get("fps"), values.get("times")
    if fps is not None and not (isinstance(fps, (int, float)) and math.isfinite(fps) and fps > 0):
        raise InputError(f"{path} gives fps {fps!r}; give a positive number of frames a second.")
    if times is not None:
        rising = isinstance(times, list) and all(isinstance(t, (int, float)) and math.isfinite(t) for t in times)
        if not rising or any(later <= earlier for earlier, later in itertools.pairwise(times)):
            raise InputError(f"{path} gives times that are not rising numbers; give one time in seconds a frame.")
    return values


def camera_file(layout: ClipLayout, clip: Path) -> Path | None:
    """Path of the camera file that the layout names for a clip, or None where it names none.

    Raises:
        InputError: the layout names a file that is neither beside the layout nor in the clip's folder.
    """
    if layout.camera is None:
        return None
    path = clip / layout.camera
    if not is_file(path):
        raise InputError(f"{path} does not exist; put the camera file there or take `camera` out of the layout.")
    return path


def pattern_expression(pattern: str) -> re.Pattern[str]:
    """Regular expression of a pattern's relative POSIX path, with one group for the digits."""
    before, after = pattern.split("{number}")
    return re.compile(re.escape(before) + r"(\d+)" + re.escape(after))


def matches(clip: Path, pattern: str) -> list[tuple[str, Path]]:
    """Digits and path of every file of a clip folder that matches a pattern, sorted by number."""
    folder = clip / Path(pattern).parent
    expression = pattern_expression(Path(pattern).name)
    try:
        names = [entry.name for entry in folder.iterdir()]
    except FileNotFoundError:
        return []
    found = [(match[1], folder / match[0]) for name in names if (match := expression.fullmatch(name))]
    return sorted(found, key=lambda item: (int(item[0]), item[0]))


def list_folder(folder: Path) -> list[Path]:
    """Entries of a folder in natural order."""
    return sorted(folder.iterdir(), key=natural_key)


def natural_key(path: Path) -> list[tuple[int, int | str]]:
    """Sort key under which frame_9 comes before frame_10."""
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", str(path)) if part]


def frame_files(clip: Path, layout: ClipLayout) -> list[tuple[int, Path]]:
    """Number and path of a clip folder's frame images, in order; empty where it holds none."""
    found = matches(clip, layout.image)
    if found:
        return [(int(digits), path) for digits, path in found]
    companions = [pattern_expression(p) for p in (*layout.mask_patterns, layout.depth) if p is not None]
    images = [
        path
        for path in list_folder(clip)
        if path.suffix.lower() in IMAGE_SUFFIXES
        and not path.name.startswith(".")
        and not path.stem.endswith("_mask")
        and not any(expression.fullmatch(path.name) for expression in companions)
    ]
    digits = [re.findall(r"\d+", path.stem) for path in images]
    numbers = [int(runs[-1]) if runs else -1 for runs in digits]
    steps = np.diff(numbers) if len(numbers) > 1 else np.array([1])
    # Numbers that do not count frames (time stamps, every tenth frame) say nothing about which frames are neighbours.
    if min(numbers, default=-1) < 0 or steps.min() < 1 or np.median(steps) != 1:
        numbers = list(range(len(images)))
    return list(zip(numbers, images, strict=True))


def clip_folder(layout: ClipLayout, frame_path: Path) -> Path:
    """Folder of the clip that a frame image belongs to: above the subfolders of the layout's image pattern."""
    depth = len(Path(layout.image).parts)
    tail = Path(*frame_path.parts[-depth:]).as_posix()
    if pattern_expression(layout.image).fullmatch(tail):
        return frame_path.parents[depth - 1]
    return frame_path.parent


def companion(layout: ClipLayout, frame_path: Path, pattern: str) -> Path:
    """Path of a frame's companion file (mask or depth), with the image's own zero padding; it may not exist."""
    match = pattern_expression(Path(layout.image).name).fullmatch(frame_path.name)
    if match:
        number = match[1]
    else:
        digits = re.findall(r"\d+", frame_path.stem)
        number = digits[-1] if digits else frame_path.stem
    return clip_folder(layout, frame_path) / pattern.replace("{number}", number)


def is_file(path: Path) -> bool:
    """Whether a path is a file; a name that the file system refuses (too long) is not."""
    try:
        return path.is_file()
    except OSError:
        return False
