"""Masks in a folder of their own: which picture is whose, what is an instrument in it, and what is missing."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.data.cache import require_models
from palpate.data.labels import TISSUE, TOOL, MaskError
from palpate.data.masks.request import MaskClasses, MaskSource
from palpate.data.masks.sources import open_masks
from palpate.data.settings import PrepareSettings
from palpate.data.source.frames import Frame
from palpate.data.source.layout import ClipLayout, InputError
from tests.data.masks.test_annotation import SIZE, color_mask, expected_labels, write


def binary(column: int) -> np.ndarray:
    """An instrument in the columns up to one."""
    mask = np.zeros(SIZE, np.uint8)
    mask[:, : column + 1] = 255
    return mask


def opened(folder: Path, clip: Path = Path("clip.mp4")) -> MaskSource:
    return open_masks(str(folder), ClipLayout(), MaskClasses(), clip)


def shown(number: int) -> Frame:
    picture = np.full((*SIZE, 3), 100, np.uint8)
    picture[-9:] = 0
    return Frame(number, number, 0.0, picture)


@pytest.mark.parametrize("first", [0, 1])
def test_pictures_count_from_0_or_else_from_1_and_what_is_not_black_is_an_instrument(tmp_path, first):
    for column in range(3):
        write(tmp_path / f"cam2_{column + first:05d}_mask.png", binary(column))
    masks = opened(tmp_path)
    for number in range(3):
        labels = masks(shown(number))
        np.testing.assert_array_equal(labels == TOOL, binary(number) > 0)
        assert (labels[:5, 5:] == TISSUE).all()
        assert (labels[-3:, 5:] == 0).all()
    with pytest.raises(MaskError, match=f"holds no mask {3 + first}; add it"):
        masks(shown(3))


def test_frames_of_a_folder_keep_their_numbers(tmp_path):
    write(tmp_path / "1.png", binary(4))
    assert (opened(tmp_path, tmp_path)(shown(1)) == TOOL).sum() == 5 * SIZE[0]
    with pytest.raises(MaskError, match="holds no mask 0"):
        opened(tmp_path, tmp_path)(shown(0))


def test_masks_by_the_layout_are_read_as_annotation(tmp_path):
    write(tmp_path / "frame_000_endo.png", np.full((*SIZE, 3), 255, np.uint8))
    write(tmp_path / "frame_000_endo_color_mask.png", color_mask())
    np.testing.assert_array_equal(opened(tmp_path)(shown(0)), expected_labels())


def test_a_folder_without_masks_and_a_path_that_is_none_get_a_sentence(tmp_path):
    (tmp_path / "notes.txt").write_text("1")
    with pytest.raises(InputError, match="holds no masks; give pictures whose names end in the numbers of frames"):
        opened(tmp_path)
    with pytest.raises(InputError, match="or a folder of masks"):
        opened(tmp_path / "absent")


def test_a_mask_that_changes_is_prepared_anew(tmp_path):
    file = write(tmp_path / "0.png", binary(4))
    before = require_models(PrepareSettings(masks=str(tmp_path)))
    file.write_bytes(cv2.imencode(".png", binary(9))[1].tobytes() + b"\0")
    assert require_models(PrepareSettings(masks=str(tmp_path))) != before
