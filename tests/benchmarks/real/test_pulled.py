"""Drawn tissue that a drawn tool pulls: what the session of users says of it, and what can't be said."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.real.predicted import follow_clip, read_views
from benchmarks.real.pulled import PulledClip, evaluate_pull
from palpate.data.source.layout import InputError
from palpate.estimators.grip.lattice import GripFrame
from palpate.estimators.online.forecast import Lattice
from tests.benchmarks.real_clips import pull_clip, tissue_motion, tool_mask, write

SHARES = np.linspace(0, 3, 9)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> PulledClip:
    return pull_clip(tmp_path_factory.mktemp("pulled"), SHARES)


def test_what_the_session_says_of_a_grip_is_told(clip: PulledClip) -> None:
    told = evaluate_pull(clip)
    assert (told["status"], told["verdict"]) == ("ok", "relative_force")
    assert told["skill in frames kept back"] > 0.5
    low, middle, high = (told[f"foundation_over_stiffness{end}"] for end in ("_low", "", "_high"))
    assert 0 < low < middle < high < 1
    assert told["frames that move"] >= 6
    assert told["frames"] == len(SHARES)
    shown = [value for name, value in told.items() if name.startswith("contact_frame_")]
    assert len(shown) == len(SHARES)
    assert told["frames in contact"] == sum(value >= 0.5 for value in shown)


def test_a_clip_that_can_t_be_read_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no can't be opened"):
        evaluate_pull(PulledClip(tmp_path / "no"))


def test_tissue_is_followed_where_it_goes(clip: PulledClip) -> None:
    lattice, frames = follow_clip(clip)
    assert len(frames) == 8
    for share, frame in list(zip(SHARES[1:], frames, strict=True))[::3]:
        off = np.linalg.norm(frame.moved - tissue_motion(lattice.points.astype(float), share), axis=1)
        assert np.median(off[frame.around]) < 0.15
        assert (frame.around | frame.gripped).mean() > 0.85
    assert 20 <= frames[0].gripped.sum() < 80


def test_frames_without_picture_or_mask_are_left_out(tmp_path: Path) -> None:
    clip = pull_clip(tmp_path, np.linspace(0, 1, 5))
    (tmp_path / "frames" / "001.png").write_bytes(b"none")
    (tmp_path / "masks" / "002.png").unlink()
    assert len(list(read_views(clip))) == 3
    assert len(follow_clip(clip)[1]) == 2
    write(tmp_path / "masks" / "000.png", np.full(tool_mask(0).shape, 255, np.uint8))
    assert len(follow_clip(clip)[1]) == 1  # begins where an instrument comes into view
    write(tmp_path / "masks" / "003.png", np.full(tool_mask(0).shape, 255, np.uint8))
    with pytest.raises(InputError, match="fewer than two frames with an instrument"):
        follow_clip(clip)


def test_nearby_are_the_nearest_third_of_the_points_that_are_seen() -> None:
    """Of 100 seen points, those at the grip counted, the nearest 35."""
    distance = np.arange(120.0)[::-1]
    moved = np.ones((120, 2))
    moved[distance >= 100] = np.nan
    nearby = Lattice(np.zeros((120, 2)), 8, distance).nearby(GripFrame(moved, distance < 10))
    np.testing.assert_array_equal(nearby.around, (distance >= 10) & (distance < 35))
    np.testing.assert_array_equal(nearby.gripped, distance < 10)


@pytest.mark.slow
def test_a_real_clip_is_told_of_as_users_have_it(real_data: Path) -> None:
    """Half a minute: sixteen frames of half a megapixel."""
    folder = real_data / "recover_tissue"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    layout = Path(__file__).parents[3] / "configs/layouts/recover_tissue.yaml"
    told = evaluate_pull(PulledClip(folder, layout))
    assert told["verdict"] == "relative_force"
    assert told["skill in frames kept back"] > 0.4
