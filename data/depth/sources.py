"""Depth maps of one clip's frames from stored files or from an ONNX model, and the constants frozen for the clip."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from palpate.common.files import digest_of
from palpate.data.depth.model import DepthModel, RawDepth
from palpate.data.source.camera import clip_camera
from palpate.data.source.frames import Frame
from palpate.data.source.images import read_image
from palpate.data.source.layout import ClipLayout, InputError, companion, matches, read_clip_file

LARGEST_MAP_RATIO = 16
"""Largest ratio of a stored map's pixels to its picture's; larger maps are not even unpacked."""
NEAREST, FARTHEST = 1e-3, 5.0
"""Smallest and largest distance of tissue; others were measured in another unit than metres [m]."""


class DepthSource(ABC):
    """Depth of one clip's frames. `freeze` fixes the clip's constants; without it, the first frame does."""

    identity: str
    """Digest of everything except the clip's own files and settings that the depth depends on, for cache keys."""
    metres: tuple[float, float, str] | None = None
    """Length of the unit [m], the standard deviation of its logarithm, and their source; None if unknown."""
    warnings: Sequence[str] = ()
    """Warnings about the clip's depth, a sentence each."""
    known_scale: float | None = None
    """Depth that the clip's own file declares as z = 1; None where it declares none."""
    from_picture: bool = False
    """True if depth is guessed from the picture alone, so that it may change with the light or the view."""
    from_shading: bool = False
    """True if depth is brightness read as distance, whose shape `shading.organ_shape` extracts."""
    depends_on_clip: bool = False
    """True if `freeze` has constants to fix."""
    focal: float | None = None
    """Focal length that the model estimated, fixed for the clip, as a multiple of the picture's width."""

    def __call__(self, frame: Frame) -> np.ndarray:
        """Depth of a frame with an image, shape [H, W] float32; positive, in one unit for the whole clip; 0 = invalid.

        Raises:
            InputError: this frame's depth is unusable.
        """
        return self.convert(self.observe(frame))

    @abstractmethod
    def observe(self, frame: Frame) -> RawDepth:
        """The frame's depth before the clip's constants are applied.

        Raises:
            InputError: no usable part (see `check_map`).
        """

    def freeze(self, samples: Sequence[RawDepth]) -> None:  # noqa: B027  most sources have no constants
        """Fix the clip's constants, if there are any, from samples of its frames (at least one; thumbnails suffice)."""

    def convert(self, raw: RawDepth) -> np.ndarray:
        """Depth from what `observe` gave, or from a thumbnail of it: the same, where the clip has no constants."""
        return raw.values


class StoredDepth(DepthSource):
    """Depth files of a clip folder: 8- or 16-bit PNG, NPY or NPZ, depth or disparity, as the layout states."""

    def __init__(self, layout: ClipLayout, clip: Path) -> None:
        if not clip.is_dir():
            raise InputError(f"{clip} is no folder, so it has no stored depth; choose a depth model with depth.source.")
        if layout.depth is None or not matches(clip, layout.depth):
            pattern = layout.depth or "layout.depth is empty"
            raise InputError(f"{clip} has no stored depth ({pattern}); choose a depth model with depth.source.")
        self._layout, self._pattern, camera = layout, layout.depth, clip_camera(clip, layout)
        if camera is not None and camera.metres_per_depth is not None:
            log_sd = camera.metres_per_depth_sd / camera.metres_per_depth
            self.metres = (camera.metres_per_depth, log_sd, "the camera file")
        fields = (layout.depth, layout.depth_key, layout.depth_kind, layout.depth_factor)
        self.known_scale = read_clip_file(clip).get("depth_scale")
        self.identity = f"stored:{digest_of([*fields, self.known_scale])[:16]}"

    def observe(self, frame: Frame) -> RawDepth:
        """Depth of the frame's file, at the frame's size (nearest pixel where the sizes differ)."""
        if frame.path is None:
            raise InputError(f"Frame {frame.number} has no image file, so it has no stored depth.")
        path = companion(self._layout, frame.path, self._pattern)
        height, width = frame.picture.shape[:2]
        values, largest = _read_map(path, self._layout.depth_key, LARGEST_MAP_RATIO * height * width)
        check_map(values, str(path), signed=False)
        factor = self._layout.depth_factor
        if self._layout.depth_kind == "disparity":
            depth = np.divide(factor, values, out=np.zeros_like(values), where=values > 0)
        else:
            depth = values * (factor / largest)
        if depth.shape != (height, width):
            if abs(depth.shape[1] * height - depth.shape[0] * width) > max(height, width, *depth.shape):
                problem = f"{path} is {depth.shape[1]}x{depth.shape[0]} while its frame is {width}x{height};"
                raise InputError(f"{problem} store depth in the frame's aspect.")
            depth = cv2.resize(depth, (width, height), interpolation=cv2.INTER_NEAREST)
        return RawDepth(positive(depth))


class ModelDepth(DepthSource):
    """Depth by an ONNX model; its preset states the meaning of the output."""

    from_picture = True

    def __init__(
        self, model: DepthModel, *, near: float, far: float, default_focal: float, known_focal: float | None = None
    ) -> None:
        """Args:
        model: the opened network.
        near, far: depths at the ends of the frozen range of relative inverse depth.
        default_focal: focal length where neither camera nor model gives one, as a multiple of the picture's width.
        known_focal: focal length of the clip's camera file, as a multiple of the picture's width.
        """
        self._model, self._preset, self.network = model, model.preset, model.network
        self._near, self._far = near, far
        self._default_focal, self._known_focal = default_focal, known_focal
        self._range = (0.0, 1.0)
        self._frozen = False
        self.metres = (1.0, 0.0, f"the depth network {self._preset.name}") if self._preset.metric else None
        self.depends_on_clip = bool(self._preset.focal_output) or self._preset.kind == "relative_inverse"
        constants = [near, far, default_focal, known_focal]
        self.identity = f"{model.identity}:{digest_of(constants)[:16]}"

    def observe(self, frame: Frame) -> RawDepth:
        """The network's output, checked."""
        raw = self._model.raw(frame.picture)
        named = f"The output of {self._model.path} for frame {frame.number}"
        check_map(raw.values, named, signed=self._preset.kind == "relative_inverse")
        return raw

    def freeze(self, samples: Sequence[RawDepth]) -> None:
        """Fix the focal length and the range of relative inverse depth as medians over the samples."""
        focals = [sample.focal for sample in samples if sample.focal is not None]
        self.focal = float(np.median(focals)) if focals else None
        if self._preset.kind == "relative_inverse":
            ends = [np.quantile(s.values[np.isfinite(s.values)], (0.001, 0.999)) for s in samples]
            low, high = np.median(ends, axis=0)
            if not high > low:
                raise InputError(f"{self._model.path} gives the same depth nearly everywhere; check its preset.")
            self._range = (float(low), float(high))
        self._frozen = True

    def convert(self, raw: RawDepth) -> np.ndarray:
        if not self._frozen:
            self.freeze([raw])
        values, preset = raw.values, self._preset
        if preset.kind == "relative_inverse":
            return from_relative_inverse(values, self._range, self._near, self._far)
        if preset.kind in ("inverse", "canonical_inverse"):
            values = positive(values)
            values = positive(np.divide(1, values, out=np.zeros_like(values), where=values > 0))
        if preset.kind == "canonical_inverse" or preset.canonical_focal_px is not None:
            # DepthPro: D = f_px/(w·C); Bini 2026, section 3.2.1, prints its reciprocal in C.
            values = values * np.float32(self._known_focal or self.focal or self._default_focal)
        return positive(values)


def positive(values: np.ndarray) -> np.ndarray:
    """The map as float32 with 0 wherever it is not positive and finite."""
    return np.where(np.isfinite(values) & (values > 0), values, 0).astype(np.float32)


def from_relative_inverse(values: np.ndarray, ends: tuple[float, float], near: float, far: float) -> np.ndarray:
    """D = 1/(a·r + b) with D = far at r = ends[0] and D = near at r = ends[1], fixed for the clip.

    Below the range D stays at far, where the formula would diverge; above it D continues to fall below near.
    """
    low, high = ends
    share = np.maximum((values.astype(np.float64) - low) / (high - low), 0)
    return positive(1 / (1 / far + share * (1 / near - 1 / far)))


def check_map(values: np.ndarray, named: str, *, signed: bool) -> None:
    """Refuse a map without usable content; single invalid pixels are accepted.

    Args:
        values: shape [H, W].
        named: subject of the message.
        signed: True = 0 and negative values are valid.

    Raises:
        InputError: nothing finite, zero or constant everywhere, or under 1 % valid.
    """
    remedy = "the frame is left out; check the depth source or choose another"
    finite = np.isfinite(values)
    if not finite.any():
        raise InputError(f"{named} is NaN or infinite everywhere; {remedy}.")
    if not values[finite].any():
        raise InputError(f"{named} is zero everywhere; {remedy}.")
    valid = values[finite] if signed else values[finite & (values > 0)]
    if len(valid) < 0.01 * values.size:
        raise InputError(f"{named} is valid on {len(valid) / values.size:.1%} of its pixels; {remedy}.")
    if float(valid.max()) - float(valid.min()) <= 1e-6 * float(np.abs(valid).max()):
        raise InputError(f"{named} is the same everywhere ({float(valid[0]):g}); {remedy}.")


def _read_map(path: Path, key: str | None, most: int) -> tuple[np.ndarray, float]:
    """A stored map of at most `most` pixels as float32 [H, W], and the value by which its integers are divided."""
    if path.suffix.lower() in (".npy", ".npz"):
        array = _read_numpy(path, key, most)
        largest = 1.0
    else:
        array = read_image(path, cv2.IMREAD_UNCHANGED, most)
        largest = float(np.iinfo(array.dtype).max) if np.issubdtype(array.dtype, np.integer) else 1.0
        if array.ndim == 3:
            if not (array[..., :3] == array[..., :1]).all():
                raise InputError(f"{path} is a colour picture, not depth; store one channel of 8 or 16 bits.")
            array = array[..., 0]
    if array.ndim == 3 and 1 in array.shape:
        array = array.squeeze()
    if array.ndim != 2 or array.dtype.kind not in "iuf":
        raise InputError(f"{path} holds {array.dtype} of shape {array.shape}; store one depth map of shape [H, W].")
    return array.astype(np.float32), largest


def _read_numpy(path: Path, key: str | None, most: int) -> np.ndarray:
    """The array of an .npy file, or the one under `key` (by default the only one) of an .npz file."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path} is no file; put the depth itself there.")
        # Mapped, an .npy file is not read before its size is known.
        loaded = np.load(path, allow_pickle=False, mmap_mode="r")
        if isinstance(loaded, np.ndarray):
            name, size = None, loaded.nbytes
        else:
            name = key if key is not None else loaded.files[0] if len(loaded.files) == 1 else None
            if name not in loaded.files:
                raise InputError(f"{path} holds {', '.join(loaded.files)}; name one of them as layout.depth_key.")
            size = loaded.zip.getinfo(f"{name}.npy").file_size
        if size > 8 * most + 2**16:  # 8 bytes a pixel, and a header
            problem = f"{path} unpacks to {size / 2**20:.0f} MB, more than {LARGEST_MAP_RATIO} times"
            raise InputError(f"{problem} its picture's pixels; store depth at the picture's size.")
        return loaded if name is None else loaded[name]
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; store the frame's depth there or choose a depth model.") from error
    except InputError:
        raise
    except Exception as error:  # a damaged file raises zip, pickle, value or OS errors, depending on the place
        raise InputError(f"{path} can't be read as a numpy file; write it again with numpy.save.") from error
