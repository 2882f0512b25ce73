"""Sequences beside a robot, drawn: a pull of known stiffness as clouds and followed points, in a frame of its own."""

import functools
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from benchmarks.online.sequences import NOISE, SEQUENCES, SIDE, Pull

TURN, SHIFT = Rotation.from_euler("xyz", (40, -25, 110), degrees=True).as_matrix(), np.array([0.4, -0.1, 0.25])
"""Pose of the simulated sheet in the robot's frame; the camera stands half a metre above it."""
EYE = np.array([[1, 0, 0, 0.06], [0, -1, 0, 0.06], [0, 0, -1, 0.5], [0, 0, 0, 1]])
"""Pose of the camera in the sheet's own frame."""
FPS = 10.0


@functools.cache
def pull(frames: int) -> Pull:
    """The pull of 144 particles, 60 frames of it at most."""
    return SEQUENCES["thin-shell-1"].pull(150, 3000, frames)


def placed(points: np.ndarray, turn: np.ndarray = TURN) -> np.ndarray:
    """Places on the sheet, in the robot's frame."""
    return points @ turn.T + SHIFT


def write_sequence(
    folder: Path,
    frames: int = 12,
    still: int = 0,
    turn: np.ndarray = TURN,
    length: float = 1.0,
    drawn: Pull | None = None,
    **changed,
) -> Path:
    """A pull with `still` frames of rest before it, its clouds in the camera's frame; returns sequence.yaml.

    Args:
        turn: of the sheet in the robot's frame.
        length: of a metre in the file's unit.
        drawn: the pull; None = the usual one.
        changed: fields of the file; None leaves one out.
    """
    drawn, random = drawn or pull(frames), np.random.default_rng(1)
    flat = [
        np.column_stack([random.uniform(0, SIDE, (3000, 2)), random.normal(0, NOISE, 3000)]) for _ in range(1 + still)
    ]
    clouds = [*flat, *drawn.clouds]
    points = np.concatenate([drawn.points[:1]] * (1 + still) + [drawn.tracks])
    way = drawn.places[:, 0] - drawn.body.rest[drawn.gripped[0]]
    tips = np.array([SIDE, SIDE / 2, 0.0]) + np.concatenate([np.zeros((1 + still, 3)), way])
    (folder / "clouds").mkdir(parents=True, exist_ok=True)

    def seen(places: np.ndarray) -> np.ndarray:
        return length * (places - EYE[:3, 3]) @ EYE[:3, :3]

    for number, cloud in enumerate(clouds):
        np.savez(folder / f"clouds/{number:03d}.npz", points=seen(cloud))
    np.savez(folder / "followed.npz", points=seen(points).transpose(1, 0, 2))
    times, turned = np.arange(len(clouds)) / FPS, Rotation.from_matrix(turn).as_quat()
    poses = np.column_stack([times, length * placed(tips, turn), np.tile(turned, (len(times), 1))])
    np.savetxt(folder / "poses.csv", poses, "%.10g", ",", header="time_s,x,y,z,qx,qy,qz,qw", comments="")
    eye = np.eye(4)
    eye[:3, :3], eye[:3, 3] = turn @ EYE[:3, :3], length * placed(EYE[:3, 3], turn)
    edge = length * placed(np.column_stack([np.zeros(25), np.linspace(0, SIDE, 25), np.zeros(25)]), turn)
    boxes = [{"low": (place - 0.006 * length).tolist(), "high": (place + 0.006 * length).tolist()} for place in edge]
    given = {"clouds": "clouds/{number}.npz", "poses": "poses.csv", "fps": FPS, "points": "followed.npz"}
    given |= {"hand_eye": eye.tolist(), "grip_radius": 0.012 * length, "pins": boxes}
    given = {name: value for name, value in (given | changed).items() if value is not None}
    (folder / "sequence.yaml").write_text(yaml.safe_dump(given))
    return folder / "sequence.yaml"
