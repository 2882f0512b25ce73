"""Sequences beside a robot: what is read of them, and bad ones, each of which is a sentence."""

from collections.abc import Callable
from pathlib import Path

import cv2
import meshio
import numpy as np
import pytest

from palpate.data.source.clouds import read_cloud
from palpate.data.source.layout import InputError
from palpate.data.source.sequence import Sequence, open_sequence
from palpate.data.source.sequence_checks import require_fit
from tests.sequences import placed, pull, write_sequence

POINTS = np.array([[0.1, -0.2, 0.3], [1.5, 2.5, -3.5]])


def checked(path: Path) -> Sequence:
    sequence = open_sequence(path)
    require_fit(sequence)
    return sequence


@pytest.mark.parametrize("binary", [True, False])
def test_ply_is_read_in_binary_and_in_text(tmp_path: Path, binary: bool) -> None:
    meshio.Mesh(POINTS, [], {"red": np.array([1, 2], np.uint8)}).write(tmp_path / "a.ply", binary=binary)
    np.testing.assert_allclose(read_cloud(tmp_path / "a.ply"), POINTS)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n1\n"),
        ("a.ply", b""),
        ("a.npz", b"PK\x03\x04"),
        ("a.txt", b"1 2 3"),
    ],
)
def test_a_cloud_that_is_none_is_a_sentence(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=rf"{name} can't be read as points .*; give a PLY or NPZ"):
        read_cloud(tmp_path / name)


@pytest.mark.parametrize("points", ["followed.npz", None])
def test_frames_without_tissue_are_passed_over(tmp_path: Path, points: str | None) -> None:
    path = write_sequence(tmp_path, 8, points=points)
    for number in (0, 3, 8):
        np.savez(tmp_path / f"clouds/{number:03d}.npz", points=np.full((9 * (number > 0), 3), np.nan))
    sequence = checked(path)
    assert sequence.held == range(1, 9)
    assert [len(sequence.cloud(frame)) for frame in (0, 3, 8)] == [0, 0, 0]
    for number in range(8):
        np.savez(tmp_path / f"clouds/{number:03d}.npz", points=np.empty((0, 3)))
    with pytest.raises(InputError, match=r"sequence\.yaml shows no tissue while the tool holds it; give clouds"):
        checked(path)


def test_followed_points_that_are_nowhere_are_a_sentence(tmp_path: Path) -> None:
    path = write_sequence(tmp_path, 4)
    np.savez(tmp_path / "followed.npz", points=np.full((7, 5, 3), np.nan))
    with pytest.raises(InputError, match=r"followed\.npz can't be read as points .*or none is finite"):
        checked(path)


def test_clouds_points_and_poses_are_in_the_robots_frame(tmp_path: Path) -> None:
    drawn, sequence = pull(12), checked(write_sequence(tmp_path, length=1000.0, unit="mm"))
    np.testing.assert_allclose(sequence.cloud(5), placed(drawn.clouds[4]), atol=1e-9)
    assert sequence.points is not None
    np.testing.assert_allclose(sequence.points[5], placed(drawn.tracks[4]), atol=1e-9)
    tip = sequence.tool.tips(np.array([0.0, 0.05, 0.1]))
    np.testing.assert_allclose(tip[1], tip[::2].mean(axis=0))
    np.testing.assert_allclose(tip[0], placed(np.array([0.12, 0.06, 0.0])), atol=1e-9)


def test_depth_pictures_are_clouds_of_a_camera_on_the_tool(tmp_path: Path) -> None:
    (tmp_path / "depth").mkdir()
    depth = np.zeros((40, 60), np.uint16)
    depth[20, 35] = 250
    for number in (1, 2):
        cv2.imwrite(str(tmp_path / f"depth/{number}.png"), depth)
    (tmp_path / "camera.yaml").write_text("{fx: 50, fy: 50, cx: 30, cy: 20, width: 60, height: 40}")
    head = "time_s,x,y,z,qx,qy,qz,qw"
    rows = [f"{time},{x},2,3,0,0,1,1" for time, x in ((0, 1), (2, 5))]
    (tmp_path / "poses.csv").write_text("\n".join([head, *rows]))
    (tmp_path / "sequence.yaml").write_text(
        "{depth: 'depth/{number}.png', camera: camera.yaml, poses: poses.csv, fps: 1, camera_on: tool}"
    )
    # 5 px right of the middle at 0.25 m is 25 mm; the tool is turned by 90 degrees and stands at (3, 2, 3) by 1 s.
    np.testing.assert_allclose(open_sequence(tmp_path / "sequence.yaml").cloud(1), [[3, 2.025, 3.25]], atol=1e-6)
    cv2.imwrite(str(tmp_path / "depth/1.png"), np.zeros_like(depth))
    assert open_sequence(tmp_path / "sequence.yaml").cloud(0).shape == (0, 3)
    cv2.imwrite(str(tmp_path / "depth/1.png"), depth[:20])
    with pytest.raises(InputError, match=r"1\.png holds no depth of 60x40, the size in camera\.yaml; give depth"):
        open_sequence(tmp_path / "sequence.yaml").cloud(0)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"length": 1000.0}, r"000\.npz is \d+ m wide, which looks like millimetres; give unit: mm"),
        ({"unit": "mm"}, r"is 0.000\d+ m wide, which looks like metres; give unit: m"),
        ({"hand_eye": None}, r"the tip stays 0\.\d+ m from the tissue: .* different frames; check hand_eye"),
        ({"fps": None}, "give times or fps"),
        ({"grip_radius": -1.0}, r"grip_radius is -1\.0; give a positive number"),
        ({"grip_radius": 12.0}, r"sequence\.yaml: grip_radius can't be the tissue's"),
        ({"length": 1000.0, "unit": "mm", "grip_radius": 0.012}, "grip_radius can't be the tissue's; check `unit`"),
        ({"camera": "camera.yaml"}, "give clouds, or depth with camera"),
        ({"gripped_s": [5.0, 6.0]}, r"0 frames lie from 5 to 6 s \(gripped_s\)"),
        ({"hand_eye": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "hand_eye is no rotation and shift"),
        ({"clouds": "{number}.ply"}, "names 0 frames"),
        (
            {"clouds": "clouds/000.npz"},
            r"names 0 frames \(clouds/000.npz\) and 0 times; give 2 at least, their \{number\}",
        ),
        (
            {"clouds": "{number}/cloud.npz"},
            r"names 0 frames \(\{number\}/cloud.npz\).* their \{number\} in the files' names",
        ),
        ({"fps": 1.0}, r"poses\.csv reaches from 0 to 1\.2 s, the frames from 0 to 12 s; put both on one"),
        ({"pins": [{"low": [0, 0, 0]}]}, "each of pins is to have low and high"),
        ({"points": "clouds/000.npz"}, r"its points have shape \(3000, 3\), not \('m', 13, 3\)"),
    ],
)
def test_what_does_not_fit_is_a_sentence(tmp_path: Path, changed: dict, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        checked(write_sequence(tmp_path, **changed))


def test_poses_in_another_unit_than_clouds_are_told(tmp_path: Path) -> None:
    path = write_sequence(tmp_path)
    rows = np.loadtxt(tmp_path / "poses.csv", delimiter=",", skiprows=1)
    rows[:, 1:4] *= 1000
    np.savetxt(tmp_path / "poses.csv", rows, "%.10g", ",", header="time_s,x,y,z,qx,qy,qz,qw", comments="")
    with pytest.raises(InputError, match="clouds and poses seem to be in different units; give both in one"):
        checked(path)


@pytest.mark.parametrize("damage", [lambda points: 1000 * points, lambda points: points + 0.5])
def test_followed_points_off_the_clouds_are_told(tmp_path: Path, damage: Callable) -> None:
    """In millimetres, or in another frame: they were taken for tissue there."""
    path = write_sequence(tmp_path)
    np.savez(tmp_path / "followed.npz", points=damage(np.load(tmp_path / "followed.npz")["points"]))
    with pytest.raises(InputError, match=r"sequence\.yaml: points lie off the clouds; give both in one unit and frame"):
        checked(path)


def test_a_pose_without_a_turn_is_a_sentence(tmp_path: Path) -> None:
    path = write_sequence(tmp_path)
    rows = np.loadtxt(tmp_path / "poses.csv", delimiter=",", skiprows=1)
    rows[3, 4:] = 0
    np.savetxt(tmp_path / "poses.csv", rows, "%.10g", ",", header="time_s,x,y,z,qx,qy,qz,qw", comments="")
    with pytest.raises(InputError, match=r"poses\.csv holds a quaternion of length 0; correct that row"):
        open_sequence(path)
