"""Depth of a clip's frames: from stored files or an ONNX model, and the one normalisation.

The method is Bini 2026, section 3.2.1, but its per-frame choices are fixed for a whole clip: one scale without an
offset, one focal length and one range of relative depth (docs/depth.md).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Annotated, Literal

import cv2
import numpy as np

from palpate.common.settings import Checked, Positive
from palpate.data.depth.model import DepthModel, RawDepth
from palpate.data.depth.photometric import PhotometricDepth
from palpate.data.depth.preset import resolve_model
from palpate.data.depth.sources import DepthSource, ModelDepth, StoredDepth
from palpate.data.depth.stereo import StereoDepth
from palpate.data.labels import OTHER, TISSUE, TOOL
from palpate.data.source.camera import clip_camera
from palpate.data.source.frames import FrameSource
from palpate.data.source.layout import ClipLayout, InputError, matches
from palpate.physics.jit import kernel

BUILT_IN = ("stored", "stereo", "photometric")
"""Sources of depth that need no model."""
MOST_THREADS = 1024
"""Largest number of threads of one program."""
ORDER = (TOOL, TISSUE, OTHER, 255)
"""Labels by their rank if they cover equal areas of a pixel; 255 is outside the picture."""


@dataclass(frozen=True)
class DepthSettings(Checked, group="depth."):
    """Source of depth, and the constants that are fixed for a clip."""

    source: str = "auto"
    """auto (stored where the clip has it, else photometric), stored, stereo, photometric, a preset's name, or an .onnx
    file."""
    model: str | None = None
    """ONNX file of a preset; with any other source it is refused."""
    preset: str | None = None
    """Preset (name or .yaml file) with the conventions of an .onnx path; by default the .yaml file of its name in its
    folder. With any other source it is refused."""
    near: float = 0.03
    """Nearest depth of a relative inverse model [any unit; after normalisation only near/far matters]."""
    far: float = 0.15
    """Farthest depth of a relative inverse model [the unit of near]."""
    field_of_view_deg: Annotated[float, 0.1, 179.9] = 60.0
    """Horizontal field of view where neither a camera file nor the model gives a focal length [degrees]."""
    scale: Positive | None = None
    """Depth that becomes z = 1, in the source's unit; none = estimated once a clip."""
    scale_seconds: Positive = 10.0
    """Duration from the first usable frame within which a clip's scale is estimated and then frozen [s]."""
    scale_samples: Annotated[int, 1, 10_000] = 24
    """Number of frames from which the scale is estimated, evenly spaced."""
    bits: Literal[8, 16] = 16
    """Quantisation of normalised depth (the paper stores 8 bits, 0.4 % of the range)."""
    rounded: Literal["grid", "picture"] = "grid"
    """The map that is rounded to `bits`: the grid's, or the picture's before it is resized (paper); always the grid's
    where depth is from shading."""
    threads: Annotated[int, 0, MOST_THREADS] = 0
    """Threads of the depth model, and of a mask model; 0 leaves it to onnxruntime."""
    device: Literal["auto", "cpu", "openvino", "cuda"] = "cpu"
    """Device of these models (`palpate.common.onnx_devices`): cuda needs onnxruntime-gpu, openvino
    onnxruntime-openvino."""

    def __post_init__(self) -> None:
        super().__post_init__()
        of_file = self.source.lower().endswith(".onnx")
        if self.model is not None and (of_file or self.source in ("auto", *BUILT_IN)):
            problem = f"depth.model is '{self.model}' and belongs to a preset, while depth.source is {self.source};"
            raise ValueError(f"{problem} give that preset as depth.source, or leave depth.model out.")
        if self.preset is not None and not of_file:
            problem = f"depth.preset is '{self.preset}' and says how to read an .onnx file, while depth.source is"
            raise ValueError(f"{problem} {self.source}; give that file as depth.source, or leave depth.preset out.")
        if not 0 < self.near < self.far < math.inf:
            raise ValueError(f"depth.near is {self.near} and depth.far {self.far}; give 0 < near < far.")


def open_depth(settings: DepthSettings, layout: ClipLayout, source: FrameSource) -> DepthSource:
    """Open the depth source of one clip, which holds the clip's frozen constants.

    Raises:
        InputError: no stored depth, or a model or preset that can't be used.
    """
    kind = settings.source
    if kind == "auto":
        stored = source.path.is_dir() and layout.depth is not None and matches(source.path, layout.depth)
        kind = "stored" if stored else "photometric"
    if kind == "stored":
        return StoredDepth(layout, source.path)
    if kind == "stereo":
        return StereoDepth(layout, source)
    if kind == "photometric":
        return PhotometricDepth()
    path, preset = resolve_model(kind, settings.model, settings.preset)
    model = DepthModel(path, preset, threads=settings.threads, device=settings.device)
    camera, focal = clip_camera(source.path, layout), 0.5 / math.tan(math.radians(settings.field_of_view_deg) / 2)
    known = None if camera is None else camera.fx / camera.width
    return ModelDepth(model, near=settings.near, far=settings.far, default_focal=focal, known_focal=known)


def estimate_scale(source: FrameSource, depth: DepthSource, settings: DepthSettings) -> tuple[float, float | None]:
    """Freeze the clip's constants and return its scale and its focal length.

    Reads evenly spaced frames from the first usable one on, for at most `scale_seconds`. A frame's largest depth is
    min(99.9 % quantile, 3 × median) of its valid depth. The clip's scale D_max is the 90 % quantile (lower sample) of
    those. `settings.scale`, else the `depth_scale` of the clip's own file for stored depth, replaces it.

    Returns:
        D_max [unit of the source] and the model's median focal length for the source's width [px], or None.

    Raises:
        InputError: no frame has usable depth.
    """
    known = settings.scale if settings.scale is not None else depth.known_scale
    if known is not None and not depth.depends_on_clip:
        return known, None
    problems: list[str] = []
    samples = list(_samples(source, depth, settings, problems))
    if samples:
        depth.freeze(samples)
    maps = [depth.convert(sample) for sample in samples]
    valid = [map_[map_ > 0] for map_ in maps if map_.any()]
    # Single outliers have no effect; depth beyond three medians is background or a mismatch.
    extents = [float(min(np.quantile(each, 0.999), 3.0 * np.median(each))) for each in valid]
    if not extents:
        reason = problems[0] if problems else "choose another source with depth.source."
        raise InputError(f"{source.path} has no frame with usable depth; {reason}")
    scale = float(np.quantile(extents, 0.9, method="lower")) if known is None else known
    return scale, None if depth.focal is None else depth.focal * source.size[0]


def _samples(source: FrameSource, depth: DepthSource, how: DepthSettings, problems: list[str]) -> Iterator[RawDepth]:
    """Thumbnails of the network's output for the frames that decide the scale.

    Unusable frames are skipped in favour of the next, and the reasons are added to `problems`.
    """
    start, due, interval, taken = 0.0, 0.0, 0.0, 0
    for frame in source:
        elapsed = frame.time_s - start
        if taken and elapsed >= how.scale_seconds:
            return
        # Half a millisecond absorbs the rounding of time stamps.
        if frame.image is None or (taken and elapsed < due - 5e-4):
            continue
        try:
            sample = depth.observe(frame)
        except InputError as error:
            problems.append(str(error))
            continue
        if not taken:
            start = frame.time_s
            rest = source.length / source.fps - start if source.length else math.inf
            interval = max(0.0, min(how.scale_seconds, rest)) / how.scale_samples
        taken += 1
        due += interval
        yield sample.thumbnail()
        if taken == how.scale_samples:
            return


def normalise(depth: np.ndarray, scale: float, bits: int = 16) -> np.ndarray:
    """Normalised depth z = min(D/D_max, 1), on the levels of an unsigned integer of `bits` bits.

    There is no offset: it would move near geometry into the camera's centre.

    Args:
        depth: D, any shape [unit of the source], 0 (or anything not positive and finite) = invalid.
        scale: D_max of the clip [the same unit].
        bits: 8 or 16.

    Returns:
        z float32 of the same shape in [0, 1]; 0 = invalid, and a valid pixel never becomes 0.

    Raises:
        ValueError: the scale is not positive and finite.
    """
    if not 0 < scale < math.inf:
        raise ValueError(f"The depth scale is {scale}; give a positive number.")
    levels = 2**bits - 1
    valid = np.isfinite(depth) & (depth > 0)
    z = np.where(valid, depth, 0).astype(np.float64) / scale
    steps = np.clip(np.rint(z * levels), 1, levels)
    return np.where(valid, steps / levels, 0).astype(np.float32)


def resize_depth(depth: np.ndarray, labels: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Depth and labels on the grid, never blended across a label edge or with invalid pixels.

    A grid pixel takes the label with the largest area in it, by ORDER when equal, and the mean depth of that label's
    valid pixels. That is a normalised convolution: area average when shrinking, bilinear when enlarging. The pixel is
    invalid if less than half of that label's area has valid depth, and outside the picture.

    Args:
        depth: shape [H, W] float32, 0 = invalid.
        labels: shape [H, W] uint8 (0 other, 1 tissue, 2 tool, 255 outside).
        size: (height, width) of the grid.

    Returns:
        depth [h, w] float32 and labels [h, w] uint8.

    Raises:
        ValueError: the two maps differ in size.
    """
    if depth.ndim != 2 or depth.shape != labels.shape:
        raise ValueError(f"Depth {depth.shape} and labels {labels.shape} must be two maps of one size.")
    sums = label_areas(depth, labels, size)
    winner = sums[0].argmax(axis=0)
    share, weight, total = np.take_along_axis(sums, winner[None, None], axis=1)[:, 0]
    found, result = np.asarray(ORDER, np.uint8)[winner], np.zeros(size, np.float32)
    # 255 is outside the camera's picture, after the removal of lens distortion.
    chosen = (found != 255) & (weight > 0) & (weight >= 0.5 * share)
    result[chosen] = total[chosen] / weight[chosen]
    return result, found


def label_areas(depth: np.ndarray, labels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Share of every label of ORDER in a grid's pixels, share with a depth above 0, and depth summed over that.

    Args:
        depth: shape [H, W] float32.
        labels: shape [H, W] uint8.
        size: (height, width) of the grid.

    Returns:
        Shape [3, 4, h, w] float32, to the bit what OpenCV gives of every label's maps: area average
        when shrinking, bilinear when enlarging.
    """
    sides = list(zip(labels.shape, size, strict=True))
    enlarged = any(side < own for side, own in sides)
    if enlarged or all(side % own == 0 for side, own in sides):
        members = np.array([labels == label for label in ORDER], np.float32)
        how, known = cv2.INTER_LINEAR if enlarged else cv2.INTER_AREA, members * (depth > 0)
        maps = [*members, *known, *known * depth]
        return np.array([cv2.resize(each, size[::-1], interpolation=how) for each in maps]).reshape(3, -1, *size)
    sums, number = np.zeros((3, len(ORDER) + 1, *size), np.float32), np.full(256, len(ORDER))
    number[list(ORDER)] = range(len(ORDER))
    _add_areas(np.ascontiguousarray(depth, np.float32), labels, number, *(_covered(*each) for each in sides), sums)
    return sums[:, :-1]


@lru_cache(maxsize=8)
def _covered(side: int, own: int) -> tuple[np.ndarray, ...]:
    """Parts of `side` pixels along an axis that those of a grid of `own` cover, as OpenCV has it.

    Returns:
        Begin of each one's part in the others, shape [own + 1]; pixels covered; share of each in the mean, float32.
    """
    scale = 1 / (own / side)
    begin = np.arange(own)[:, None] * scale
    first = np.ceil(begin)
    pixels = first - 1 + np.arange(math.ceil(scale) + 2)
    parts = np.where(pixels < first, first - begin, (begin + scale - pixels).clip(max=1.0))
    used, shares = parts > 1e-3, parts / np.minimum(scale, side - begin)
    return np.append(0, used.sum(axis=1).cumsum()), pixels[used].astype(int), shares[used].astype(np.float32)


@partial(kernel, fastmath=False)  # sums are rounded as OpenCV's
def _add_areas(depth, labels, number, down, across, sums):
    begins, at, shares = across
    for row in range(len(down[0]) - 1):
        for line in range(down[0][row], down[0][row + 1]):
            z, shown, weight = depth[down[1][line]], labels[down[1][line]], down[2][line]
            for column in range(len(begins) - 1):
                begin, end = begins[column], begins[column + 1]
                left, label = end - begin, number[shown[at[begin]]]
                while left > 0:  # most often all are of one label
                    area = known = total = np.float32(0)
                    for part in range(begin, end):
                        if number[shown[at[part]]] == label:
                            left -= 1
                            area += shares[part]
                            if z[at[part]] > 0:
                                known += shares[part]
                                total += z[at[part]] * shares[part]
                    for which, found in enumerate((area, known, total)):
                        sums[which, label, row, column] += weight * found
                    label = (label + 1) % sums.shape[1]
