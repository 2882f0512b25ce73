"""A sequence beside a robot: clouds or depth with a tool's poses, as `sequence.yaml` names them, in the poses' frame.

All lengths are in metres there, whatever the files' unit and frame.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from palpate.common.settings import Checked, Positive
from palpate.data.source.camera import Camera, Undistortion, back_project, load_camera
from palpate.data.source.clouds import read_cloud
from palpate.data.source.images import printable, read_image
from palpate.data.source.layout import InputError, from_mapping, matches, read_mapping
from palpate.data.source.table import read_series

Row = tuple[float, float, float, float]
Place = tuple[float, float, float]
UNITS = {"m": 1.0, "mm": 1e-3}


@dataclass(frozen=True)
class SequenceFile(Checked):
    """Fields of the file; names of files are relative to it, and `{number}` stands for a frame's digits.

    Raises:
        ValueError: fields that don't belong together, or numbers that can't be.
    """

    poses: str
    """CSV file of the tool's poses in the robot's frame: time_s with x, y, z, qx, qy, qz, qw."""
    clouds: str | None = None
    """Clouds of tissue alone: PLY or NPZ, as clouds/{number}.ply."""
    depth: str | None = None
    """Depth pictures of 16 bits in place of clouds, as depth/{number}.png; 0 outside tissue. Needs `camera`."""
    camera: str | None = None
    """Camera file of the depth pictures."""
    depth_factor: Positive = 1e-3
    """Length of a unit of the depth pictures [m]."""
    times: str | None = None
    """CSV file with a column time_s, a row for every frame, on the clock of the poses; or give `fps`."""
    fps: Positive | None = None
    """Frames a second; the first one is then at 0 s."""
    unit: Literal["m", "mm"] = "m"
    """Length unit of all lengths in the files and here, but for `depth_factor`."""
    hand_eye: tuple[Row, Row, Row, Row] = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    """Pose of the camera in the frame that `camera_on` names."""
    camera_on: Literal["base", "tool"] = "base"
    """Carrier of the camera: the robot's base or the tool."""
    tip: Place = (0.0, 0.0, 0.0)
    """Point of the tool that touches tissue, in the tool's frame."""
    grip_radius: Positive | None = None
    """Radius around the tip within which tissue moves with it; none = 6 mm."""
    gripped_s: tuple[float, float] | None = None
    """Begin and end of the time in which the tool holds tissue [s]; none = throughout."""
    pins: tuple[dict[str, Place], ...] = ()
    """Boxes in the robot's frame, each with `low` and `high`: tissue in them stands still. None = its far edge does."""
    points: str | None = None
    """NPZ file with `points`, followed on the tissue, ids × frames × 3, where clouds are; not seen = NaN."""

    def __post_init__(self) -> None:
        if (self.clouds is None) == (self.depth is None) or (self.depth is None) != (self.camera is None):
            raise ValueError("give clouds, or depth with camera.")
        if (self.times is None) == (self.fps is None):
            raise ValueError("give times or fps.")
        if any({*pin} != {"low", "high"} for pin in self.pins):
            raise ValueError("each of pins is to have low and high.")
        super().__post_init__()
        turn = np.array(self.hand_eye)[:3, :3]
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) or np.linalg.det(turn) < 0:
            raise ValueError("hand_eye is no rotation and shift; give the rows of a rigid 4 × 4 matrix.")


@dataclass(frozen=True, eq=False)
class Sequence:
    """T frames with a tool; all in the robot's frame and metres."""

    path: Path
    given: SequenceFile
    files: list[Path]
    """Files of the clouds or depth pictures."""
    numbers: list[int]
    """Numbers of the frames."""
    times: np.ndarray
    """Times of the frames, shape [T] [s]."""
    tool: "Tool"
    pins: np.ndarray
    """Lower and upper corners of what stands still, shape [B, 2, 3] [m]."""
    grip_radius: float
    """Radius around the tip within which tissue moves with it [m]."""
    gripped: range
    """Frames in which the tool holds tissue."""
    camera: Camera | None
    """Camera of depth pictures."""

    def cloud(self, frame: int) -> np.ndarray:
        """Points of the tissue in a frame, shape [m, 3] [m]; m = 0 where the camera saw none.

        Raises:
            InputError: its file can't be used.
        """
        file, camera = self.files[frame], self.camera
        if camera is None:
            points = read_cloud(file) * UNITS[self.given.unit]
            return moved(points[np.isfinite(points).all(axis=1)], self.eye(frame))
        depth = read_image(file, cv2.IMREAD_UNCHANGED).astype(np.float32) * np.float32(self.given.depth_factor)
        if depth.shape != (camera.height, camera.width):
            why = f"holds no depth of {camera.width}x{camera.height}, the size in {self.given.camera}"
            raise InputError(f"{printable(file)} {why}; give depth pictures of one channel, and their camera.")
        depth = Undistortion(camera).depth(depth) if any(camera.distortion) else depth
        return moved(back_project(depth, camera)[depth > 0].astype(np.float64), self.eye(frame))

    @cached_property
    def first(self) -> tuple[int, np.ndarray]:
        """The first frame that shows tissue while the tool holds it, and its cloud, shape [m, 3] [m].

        Raises:
            InputError: none does but, maybe, the last, or a file can't be used.
        """
        for frame in self.gripped[:-1]:
            if len(cloud := self.cloud(frame)):
                return frame, cloud
        raise InputError(f"{printable(self.path)} shows no tissue while the tool holds it; give clouds that do.")

    @property
    def held(self) -> range:
        """Frames in which the tool holds tissue, from `first` on; raises as that does."""
        return range(self.first[0], self.gripped.stop)

    @cached_property
    def points(self) -> np.ndarray | None:
        """Tracks of points on the tissue, shape [T, P, 3] [m]; not seen = NaN.

        Raises:
            InputError: the file can't be used.
        """
        if self.given.points is None:
            return None
        found = read_cloud(self.path.parent / self.given.points, (len(self.times), 3)) * UNITS[self.given.unit]
        return np.stack([moved(found[:, frame], self.eye(frame)) for frame in range(len(self.times))])

    def eye(self, frame: int) -> np.ndarray:
        """Pose of the camera in a frame, shape [4, 4]."""
        eye = np.array(self.given.hand_eye, float)
        eye[:3, 3] *= UNITS[self.given.unit]
        return self.tool.at(self.times[frame]) @ eye if self.given.camera_on == "tool" else eye


@dataclass(frozen=True, eq=False)
class Tool:
    """Poses of a tool over time; K rows."""

    path: Path
    times: np.ndarray
    """Times of the poses, rising, shape [K] [s]."""
    turns: Rotation
    """Orientations in the robot's frame, K of them."""
    places: np.ndarray
    """Places of the tool's origin, shape [K, 3] [m]."""
    tip: np.ndarray
    """Point that touches tissue, in the tool's frame, shape [3] [m]."""

    def at(self, times: np.ndarray | float) -> np.ndarray:
        """Poses at times [...] [s], interpolated between the rows, beyond them those of the ends, shape [..., 4, 4]."""
        inside = np.clip(times, self.times[0], self.times[-1])
        found = np.zeros((*np.shape(times), 4, 4))
        found[..., :3, :3] = Slerp(self.times, self.turns)(inside).as_matrix()
        rows = [np.interp(inside, self.times, values) for values in self.places.T]
        found[..., :3, 3], found[..., 3, 3] = np.stack(rows, axis=-1), 1.0
        return found

    def tips(self, times: np.ndarray) -> np.ndarray:
        """Places of the tip at times [T] [s], shape [T, 3] [m]."""
        return self.at(times) @ np.append(self.tip, 1.0) @ np.eye(4, 3)


def moved(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Points [..., 3] of a frame with that pose [4, 4], in the frame in which it is given."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def is_sequence(path: Path) -> bool:
    """Return whether a path is a file such as sequence.yaml."""
    return path.suffix.lower() in (".yaml", ".yml") and path.is_file()


def open_sequence(path: Path) -> Sequence:
    """Read a sequence's file; `sequence_checks` tests its consistency.

    Raises:
        InputError: the file, or one that it names, can't be read or used.
    """
    where, folder = printable(path), path.parent
    given = from_mapping(SequenceFile, read_mapping(path, "a sequence"), where)
    scale, found = UNITS[given.unit], matches(folder, given.clouds or given.depth or "")
    numbers, files = [int(digits) for digits, _ in found], [file for _, file in found]
    if given.times is not None:
        times = read_series(folder / given.times, ("time_s",), "table of times", 2)[:, 0]
    else:
        times = (np.array(numbers) - min(numbers, default=0)) / (given.fps or 1.0)
    if len(files) < 2 or len(times) != len(files):
        why = f"names {len(files)} frames ({given.clouds or given.depth}) and {len(times)} times"
        raise InputError(f"{where} {why}; give 2 at least, their {{number}} in the files' names, and a time for each.")
    low, high = given.gripped_s or (times[0], times[-1])
    rounded = 1e-3  # to which times in tables are [s]
    held = np.flatnonzero((low - rounded <= times) & (times <= high + rounded))
    if len(held) < 2:
        raise InputError(f"{where}: {len(held)} frames lie from {low:g} to {high:g} s (gripped_s); give 2 at least.")
    pins = scale * np.sort(np.array([[*pin.values()] for pin in given.pins], float).reshape(-1, 2, 3), axis=1)
    camera = None if given.camera is None else load_camera(folder / given.camera, stated=True)
    radius = 6e-3 if given.grip_radius is None else scale * given.grip_radius
    table = read_series(folder / given.poses, ("time_s", *"xyz", "qx", "qy", "qz", "qw"), "table of poses", 2)
    if not table[:, 4:].any(axis=1).all():
        raise InputError(f"{printable(folder / given.poses)} holds a quaternion of length 0; correct that row.")
    places, tip = scale * table[:, 1:4], scale * np.array(given.tip, float)
    tool = Tool(folder / given.poses, table[:, 0], Rotation.from_quat(table[:, 4:]), places, tip)
    if times[0] < table[0, 0] - rounded or times[-1] > table[-1, 0] + rounded:
        why = f"from {table[0, 0]:g} to {table[-1, 0]:g} s, the frames from {times[0]:g} to {times[-1]:g} s"
        raise InputError(f"{printable(tool.path)} reaches {why}; put both on one clock.")
    return Sequence(path, given, files, numbers, times, tool, pins, radius, range(held[0], held[-1] + 1), camera)
