"""Camera files as other programs write them."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.data.source.camera import Camera, Rig, Undistortion, load_camera
from palpate.data.source.layout import InputError

BENT = (-0.1, 0.01, 0.002, -0.001, 0.03)
MATRIX = [[739.6, 0.0, 426.5], [0.0, 739.5, 239.5], [0.0, 0.0, 1.0]]
PINHOLE = {"fx": 739.6, "fy": 739.5, "cx": 426.5, "cy": 239.5}
ROS = f"""image_width: 854
image_height: 480
camera_name: left
camera_matrix: {{rows: 3, cols: 3, data: {np.ravel(MATRIX).tolist()}}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: {list(BENT)}}}
"""
SCARED = {"KL": MATRIX, "DL": [BENT], "KR": MATRIX, "DR": [BENT[:4]], "R": np.eye(3).tolist(), "T": [[-4.1], [0], [0]]}


def by_opencv(path: Path, version: str = "") -> Path:
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", 854)
    file.write("image_height", 480)
    file.write("camera_matrix", np.array(MATRIX))
    file.write("distortion_coefficients", np.array([BENT]))
    file.release()
    if version:
        path.write_text(f"{version}\n{path.read_text().split(chr(10), 1)[1]}")
    return path


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_the_same_camera_is_read_from_every_program_s_file(tmp_path: Path) -> None:
    expected = Rig(**PINHOLE, width=854, height=480, distortion=BENT)
    for path in (by_opencv(tmp_path / "new.yaml"), by_opencv(tmp_path / "old.yml", "%YAML:1.0")):
        assert load_camera(path) == expected
    assert load_camera(by_opencv(tmp_path / "opencv.json")) == expected
    assert load_camera(written(tmp_path / "ros.yaml", ROS)) == expected


def test_pairs_have_metres_and_a_file_without_a_size_takes_that_of_the_pictures(tmp_path: Path) -> None:
    for name, entries in (
        ("scared.json", {"camera-calibration": SCARED}),
        ("opencv.json", dict(zip(("M1", "D1", "M2", "D2", "R", "T"), SCARED.values(), strict=True))),
    ):
        rig = load_camera(written(tmp_path / name, json.dumps(entries)))
        assert rig.offset == pytest.approx((-0.0041, 0, 0))
        assert rig.right is not None
        assert rig.right.distortion == BENT[:4]
        assert rig.scaled(854, 480) == Camera(**PINHOLE, width=854, height=480, distortion=BENT)
        with pytest.raises(ValueError, match=r"tells no size, and has its centre at \(426.5, 239.5\), far from"):
            rig.scaled(427, 240)
        with pytest.raises(InputError, match=f"{name} tells no size of its pictures"):
            load_camera(tmp_path / name, stated=True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ROS.replace("plumb_bob", "fisheye"), "has the lens model 'fisheye'; undistort the pictures"),
        (ROS + "fisheye_model: 1\n", "has the lens model 'fisheye'"),
        (ROS.replace("cols: 3, data: [", "cols: 3, data: [7, "), "not as OpenCV or ROS writes a camera .*10 numbers"),
        (ROS.replace("[739.6, 0.0", "[739.6, 12.0"), "has a skew of 12"),
        (ROS.replace("854", "wide"), "not as OpenCV or ROS writes a camera"),
        ("{fx: 1, fy: 1, cx: 0, cy: 0, width: 0, height: 0}", "tells no size of its pictures"),
    ],
)
def test_what_can_not_be_used_is_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=rf"camera\.yaml.*{said}"):
        load_camera(written(tmp_path / "camera.yaml", text))


def test_all_fourteen_coefficients_are_undone() -> None:
    bent = (-0.1, 0.01, 0, 0, 0, 0.02, -0.01, 0, 0.01, 0, -0.01, 0, 0.02, -0.01)
    camera = Camera(**PINHOLE, width=854, height=480, distortion=bent)
    ramp = np.tile(np.arange(854, dtype=np.float32), (480, 1))
    place = np.array([[[500.0, 300.0]]])
    ((there,),) = cv2.undistortPoints(place, camera.matrix, np.array(bent), P=camera.matrix)
    found = Undistortion(camera).image(ramp)
    assert cv2.getRectSubPix(found, (1, 1), there.tolist())[0, 0] == pytest.approx(500, abs=0.1)
