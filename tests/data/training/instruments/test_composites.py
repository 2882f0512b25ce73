"""Pictures that train the instrument network: labels where instruments are drawn, real ones read as they are."""

import cv2
import numpy as np
import pytest

from palpate.data.source.layout import InputError
from palpate.data.training.instruments import scenery
from palpate.data.training.instruments.composites import InstrumentPictures, Labelled, RealPictures, warp
from palpate.data.training.instruments.datamodule import InstrumentData
from palpate.data.training.instruments.drawing import Canvas, draw_instrument


def test_an_instrument_is_drawn_from_its_entry_to_its_tip():
    for seed in range(12):
        rng = np.random.default_rng(seed)
        canvas = Canvas(np.zeros((224, 384, 3), np.float32), np.zeros((224, 384), bool), rng)
        draw_instrument(canvas, np.array([-20.0, 100.0]), np.array([250.0, 120.0]), 20.0)
        rows, columns = np.nonzero(canvas.tool)
        assert columns.min() == 0
        assert 230 < columns.max() < 300
        assert np.abs(rows[columns < 60] - 104).max() < 24
        assert np.abs(canvas.picture[~canvas.tool]).max() < 1.7


def test_labels_agree_with_the_picture_and_repeat_by_the_seed():
    pictures = InstrumentPictures(RealPictures((), ()), seed=4)
    drawn = [pictures.draw(np.random.default_rng(7)) for _ in range(2)]
    for first, second in zip(*drawn, strict=True):
        np.testing.assert_array_equal(first, second)
    rng, shares = np.random.default_rng(1), []
    for _ in range(20):
        picture, tool = pictures.draw(rng)
        assert (picture.shape, tool.shape) == ((192, 320, 3), (192, 320))
        assert 0 <= picture.min() <= picture.max() <= 1
        assert set(np.unique(tool)) <= {0, 1}
        shares.append(tool.mean())
    assert 0 < np.median(shares) < 0.3
    assert min(shares) == 0


def test_a_warped_picture_and_its_mask_stay_together():
    tool = np.zeros((120, 160), np.uint8)
    cv2.circle(tool, (80, 60), 25, 1, -1)
    picture = np.repeat(tool[..., None] * np.uint8(200), 3, axis=2)
    for seed in range(8):
        found = warp(np.random.default_rng(seed), Labelled(picture, tool), (224, 384))
        known = found.tool != 255
        assert ((found.picture[..., 0] > 100) == (found.tool == 1))[known].mean() > 0.98


def test_real_pictures_are_read_with_their_masks(tmp_path):
    picture, mask = np.full((30, 40, 3), 90, np.uint8), np.zeros((30, 40), np.uint8)
    mask[:10], mask[10:12] = 255, 127
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    cv2.imwrite(str(tmp_path / "a_tool.png"), mask)
    cv2.imwrite(str(tmp_path / "b.png"), picture)
    found = RealPictures.read([tmp_path])
    assert (len(found.labelled), len(found.free)) == (1, 1)
    np.testing.assert_array_equal(np.unique(found.labelled[0].tool, return_counts=True), [[0, 1, 255], [720, 400, 80]])
    cv2.imwrite(str(tmp_path / "a_tool.png"), mask[:20])
    with pytest.raises(InputError, match="differ in size"):
        RealPictures.read([tmp_path])
    with pytest.raises(InputError, match="holds no picture"):
        RealPictures.read([tmp_path / "nothing"])


def test_tissue_is_lit_and_coloured():
    found = scenery.tissue(np.random.default_rng(3), (60, 80))
    assert found.shape == (60, 80, 3)
    assert np.isfinite(found).all()
    assert found.std() > 0.02


def test_batches_have_the_pictures_that_were_asked_for():
    data = InstrumentData(batch_size=2, workers=0, validation=3)
    picture, tool = next(iter(data.train_dataloader()))
    assert (picture.shape, tool.shape) == ((2, 3, 192, 320), (2, 192, 320))
    assert sum(len(batch[0]) for batch in data.val_dataloader()) == 3


def test_processes_that_draw_are_not_forked_from_one_with_threads_of_opencv():
    loader = InstrumentData(workers=1).train_dataloader()
    assert loader.multiprocessing_context.get_start_method() == "spawn"
