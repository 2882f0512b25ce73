"""Masks of pins and paths of grippers: what they tell, and what can't be used is a sentence that names the file."""

from pathlib import Path

import numpy as np
import pytest

from palpate.data.source.layout import InputError
from palpate.estimators.online.given import read_path, read_pins
from tests.benchmarks.real_clips import write


def test_tissue_is_pinned_where_the_mask_is_white(tmp_path: Path) -> None:
    mask = np.zeros((20, 30, 3), np.uint8)
    mask[:, 25:], mask[:, :5, 2] = 255, 255
    write(tmp_path / "pins.png", mask)
    pins = read_pins(tmp_path / "pins.png")
    places = np.array([[24.4, 3.0], [24.6, 3.0], [2.0, 10.0], [31.0, 25.0]])  # the last one outside
    assert pins.at(places).tolist() == [False, True, False, True]
    pins.require_size((30, 20))
    with pytest.raises(InputError, match=r"pins\.png is 30x20, the clip's pictures are 20x30; give a mask of the size"):
        pins.require_size((20, 30))


def test_a_mask_that_is_none_is_a_sentence(tmp_path: Path) -> None:
    write(tmp_path / "black.png", np.zeros((20, 30), np.uint8))
    (tmp_path / "text.png").write_text("white")
    for name, sentence in (
        ("black.png", r"black\.png is white nowhere; paint what is pinned white"),
        ("text.png", r"text\.png can't be decoded as an image"),
        ("absent.png", r"absent\.png can't be read"),
    ):
        with pytest.raises(InputError, match=sentence):
            read_pins(tmp_path / name)


def test_a_path_is_linear_between_its_rows_and_ends_with_them(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text("z,time_s,x_px,y_px\n0.5,1,10,20\n0.4,2,30,20\n0.4,4,30,60\n")
    path = read_path(tmp_path / "path.csv")
    for time, place in ((1.0, [10, 20, 0.5]), (1.5, [20, 20, 0.45]), (3.0, [30, 40, 0.4]), (4.0, [30, 60, 0.4])):
        np.testing.assert_allclose(path.at(time), place)
    assert path.at(0.99) is path.at(4.01) is None


def test_rows_of_rounded_times_reach_their_frames(tmp_path: Path) -> None:
    (tmp_path / "path.csv").write_text("time_s,x_px,y_px,z\n0.0667,10,20,0.5\n0.1333,30,40,0.4\n")
    path = read_path(tmp_path / "path.csv")
    np.testing.assert_allclose(path.at(2 / 30), [10, 20, 0.5])
    np.testing.assert_allclose(path.at(4 / 30), [30, 40, 0.4])
    assert path.at(0.0667 - 0.0011) is path.at(0.1333 + 0.0011) is None


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("time_s,x_px,y_px\n0,1,2\n1,1,2\n", r"path\.csv is no path of a gripper \(there is no 'z'\); give a CSV file"),
        ("time_s,x_px,y_px,z\n0,1,2,1\n1,1,nan,1\n", r"path\.csv holds a value that is not finite"),
        ("time_s,x_px,y_px,z\n1,1,2,1\n1,1,2,1\n", r"path\.csv holds a time that is not after the one before"),
        ("time_s,x_px,y_px,z\n0,1,2,far\n1,1,2,1\n", r"path\.csv is no path of a gripper"),
    ],
)
def test_a_table_that_is_none_is_a_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "path.csv").write_text(text)
    with pytest.raises(InputError, match=sentence):
        read_path(tmp_path / "path.csv")
