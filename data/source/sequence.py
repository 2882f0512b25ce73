"""A sequence beside a robot: clouds or depth with a tool's poses, as `sequence.yaml` names them, in the poses' frame.

Everything is in metres there, whatever unit and frame the files have.
"""

import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from palpate.common.files import read_file
from palpate.data.source.camera import Camera, Undistortion, back_project, load_camera
from palpate.data.source.clouds import read_cloud
from palpate.data.source.images import printable, read_image
from palpate.data.source.layout import InputError, from_mapping, matches, read_mapping
from palpate.data.source.table import MOST_BYTES, read_series, reason

Row = tuple[float, float, float, float]
Place = tuple[float, float, float]
UNITS = {"m": 1.0, "mm": 1e-3}
QUATERNION = ("x", "y", "z", "qx", "qy", "qz", "qw")
MATRIX = tuple(f"m{row}{column}" for row in range(4) for column in range(4))
"""Columns of a table of poses besides time_s: a place and a turn, or a matrix row by row."""
WRENCH = ("time_s", "Fx", "Fy", "Fz")
ROUNDED = 1e-3
"""Tables of poses and forces reach farther by this, since their times are rounded [s]."""
GRIPPED = 6e-3
"""What a gripper holds around its tip, where nobody says [m]."""
STILL = 5e-4
"""A tip that has moved by less since the first row of forces is at rest, where they are the sensor's bias [m]."""


@dataclass(frozen=True)
class Box:
    """A box along the axes of the poses' frame."""

    low: Place
    high: Place


@dataclass(frozen=True)
class SequenceFile:
    """Fields of the file; names of files are relative to it, and `{number}` stands for a frame's digits.

    Raises:
        ValueError: fields that don't belong together, or numbers that can't be.
    """

    poses: str
    """CSV file of the tool's poses in the robot's frame: time_s with x, y, z, qx, qy, qz, qw, or m00 … m33."""
    clouds: str | None = None
    """Clouds of tissue alone: PLY, PCD or NPZ, as clouds/{number}.ply."""
    depth: str | None = None
    """Or depth pictures of 16 bits, as depth/{number}.png; what isn't tissue has depth 0. Needs `camera`."""
    camera: str | None = None
    """Camera file of the depth pictures."""
    depth_factor: float = 1e-3
    """Length of a unit of the depth pictures [m]."""
    times: str | None = None
    """CSV file with a column time_s, a row for every frame, on the clock of the poses; or give `fps`."""
    fps: float | None = None
    """Frames a second; the first one is then at 0 s."""
    unit: Literal["m", "mm"] = "m"
    """Of all lengths in the files and here, but for `depth_factor`."""
    hand_eye: tuple[Row, Row, Row, Row] = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    """Pose of the camera in the frame that `camera_on` names."""
    camera_on: Literal["base", "tool"] = "base"
    """Whether the camera stands in the robot's frame or is carried by the tool."""
    tip: Place = (0.0, 0.0, 0.0)
    """Where the tool touches tissue, in its own frame."""
    grip_radius: float | None = None
    """Tissue around the tip that moves with it; none = GRIPPED."""
    gripped_s: tuple[float, float] | None = None
    """From when to when the tool holds tissue [s]; none = throughout."""
    pins: tuple[dict[str, Any], ...] = ()
    """Boxes in the robot's frame, each with `low` and `high`: tissue in them stands still. None = its far edge does."""
    points: str | None = None
    """NPZ file with `points`, followed on the tissue, ids × frames × 3, where clouds are; not seen = NaN."""
    forces: str | None = None
    """CSV file with time_s, Fx, Fy, Fz [N]: what the tissue does to the tool, in the tool's frame."""

    def __post_init__(self) -> None:
        if (self.clouds is None) == (self.depth is None) or (self.depth is None) != (self.camera is None):
            raise ValueError("give clouds, or depth with camera.")
        if (self.times is None) == (self.fps is None):
            raise ValueError("give times or fps.")
        if any(value is not None and not value > 0 for value in (self.fps, self.depth_factor, self.grip_radius)):
            raise ValueError("fps, depth_factor and grip_radius are to be positive.")
        if self.gripped_s is not None and not self.gripped_s[0] < self.gripped_s[1]:
            raise ValueError(f"gripped_s is {list(self.gripped_s)}; give a beginning before an end.")
        turn = np.array(self.hand_eye)[:3, :3]
        if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3 or np.linalg.det(turn) < 0:
            raise ValueError("hand_eye is no rotation and shift; give the rows of a rigid 4 × 4 matrix.")


@dataclass(frozen=True, eq=False)
class Sequence:
    """T frames with a tool; all in the robot's frame and metres."""

    path: Path
    given: SequenceFile
    files: list[Path]
    """Of the clouds or depth pictures."""
    numbers: list[int]
    """Of the frames."""
    times: np.ndarray
    """Of the frames, shape [T] [s]."""
    tool: "Tool"
    pins: np.ndarray
    """Lower and upper corners of what stands still, shape [B, 2, 3] [m]."""
    grip_radius: float
    """Tissue so near to the tip moves with it [m]."""
    held: range
    """Frames in which the tool holds tissue."""
    camera: Camera | None
    """Of depth pictures."""

    def cloud(self, frame: int) -> np.ndarray:
        """Points of the tissue in a frame, shape [m, 3] [m].

        Raises:
            InputError: its file can't be used.
        """
        file, camera = self.files[frame], self.camera
        if camera is None:
            return moved(read_cloud(file) * UNITS[self.given.unit], self.eye(frame))
        depth = read_image(file, cv2.IMREAD_UNCHANGED).astype(np.float32) * np.float32(self.given.depth_factor)
        if depth.shape != (camera.height, camera.width) or not (depth > 0).any():
            said = f"holds no depth of {camera.width}x{camera.height}, the size in {self.given.camera}"
            raise InputError(f"{printable(file)} {said}; give depth pictures of one channel, and their camera.")
        depth = Undistortion(camera).depth(depth) if any(camera.distortion) else depth
        return moved(back_project(depth, camera)[depth > 0].astype(np.float64), self.eye(frame))

    @cached_property
    def points(self) -> np.ndarray | None:
        """What is followed on the tissue, shape [T, P, 3] [m]; not seen = NaN.

        Raises:
            InputError: the file can't be used.
        """
        if self.given.points is None:
            return None
        file = self.path.parent / self.given.points
        try:
            found = np.load(io.BytesIO(read_file(file, MOST_BYTES)), allow_pickle=False)["points"].astype(np.float64)
        except Exception as error:  # whatever NumPy ends with on other files
            raise InputError(
                f"{printable(file)} can't be read ({reason(error)}); give an NPZ file with points."
            ) from error
        if found.ndim != 3 or found.shape[1:] != (len(self.times), 3):
            said = f"has points of shape {found.shape}; give ids × frames × 3 with {len(self.times)} frames"
            raise InputError(f"{printable(file)} {said}.")
        rows = enumerate(UNITS[self.given.unit] * found.transpose(1, 0, 2))
        return np.stack([moved(row, self.eye(frame)) for frame, row in rows])

    @cached_property
    def forces(self) -> np.ndarray | None:
        """What the tissue does to the tool in every frame, less the sensor's bias, shape [T, 3] [N].

        The bias is the mean while the tip has not moved yet, from the first row on.

        Raises:
            InputError: the file can't be used, or doesn't reach over all frames.
        """
        if self.given.forces is None:
            return None
        file = self.path.parent / self.given.forces
        times, *forces = read_series(file, WRENCH, "table of forces", 2).T
        forces = np.stack(forces, axis=1)
        if times[0] > self.times[0] + ROUNDED or times[-1] < self.times[-1] - ROUNDED:
            said = f"reaches from {times[0]:g} to {times[-1]:g} s, the frames from {self.times[0]:g} to "
            raise InputError(f"{printable(file)} {said}{self.times[-1]:g} s; put both on one clock.")
        early = np.flatnonzero(times <= self.times[self.held[0]])
        inside = early[(times[early] >= self.tool.times[0]) & (times[early] <= self.tool.times[-1])]
        tips = self.tool.tips(times[inside]) if len(inside) else np.empty((0, 3))
        still = inside[np.linalg.norm(tips - tips[:1], axis=1) < STILL]
        bias = forces[still].mean(axis=0) if len(still) else forces[0]
        found = [np.interp(self.times, times, values) for values in (forces - bias).T]
        return np.einsum("tij,tj->ti", self.tool.at(self.times)[:, :3, :3], np.stack(found, axis=1))

    def eye(self, frame: int) -> np.ndarray:
        """Pose of the camera in a frame, shape [4, 4]."""
        eye = np.array(self.given.hand_eye, float)
        eye[:3, 3] *= UNITS[self.given.unit]
        return self.tool.at(self.times[frame]) @ eye if self.given.camera_on == "tool" else eye


@dataclass(frozen=True, eq=False)
class Tool:
    """Where a tool is over time; K rows."""

    path: Path
    times: np.ndarray
    """Rising, shape [K] [s]."""
    poses: np.ndarray
    """In the robot's frame, shape [K, 4, 4]."""
    tip: np.ndarray
    """Where it touches tissue, in its own frame, shape [3] [m]."""

    def at(self, times: np.ndarray | float) -> np.ndarray:
        """Its poses by times [...] between the rows', shape [..., 4, 4].

        Raises:
            InputError: the rows don't reach there.
        """
        low, high = float(np.min(times)), float(np.max(times))
        if low < self.times[0] - ROUNDED or high > self.times[-1] + ROUNDED:
            said = f"reaches from {self.times[0]:g} to {self.times[-1]:g} s, not from {low:g} to {high:g} s"
            raise InputError(f"{printable(self.path)} {said}, as the frames do; put both on one clock.")
        inside = np.clip(times, self.times[0], self.times[-1])
        found = np.zeros((*np.shape(times), 4, 4))
        found[..., :3, :3] = Slerp(self.times, Rotation.from_matrix(self.poses[:, :3, :3]))(inside).as_matrix()
        rows = [np.interp(inside, self.times, values) for values in self.poses[:, :3, 3].T]
        found[..., :3, 3], found[..., 3, 3] = np.stack(rows, axis=-1), 1.0
        return found

    def tips(self, times: np.ndarray) -> np.ndarray:
        """Where its tip is by times [T] [s], shape [T, 3] [m]; raises as `at`."""
        return self.at(times) @ np.append(self.tip, 1.0) @ np.eye(4, 3)


def moved(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Points [..., 3] of a frame with that pose [4, 4], in the frame in which it is given."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def is_sequence(path: Path) -> bool:
    """Whether a path is a file such as sequence.yaml."""
    return path.suffix.lower() in (".yaml", ".yml") and path.is_file()


def open_sequence(path: Path) -> Sequence:
    """Read what a sequence's file says; whether it fits together is `sequence_checks`' to see.

    Raises:
        InputError: it, or a file that it names, can't be read or can't be.
    """
    where, folder = printable(path), path.parent
    given = from_mapping(SequenceFile, read_mapping(path, "a sequence"), where)
    scale, found = UNITS[given.unit], matches(folder, given.clouds or given.depth or "")
    numbers, files = [int(digits) for digits, _ in found], [file for _, file in found]
    if given.fps is not None:
        times = (np.array(numbers) - numbers[0]) / given.fps if numbers else np.zeros(0)
    else:
        times = read_series(folder / str(given.times), ("time_s",), "table of times", 2)[:, 0]
    if len(files) < 2 or len(times) != len(files):
        said = f"names {len(files)} frames ({given.clouds or given.depth}) and {len(times)} times"
        raise InputError(f"{where} {said}; give 2 frames at least, and a time for each.")
    boxes = [from_mapping(Box, box, f"{where}, pin {at}") for at, box in enumerate(given.pins, start=1)]
    pins = scale * np.array([[box.low, box.high] for box in boxes], float).reshape(-1, 2, 3)
    low, high = given.gripped_s or (times[0], times[-1])
    held = np.flatnonzero((low - ROUNDED <= times) & (times <= high + ROUNDED))
    if len(held) < 2:
        raise InputError(f"{where}: {len(held)} frames lie from {low:g} to {high:g} s (gripped_s); give 2 at least.")
    tool, camera = _tool(folder / given.poses, scale, given), None
    if given.camera is not None:
        camera = load_camera(folder / given.camera)
    radius = GRIPPED if given.grip_radius is None else scale * given.grip_radius
    return Sequence(path, given, files, numbers, times, tool, pins, radius, range(held[0], held[-1] + 1), camera)


def _tool(path: Path, scale: float, given: SequenceFile) -> Tool:
    try:
        by_matrix = b"m00" in read_file(path, MOST_BYTES).partition(b"\n")[0]
    except OSError:  # said below
        by_matrix = False
    times, *rows = read_series(path, ("time_s", *(MATRIX if by_matrix else QUATERNION)), "table of poses", 2).T
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    try:
        if by_matrix:
            poses[:] = np.stack(rows, axis=1).reshape(-1, 4, 4)
            turned = np.abs(poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1) - np.eye(3)).max() < 1e-3
            if not turned or not np.linalg.det(poses[:, :3, :3]).min() > 0:
                raise ValueError
        else:
            poses[:, :3, 3] = np.stack(rows[:3], axis=1)
            poses[:, :3, :3] = Rotation.from_quat(np.stack(rows[3:], axis=1)).as_matrix()
    except ValueError as error:  # a quaternion of length 0
        raise InputError(f"{printable(path)} holds a pose that turns nothing rigidly; correct that row.") from error
    poses[:, :3, 3] *= scale
    return Tool(path, times, poses, scale * np.array(given.tip, float))
