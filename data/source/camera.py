"""The camera: intrinsics, camera files, back-projection (Bini 2026, equation 3) and the removal of lens distortion."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from palpate.common.settings import Checked, NotNegative, Positive
from palpate.data.source.bags import camera_entries, is_bag
from palpate.data.source.camera_formats import LARGEST_BASELINE, own_entries
from palpate.data.source.layout import ClipLayout, InputError, from_mapping, read_clip_file, read_mapping

MOST_SIDE = 4096
"""Longest side of a grid, and of a network's input [px]."""


@dataclass(frozen=True)
class Camera(Checked):
    """Pinhole camera with OpenCV distortion; pixel centres lie at integer coordinates."""

    fx: float
    """Focal length along u [px]."""
    fy: float
    """Focal length along v [px]."""
    cx: float
    """Principal point, column [px]."""
    cy: float
    """Principal point, row [px]."""
    width: int
    """Picture width [px]; 0, with the height, where the file doesn't say: that of the pictures as they come."""
    height: int
    """Picture height [px]."""
    distortion: tuple[float, ...] = ()
    """First coefficients of OpenCV's k1, k2, p1, p2, k3–k6, s1–s4, τ_x, τ_y (none: no distortion); they don't depend on
    the resolution."""

    def __post_init__(self) -> None:
        super().__post_init__()
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not all(math.isfinite(value) for value in numbers):
            raise ValueError("The camera has a number that is not finite; check its intrinsics and distortion.")
        if self.fx <= 0 or self.fy <= 0:
            raise ValueError(f"The camera's focal length is ({self.fx}, {self.fy}); give positive numbers of pixels.")
        if min(self.width, self.height) < 1 and self.stated:
            raise ValueError(f"The camera's picture is {self.width}x{self.height}; give its size in pixels.")
        ratios = self.width / self.fx, self.height / self.fy, self.cx / (self.width or 1), self.cy / (self.height or 1)
        # Beyond this ratio the focal length is in millimetres.
        if max(map(abs, ratios)) > 50 and self.stated:
            problem = f"The camera's focal length ({self.fx:g}, {self.fy:g}) or centre ({self.cx:g}, {self.cy:g}) is"
            raise ValueError(f"{problem} none of a picture of {self.width:g}x{self.height:g}; give all in its pixels.")
        if len(self.distortion) not in (0, 4, 5, 8, 12, 14):  # what OpenCV takes
            problem = f"The camera has {len(self.distortion)} distortion coefficients"
            raise ValueError(f"{problem}; give one of 0, 4, 5, 8, 12, 14.")

    @property
    def stated(self) -> bool:
        """True if the picture's size is known."""
        return (self.width, self.height) != (0, 0)

    @property
    def matrix(self) -> np.ndarray:
        """Intrinsics as OpenCV takes them, shape [3, 3]."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], float)

    @classmethod
    def from_field_of_view(cls, degrees: float, width: int, height: int) -> "Camera":
        """Camera with square pixels and a centred axis from its horizontal field of view [degrees]."""
        return cls.from_focal(width / 2 / math.tan(math.radians(degrees) / 2), width, height)

    @classmethod
    def from_focal(cls, focal: float, width: int, height: int) -> "Camera":
        """Camera with square pixels and a centred axis from its focal length [px]."""
        return cls(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)

    def scaled(self, width: int, height: int) -> "Camera":
        """Return the camera for the picture resized to width x height.

        Raises:
            ValueError: the camera has no size of its own, and a centre far from that of such a picture.
        """
        if not self.stated and not (width / 4 < self.cx < width * 3 / 4 and height / 4 < self.cy < height * 3 / 4):
            problem = f"has its centre at ({self.cx:g}, {self.cy:g}), far from that of pictures of {width}x{height}"
            raise ValueError(f"The camera file tells no size, and {problem}; give the size that it was calibrated at.")
        across, down = (width / self.width, height / self.height) if self.stated else (1.0, 1.0)
        cx, cy = (self.cx + 0.5) * across - 0.5, (self.cy + 0.5) * down - 0.5
        return Camera(self.fx * across, self.fy * down, cx, cy, width, height, self.distortion)


@dataclass(frozen=True)
class Rig(Camera):
    """Content of a camera file: a camera, the right one beside it if there is one, and lengths.

    Raises:
        ValueError: numbers that can't be, or are in millimetres.
    """

    baseline: Positive | None = None
    """Distance of the cameras of a rectified pair, or of one that only its lenses keep from being one [m]."""
    baseline_sd: NotNegative = 0.0
    """Standard deviation of the baseline, or of `translation`'s length [m]."""
    rotation: tuple[float, ...] = (1, 0, 0, 0, 1, 0, 0, 0, 1)
    """Rotation of a calibrated pair R, row by row, of X_right = R·X_left + T, as OpenCV's stereoCalibrate gives it."""
    translation: tuple[float, float, float] | None = None
    """Translation T of that pair, in place of a baseline [m]."""
    right: "Rig | None" = None
    """The right camera, with the keys of the left one; none = the same."""
    metres_per_depth: Positive | None = None
    """Length of a unit of the clip's stored depth [m]; none = not known."""
    metres_per_depth_sd: NotNegative = 0.0
    """Standard deviation of `metres_per_depth` [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.rotation) != 9 or not np.allclose(self.turned @ self.turned.T, np.eye(3), atol=1e-3):
            raise ValueError("rotation is no rotation; give its nine numbers row by row.")
        if self.baseline is not None and self.translation is not None:
            raise ValueError("baseline and translation both tell where the right camera is; give one.")
        across, down, along = self.offset or (-1e-6, 0.0, 0.0)
        if (apart := math.hypot(across, down, along)) > LARGEST_BASELINE:
            raise ValueError(f"its cameras are {apart:g} m apart; give metres, not millimetres.")
        if not -across > abs(down):
            raise ValueError("translation leads to no negative x, from right to left; swap left and right.")

    @property
    def offset(self) -> tuple[float, float, float] | None:
        """Translation T [m]; None without a pair."""
        return self.translation if self.baseline is None else (-self.baseline, 0.0, 0.0)

    @property
    def turned(self) -> np.ndarray:
        """Rotation R, shape [3, 3]."""
        return np.array(self.rotation, float).reshape(3, 3)


def load_camera(path: str | Path, *, stated: bool = False) -> Rig:
    """Camera from a YAML or JSON file, at its top level or under `camera`, or of a program of `camera_formats`.

    Args:
        stated: True = the file must tell the size of its pictures.

    Raises:
        InputError: the file is missing, not YAML or JSON, or not a camera.
    """
    entries = read_mapping(Path(path), "a camera file")
    if isinstance(entries.get("camera"), dict):
        entries = entries["camera"]
    own = own_entries(entries, str(path))
    camera = _camera(own, str(path))
    if not camera.stated and (stated or own is entries):
        raise InputError(f"{path} tells no size of its pictures; give fx, fy, cx, cy, width and height.")
    return camera


def _camera(entries: Any, where: str) -> Rig:
    """A camera from a file's entries; `where` begins the error message.

    Calibration tools write whole numbers with a point, numbers as text ("5e2" is text to YAML), and null.
    """
    if isinstance(entries, dict):
        given = ((name, value) for name, value in entries.items() if value is not None)
        entries = {name: [*map(_number, each)] if isinstance(each, list) else _number(each) for name, each in given}
        if "right" in entries:
            entries["right"] = _camera(entries["right"], f"{where}, right,")
    return from_mapping(Rig, entries, where)


def _number(value: Any) -> Any:
    """A value of a camera file, as a number where it is one."""
    try:
        number = value if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        return value
    return int(number) if isinstance(number, float) and number.is_integer() else number


def clip_camera(clip: Path, layout: ClipLayout) -> Rig | None:
    """The camera that a clip folder's `clip.json` or a bag gives, else its layout, or None where neither does.

    Raises:
        InputError: a camera is named and can't be used.
    """
    if is_bag(clip):
        where, entries = "camera_info", camera_entries(clip, layout.topic)
    else:
        where, entries = "clip.json", read_clip_file(clip).get("camera") if clip.is_dir() else None
    if entries is not None:
        return _camera(entries, f"{clip} ({where}) has a camera that")
    return None if layout.camera is None else load_camera(clip / layout.camera)


def back_project(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Points of a depth map: x=(u-c_x)z/f_x, y=(v-c_y)z/f_y (Bini 2026, equation 3).

    Args:
        depth: z, shape [H, W] [scene units], 0 = invalid. The map must be free of distortion.
        camera: intrinsics for exactly this size.

    Returns:
        Points [H, W, 3] float32 [scene units]; invalid pixels give the origin.

    Raises:
        ValueError: the depth map's size is not the camera's.
    """
    if depth.shape != (camera.height, camera.width):
        raise ValueError(f"The depth map is {depth.shape}, the camera expects ({camera.height}, {camera.width}).")
    columns = (np.arange(camera.width) - camera.cx) / camera.fx
    rows = (np.arange(camera.height) - camera.cy) / camera.fy
    return np.stack((depth * columns, depth * rows[:, None], depth), axis=-1).astype(np.float32)


class Undistortion:
    """Removes a camera's lens distortion from pictures, label maps and depth maps of one size.

    Args:
        camera: camera of those pictures.
        turn: rotation into the axes of the camera without distortion, shape [3, 3]; None = as it stands.
        seen: intrinsics or projection of the new pictures, shape [3, 3] or [3, 4]; None = the camera's.
    """

    def __init__(self, camera: Camera, turn: np.ndarray | None = None, seen: np.ndarray | None = None) -> None:
        lens, target = (camera.matrix, np.array(camera.distortion, float)), camera.matrix if seen is None else seen
        self._maps = cv2.initUndistortRectifyMap(*lens, turn, target, (camera.width, camera.height), cv2.CV_32FC1)

    def image(self, image: np.ndarray) -> np.ndarray:
        """RGB picture [H, W, 3], interpolated; black outside the camera's picture."""
        return cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)

    def labels(self, labels: np.ndarray) -> np.ndarray:
        """Label map [H, W], nearest pixel; 255 outside the camera's picture."""
        return cv2.remap(labels, *self._maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=255)

    def depth(self, depth: np.ndarray) -> np.ndarray:
        """Depth map [H, W], nearest pixel, so that it never blends across an edge; 0 outside the camera's picture."""
        return cv2.remap(depth, *self._maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
