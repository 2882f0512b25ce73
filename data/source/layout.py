"""Names and storage of a clip's files: patterns for frames, masks, depth and the camera file.

The default instance is CholecSeg8k; other sequences are described in a YAML file (`configs/layouts/`).
"""

import inspect
import itertools
import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, is_dataclass, replace
from os.path import isdir, isfile
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_type_hints

import numpy as np
import yaml

from palpate.common.files import read_file
from palpate.common.settings import Checked, Positive, described, fits, shown

Settings = TypeVar("Settings")

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"})
"""Endings of the names of image files."""
FRAME_RATES = (1e-6, 1e4)
"""Lowest and highest frame rate of a clip [1/s]."""


class InputError(ValueError):
    """A user's file or folder can't be used; the message is one sentence that names it and the remedy."""


@dataclass(frozen=True)
class ClipLayout(Checked, group="layout."):
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
    # Largest `mask_opening_px` [px].
    mask_opening_px: Annotated[int, 0, 1001] = 0
    """Diameter of the opening that removes false tool blobs from `label_mask` [px]; 0 leaves the mask as it is."""
    depth: str | None = "frame_{number}_endo_depth.png"
    """Stored depth: 8- or 16-bit PNG (divided by its type's largest value), .npy or .npz."""
    depth_key: str | None = None
    """Name of the array in an .npz file; by default its only one."""
    depth_kind: Literal["depth", "disparity"] = "depth"
    """Content of the file: depth or disparity; 0 is invalid in both."""
    depth_factor: Positive = 1.0
    """Factor of the stored values: depth = value · factor, or factor / disparity."""
    fps: Annotated[float, *FRAME_RATES] = 25.0
    """Frame rate where the clip does not give one [1/s]."""
    right: str | None = None
    """Right pictures of a stereo pair: files beside the frames (`img_right/{number}.jpg`) or a video's second file
    beside it (`{name}_right.mp4`). Pictures that hold both, the left one first: side-by-side or top-bottom."""
    camera: str | None = None
    """Camera file (YAML or JSON) in the layout file's folder, else relative to the clip's folder."""
    topic: str | None = None
    """Topic of a bag's pictures; by default its only one."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("image", "color_mask", "class_mask", "label_mask", "depth", "right", "camera"):
            pattern = getattr(self, name)
            if pattern is not None and "\0" in pattern:
                raise ValueError(f"layout.{name} holds a NUL, which no file's name does; leave it out.")
            if name not in ("camera", "right") and pattern is not None and pattern.count("{number}") != 1:
                raise ValueError(f"layout.{name} is '{pattern}'; write {{number}} once where the frame's digits stand.")
        if self.label_mask is not None and not (self.tool_values and self.tissue_values):
            raise ValueError("layout.label_mask needs layout.tool_values and layout.tissue_values; give both.")

    @property
    def halved(self) -> bool:
        """True if every picture holds both of a stereo pair."""
        return self.right in ("side-by-side", "top-bottom")

    @property
    def mask_patterns(self) -> tuple[str, ...]:
        """Patterns of the annotation masks, in order of precedence."""
        return tuple(pattern for pattern in (self.label_mask, self.color_mask, self.class_mask) if pattern is not None)


def load_layout(path: Path | str) -> ClipLayout:
    """Read a layout from a YAML file; the path of a camera file in the same folder becomes absolute.

    Raises:
        InputError: unreadable file, unknown key or impossible value.
    """
    path = Path(path)
    layout = from_mapping(ClipLayout, read_mapping(path, "a clip layout"), str(path))
    if layout.camera is not None and isfile(path.parent / layout.camera):
        return replace(layout, camera=str((path.parent / layout.camera).resolve()))
    return layout


def from_mapping(kind: type[Settings], values: Any, where: str) -> Settings:
    """A dataclass of settings from the mapping of a file; lists become tuples, mappings in it the dataclasses it holds.

    Raises:
        InputError: no mapping, an unknown or a missing key, a value of another kind than the field's annotation, or an
            impossible one; `where`, the beginning of the message, names the file.
    """
    if not isinstance(values, dict):
        raise InputError(f"{where} is not a mapping of names to values; write one.")
    kinds = get_type_hints(kind)
    nested = {name: _nested(kinds[name], values[name], f"{where}, {name},") for name in kinds if name in values}
    values = values | nested
    for name, value in values.items():
        if name not in kinds:
            raise InputError(f"{where} has the unknown key {shown(name)}; known are {', '.join(kinds)}.")
        if not fits(value, kinds[name]):
            raise InputError(f"{where} gives {name} {shown(value)}; give {described(kinds[name])}.")
    for name, each in inspect.signature(kind).parameters.items():
        if name not in values and each.default is each.empty:
            raise InputError(f"{where} lacks '{name}'; give {described(kinds[name])}.")
    try:
        return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()})
    except ValueError as error:
        raise InputError(f"{where} can't be used: {error}") from error


def _nested(kind: Any, value: Any, where: str) -> Any:
    """A field's value; mappings become the dataclasses that its annotation is, or holds in a tuple or by name."""
    if is_dataclass(kind):
        return value if isinstance(value, kind) else from_mapping(kind, value, where)
    held = next(filter(is_dataclass, get_args(kind)), None)
    if held is not None and isinstance(value, dict):
        return {name: _nested(held, each, f"{where} {shown(name)}") for name, each in value.items()}
    if held is not None and isinstance(value, list):
        return [_nested(held, each, f"{where} {number}") for number, each in enumerate(value, start=1)]
    return value


def read_mapping(path: Path, meaning: str) -> dict[str, Any]:
    """Read a YAML or JSON file that holds one mapping; `meaning` names it in the error message.

    Raises:
        InputError: a file that can't be read, is too large, is not text or not such a mapping.
    """
    is_json = path.suffix.lower() == ".json"
    try:
        # JSON holds the time stamps of hours; YAML is read in seconds.
        text = read_file(path, 2**24 if is_json else 2**17).decode("utf-8-sig")
        # OpenCV begins its files with %YAML:.
        values = json.loads(text) if is_json else yaml.load(text.replace("%YAML:", "%YAML ", 1), _Loader)
    except OSError as error:
        raise InputError(f"{path} can't be read as {meaning} ({error.strerror}); check the path.") from error
    except RecursionError as error:
        raise InputError(f"{path} is not {meaning} (it nests too deeply); correct the file.") from error
    except Exception as error:  # errors of YAML, and whatever its constructors raise on a value
        reason = " ".join(str(error).split())
        raise InputError(f"{path} is not {meaning} ({reason}); correct the file.") from error
    if not isinstance(values, dict):
        raise InputError(f"{path} is not {meaning}; write a mapping of names to values.")
    return values


class _Loader(yaml.SafeLoader):
    """A safe loader that refuses names given twice, and references, which may unfold without end."""

    def compose_mapping_node(self, anchor: dict[Any, yaml.Node]) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        if len(set(names)) < len(names):
            raise ValueError(f"it gives {max(names, key=names.count)[:40]} twice")
        return node

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise ValueError("it refers to an anchor; write out what that stands for")
        return super().compose_node(parent, index)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, True))


def read_clip_file(clip: Path) -> dict[str, Any]:
    """Content of the clip folder's `clip.json`, empty where there is none.

    Keys, all optional: `fps` [1/s], `times` [s] of the frames in order, `camera`, `depth_scale`.

    Raises:
        InputError: unreadable file, an unknown key, an impossible frame rate or scale, or times that do not rise.
    """
    path, known = clip / "clip.json", ("fps", "times", "camera", "depth_scale")
    if not os.path.lexists(path):
        return {}
    values = {name: value for name, value in read_mapping(path, "a clip description").items() if value is not None}
    if unknown := sorted(values.keys() - {*known}):
        raise InputError(f"{path} has the unknown key {shown(unknown[0])}; known are {', '.join(known)}.")
    for name, least, most in (("fps", *FRAME_RATES), ("depth_scale", 0, 1e9)):
        value = values.get(name, 1.0)
        if not (fits(value, float) and value > 0 and least <= value <= most):
            raise InputError(f"{path} gives {name} {shown(value)}; give a positive number up to {most:g}.")
    times = values.get("times", [])
    if not (fits(times, tuple[float, ...]) and all(later > earlier for earlier, later in itertools.pairwise(times))):
        raise InputError(f"{path} gives times that are not rising numbers; give one time in seconds a frame.")
    return values


def pattern_expression(pattern: str) -> re.Pattern[str]:
    """Regular expression of a pattern's relative POSIX path, with one group for the digits."""
    before, _, after = pattern.partition("{number}")
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
    beside = (*layout.mask_patterns, layout.depth, layout.right)
    companions = [pattern_expression(p) for p in beside if p is not None and "{number}" in p]
    shown = [path for path in list_folder(clip) if path.suffix.lower() in IMAGE_SUFFIXES and path.name[0] != "."]
    named = [path for path in shown if not path.stem.endswith("_mask")]
    images = [path for path in named if not any(expression.fullmatch(path.name) for expression in companions)]
    if not images and (inner := _pictures_among(clip)):
        return frame_files(inner, layout)
    digits = [re.findall(r"\d+", path.stem) for path in images]
    numbers = [int(runs[-1]) if runs else -1 for runs in digits]
    steps = np.diff(numbers) if len(numbers) > 1 else np.array([1])
    # Numbers that do not count frames (time stamps, every tenth frame) don't show which frames are neighbours.
    if min(numbers, default=-1) < 0 or steps.min() < 1 or np.median(steps) != 1:
        numbers = list(range(len(images)))
    return list(zip(numbers, images, strict=True))


def folders_beside(folder: Path) -> list[Path]:
    """Subfolders with masks or depth by their names, which are no clips of their own."""
    named = re.compile(r"(^|[_-])(masks?|depths?|disp|disparity|labels?)([_-]|$)", re.IGNORECASE)
    return [entry for entry in list_folder(folder) if named.search(entry.name) and isdir(entry)]


def _pictures_among(folder: Path) -> Path | None:
    """The one subfolder of pictures, where others hold their masks or depth."""
    beside = folders_beside(folder)
    others = [entry for entry in list_folder(folder) if isdir(entry) and entry not in beside] if beside else []
    held = [each for each in others if any(file.suffix.lower() in IMAGE_SUFFIXES for file in each.iterdir())]
    return held[0] if len(held) == 1 else None


def stereo_pair(files: Sequence[Path]) -> tuple[Path, Path] | None:
    """A left and a right picture of the same name but for that word, where most files have such a counterpart."""
    named: dict[tuple[str, str], Path] = {}
    word = re.compile(r"(?<![^\W\d_])(left|right|[lr])(?![^\W\d_])", re.IGNORECASE)
    for file in files:
        if side := word.search(file.stem):
            named[side[1][0].lower(), word.sub("*", file.stem, count=1)] = file
    pairs = [(file, named["r", rest]) for (side, rest), file in named.items() if side == "l" and ("r", rest) in named]
    return pairs[0] if 4 * len(pairs) > len(files) else None


def clip_folder(layout: ClipLayout, frame_path: Path) -> Path:
    """Folder of the clip that a frame image belongs to: above the subfolders of the layout's image pattern."""
    depth = len(Path(layout.image).parts)
    tail = Path(*frame_path.parts[-depth:]).as_posix()
    return frame_path.parents[depth - 1 if pattern_expression(layout.image).fullmatch(tail) else 0]


def right_beside(clip: Path, layout: ClipLayout) -> Path | None:
    """Folder or video file of the right pictures of a stereo pair; None where they lie in the clip, or nothing says."""
    if layout.right is None or layout.halved:
        return None
    if not clip.is_dir():
        return clip.parent / layout.right.replace("{name}", clip.stem)
    folder = (clip / layout.right).resolve().parent
    return None if folder.is_relative_to(clip.resolve()) else folder


def companion(layout: ClipLayout, frame_path: Path, pattern: str) -> Path:
    """Path of a frame's companion file (mask or depth), with the image's own zero padding; it may not exist."""
    match = pattern_expression(Path(layout.image).name).fullmatch(frame_path.name)
    digits = [match[1]] if match else re.findall(r"\d+", frame_path.stem) or [frame_path.stem]
    return clip_folder(layout, frame_path) / pattern.replace("{number}", digits[-1])
