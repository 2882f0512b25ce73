"""How videos are coded, as their decoder says it, and pictures coded once more."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.data.source.coding import coding_of, recoded
from palpate.data.source.video import Video

GENERATOR = np.random.default_rng(4)
TEXTURE = cv2.GaussianBlur(GENERATOR.normal(0, 300, (96, 128, 1)), (0, 0), 2)[..., None]
DRIFT = 0.1 * np.arange(128)[None, :, None]
PICTURES = [
    np.clip(120 + TEXTURE + GENERATOR.normal(0, 3, (96, 128, 3)) + DRIFT * index, 0, 255).astype(np.uint8)
    for index in range(14)
]


def written(path: Path, crf: int) -> Path:
    opened = Video(path, (128, 96), 25.0, crf)
    for picture in PICTURES:
        opened.write(picture)
    opened.close()
    return path


def test_quantiser_rises_with_the_rate_factor_a_video_was_written_with(tmp_path):
    fine, coarse = (coding_of(written(tmp_path / f"{crf}.mp4", crf)) for crf in (15, 30))
    assert fine is not None
    assert coarse is not None
    assert fine.bidirectional
    assert coarse.quantiser - fine.quantiser == pytest.approx(15, abs=2)


def test_pictures_coded_as_a_video_was_come_out_as_from_it(tmp_path):
    path = written(tmp_path / "clip.mp4", 24)
    came, coding = recoded(PICTURES, 24, bidirectional=True)
    assert coding.quantiser == pytest.approx(coding_of(path).quantiser, abs=0.5)
    reader = cv2.VideoCapture(str(path))
    video = np.stack([reader.read()[1][..., ::-1] for _ in PICTURES]).astype(float)
    original = np.stack(PICTURES).astype(float)
    # What coding loses is the same: it correlates, place by place.
    assert np.corrcoef((came - original).ravel(), (video - original).ravel())[0, 1] > 0.9


def test_pictures_are_coded_alike_whatever_lies_in_memory():
    wave = np.add.outer(np.arange(150) ** 2, np.arange(202) ** 2)[..., None] / 900
    noise = np.random.default_rng(0).normal(0, 4, (48, 150, 202, 3))
    pictures = (120 + 40 * np.sin(wave) + noise).astype(np.uint8)
    came = []
    for seed in range(3):
        generator = np.random.default_rng(seed)
        left = [generator.integers(0, 256, size, np.uint8) for size in generator.integers(1_000, 120_000, 300)]
        del left  # what an encoder finds where it reads memory that it has not written
        came.append(recoded(pictures, 23, bidirectional=True)[0])
    np.testing.assert_array_equal(came[1], came[0])
    np.testing.assert_array_equal(came[2], came[0])


def test_coarser_pictures_are_farther_off_and_frames_are_in_order():
    off = []
    for quality in (5, 20, 40):
        came, coding = recoded(PICTURES, quality, bidirectional=False)
        assert not coding.bidirectional
        off.append(np.abs(came.astype(float) - np.stack(PICTURES)).mean())
    assert off[0] < off[1] < off[2]
    assert off[0] < 0.5 * off[2]


def test_where_the_decoder_does_not_say_it_nothing_is_known(tmp_path):
    (tmp_path / "text.mp4").write_text("no video")
    writer = cv2.VideoWriter(str(tmp_path / "old.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (128, 96))
    for picture in PICTURES:
        writer.write(picture)
    writer.release()
    assert coding_of(tmp_path / "text.mp4") is None
    assert coding_of(tmp_path / "old.avi") is None
    assert coding_of(tmp_path / "missing.mp4") is None
