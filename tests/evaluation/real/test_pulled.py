"""Drawn tissue that a drawn tool pulls: what is followed, how well later frames are predicted, what can't be used."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from data.source.frames import Frame
from data.source.layout import InputError
from data.tracks.background import far_points, without_background
from data.tracks.following import MARGIN, tool_distance, values_at
from estimators.grip.sheet_fit import GripFrame, NothingMoves, length
from evaluation.real.pulled import (
    DRIVEN,
    Follow,
    Pull,
    PulledClip,
    _expected_skill,
    evaluate_pull,
    follow_clip,
    nearby_frame,
)
from tests.evaluation.real_clips import tissue_motion, tool_mask, write, write_pull
from tests.inference_inputs import write_clip

SHARES = np.linspace(0, 1, 13)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_pull(tmp_path_factory.mktemp("pulled"), SHARES)


@pytest.fixture(scope="module")
def pull(folders: tuple[Path, Path]) -> Pull:
    return evaluate_pull(PulledClip(*folders))


@pytest.fixture
def own(folders: tuple[Path, Path], tmp_path: Path) -> PulledClip:
    """A clip of four frames that a test may change."""
    for folder in folders:
        (tmp_path / folder.name).mkdir()
        for file in sorted(folder.iterdir())[::4]:
            shutil.copy(file, tmp_path / folder.name)
    return PulledClip(tmp_path / "frames", tmp_path / "masks")


def test_tissue_is_followed_where_it_goes(pull: Pull) -> None:
    follow = pull.follow
    assert len(follow.frames) == 12
    assert follow.unreadable == []
    for share, frame in list(zip(SHARES[1:], follow.frames, strict=True))[::4]:
        off = np.linalg.norm(frame.moved - tissue_motion(follow.points.astype(float), share), axis=1)
        assert np.median(off[frame.around]) < 0.15
        assert np.quantile(off[frame.around | frame.gripped], 0.9) < 0.6
        assert (frame.around | frame.gripped).mean() > 0.9


def test_points_near_the_tool_are_the_grip(pull: Pull) -> None:
    frame, distance = pull.follow.frames[-1], pull.follow.distance
    assert 20 <= frame.gripped.sum() < 80
    assert distance[frame.gripped].max() < DRIVEN <= distance[frame.around].min()


def test_frames_kept_back_are_predicted(pull: Pull) -> None:
    told = pull.measures
    assert (told["status"], told["frames"], told["frames left out"], told["frames judged"]) == ("ok", 13, 0, 6)
    assert pull.judged == [7, 8, 9, 10, 11, 12]
    assert told["points"] == len(pull.follow.points)
    for kind in ("all, field", "nearby, field", "all, one number", "nearby, one number"):
        assert told[f"skill of {kind}, mean"] == pytest.approx(pull.skills[kind].mean())
        assert told[f"skill of {kind}, last frame"] == pull.skills[kind][-1]
    assert told["skill of all, field, mean"] > 0.9
    assert told["skill of nearby, field, mean"] > 0.9
    assert told["skill of all, field, mean"] > told["skill of all, one number, mean"]
    assert 0.8 < told["points within the 90 % bands"] <= 1
    low, middle, high = (told[f"foundation over stiffness{end}"] for end in (", low", "", ", high"))
    assert 0.001 < low < middle < high < 1


def test_skill_is_one_less_error_over_motion(pull: Pull) -> None:
    """Root mean squares over the points of the last frame, by hand."""
    frame = pull.follow.frames[-1]
    moved, _ = pull.fit.predict(frame)
    seen = np.isfinite(frame.moved).all(axis=1) & ~frame.gripped
    error = np.sqrt(((moved - frame.moved)[seen] ** 2).sum(axis=1).mean())
    motion = np.sqrt((frame.moved[seen] ** 2).sum(axis=1).mean())
    assert pull.skills["all, field"][-1] == pytest.approx(1 - error / motion)


def test_the_fit_never_sees_the_second_half(folders: tuple[Path, Path], pull: Pull, tmp_path: Path) -> None:
    """The last frames replaced by others, the fit and its skill in those that stay are the same."""
    for folder in folders:
        shutil.copytree(folder, tmp_path / folder.name)
        for name in ("010.png", "011.png", "012.png"):
            shutil.copy(folder / "009.png", tmp_path / folder.name / name)
    other = evaluate_pull(PulledClip(tmp_path / "frames", tmp_path / "masks"))
    np.testing.assert_array_equal(other.fit.numbers, pull.fit.numbers)
    assert other.fit.error == pull.fit.error
    np.testing.assert_array_equal(other.skills["all, field"][:3], pull.skills["all, field"][:3])


def test_force_rises_with_the_pull(pull: Pull) -> None:
    force, sd = pull.force
    used = [frame for frame in pull.follow.frames if frame.tells]
    assert len(force) == len(sd) == len(used)
    assert force[-1] == pytest.approx(1)
    np.testing.assert_allclose(force, SHARES[-len(used) :], atol=0.15)


def test_nearby_are_the_nearest_third_of_the_points_that_are_seen() -> None:
    """Of 100 seen points, those at the grip counted, the nearest 35."""
    distance = np.arange(120.0)[::-1]
    moved = np.ones((120, 2))
    moved[distance >= 100] = np.nan
    nearby = nearby_frame(GripFrame(moved, distance < 10), distance)
    np.testing.assert_array_equal(nearby.around, (distance >= 10) & (distance < 35))
    np.testing.assert_array_equal(nearby.gripped, distance < 10)


def test_the_cameras_motion_is_taken_off(tmp_path: Path) -> None:
    """The tool moves with the picture here, so that masks of a still camera are a little off."""
    frames, masks = write_pull(tmp_path, np.array([0, 0.25, 0.5]), (0.0, 8.0))
    for camera, expected in ((False, 4.0), (True, 0.0)):
        follow = follow_clip(PulledClip(frames, masks, camera=camera))
        moved = follow.frames[-1].moved
        far = np.linalg.norm(tissue_motion(follow.points.astype(float), 0.5), axis=1) < 0.05
        assert np.nanmedian(moved[far, 1]) == pytest.approx(expected, abs=0.15)
        assert np.nanquantile(np.abs(moved[far, 1] - expected), 0.8) < 0.3


def test_uneven_tissue_under_a_moving_camera_is_predicted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every point is carried along by its own share of the camera's way, which is learnt in the first half."""
    random = np.random.default_rng(3)
    rows, columns = np.mgrid[8:184:8, 8:248:8]
    points = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float32)
    distance = np.linalg.norm(points - [70, 90], axis=1)
    uneven = np.sin(points[:, 0] / 30) * np.cos(points[:, 1] / 25 + 1)
    ways = 6 * np.column_stack([np.sin(np.arange(1, 17)), np.cos(0.7 * np.arange(1, 17))])
    frames = []
    for share, way in zip(np.linspace(0.1, 1, 16), ways, strict=True):
        own = share * np.exp(-distance / 40)[:, None] * [10.0, 5.0] + random.normal(0, 0.2, (len(points), 2))
        moved = without_background(points, own + uneven[:, None] * way, distance)
        frames.append(GripFrame(moved, distance < DRIVEN))
    picture = np.zeros((192, 256, 3), np.uint8)
    follow = Follow(points, 8, distance, frames, (picture, picture), [], "masks", True)
    monkeypatch.setattr("evaluation.real.pulled.follow_clip", lambda _: follow)
    found = evaluate_pull(PulledClip(Path("drawn"), camera=True))
    told = found.measures
    assert told["skill of all, field, mean"] > 0.8
    assert told["skill of nearby, field, mean"] > 0.8
    assert 0.8 < told["points within the 90 % bands"] < 0.99
    assert told["skill of all, camera alone, mean"] < told["skill of all, field, mean"]
    assert told["skill of all, beside the camera, mean"] > 0.35
    assert told["verdict"] == "the sheet explains the motion"
    frame = follow.told(8)[-1]
    predicted = found.fit.predict(frame)[0]
    off, around = predicted - frame.moved, frame.around
    assert found.skills["all, field"][-1] == pytest.approx(1 - length(off[around]) / length(frame.moved[around]))
    left = frame.moved - frame.carried
    assert found.skills["all, camera alone"][-1] == pytest.approx(
        1 - length(left[around]) / length(frame.moved[around])
    )
    far = far_points(frame.moved, distance)
    assert frame.reach == frame.astray == pytest.approx(length(left[far]))
    # A camera that is said to be still carries nothing.
    assert dataclasses.replace(follow, camera=False).told(8) == frames


def test_a_part_of_the_clip_is_judged(folders: tuple[Path, Path]) -> None:
    """The first frame of the part is at rest."""
    follow = follow_clip(PulledClip(*folders, start=4, stop=9))
    assert len(follow.frames) == 4
    np.testing.assert_array_equal(follow.pictures[0], cv2.imread(str(folders[0] / "004.png"))[..., ::-1])
    np.testing.assert_array_equal(follow.pictures[1], cv2.imread(str(folders[0] / "008.png"))[..., ::-1])
    moved = follow.frames[-1].moved[follow.frames[-1].gripped]
    np.testing.assert_allclose(moved.mean(axis=0), [-2, 1], atol=0.5)


def test_small_blobs_of_a_mask_are_no_tool(own: PulledClip) -> None:
    assert own.masks is not None
    plain = follow_clip(own).points
    mask = np.where(tool_mask(0), 0, 255).astype(np.uint8)
    mask[20:34, 150:164] = 0  # 14 px are less than the opening's 15
    write(own.masks / "000.png", mask)
    np.testing.assert_array_equal(follow_clip(own).points, plain)
    mask[20:35, 150:165] = 0
    write(own.masks / "000.png", mask)
    assert len(follow_clip(own).points) < len(plain)


def test_the_tools_value_is_told(own: PulledClip) -> None:
    assert own.masks is not None
    expected = follow_clip(own).points
    for index, share in zip(("000", "004", "008", "012"), SHARES[::4], strict=True):
        write(own.masks / f"{index}.png", np.where(tool_mask(share), 31, 0).astype(np.uint8))
    np.testing.assert_array_equal(follow_clip(PulledClip(own.frames, own.masks, tool_value=31)).points, expected)


def test_masks_beside_the_frames_are_found(tmp_path: Path) -> None:
    """A clip in CholecSeg8k's layout, one of its masks missing."""
    clip = write_clip(tmp_path / "clip", 5, 0)
    (clip / "frame_13_endo_color_mask.png").unlink()
    follow = follow_clip(PulledClip(clip))
    columns, rows = follow.points.T
    tool = (columns > 64) & (columns < 96) & (rows < 46)
    assert tool.sum() == 0  # nowhere nearer than the margin to columns 70 to 89, rows 0 to 41
    assert len(follow.frames) == 3
    (sentence,) = follow.unreadable
    assert sentence.startswith("frame 13: ")
    assert "frame_13_endo_color_mask.png does not exist; add the mask of frame 13" in sentence


def test_frames_that_can_t_be_used_are_left_out_and_told(own: PulledClip) -> None:
    assert own.masks is not None
    (own.frames / "004.png").write_bytes(b"none")
    write(own.masks / "008.png", np.zeros((50, 60), np.uint8))
    with_two = follow_clip(own)
    assert len(with_two.frames) == 1
    assert "004.png can't be decoded" in with_two.unreadable[0]
    assert with_two.unreadable[1].endswith("Its mask is of another size than its picture.")
    (own.masks / "012.png").unlink()
    with pytest.raises(InputError, match="frames has fewer than two frames that can be used; give more of them"):
        follow_clip(own)


def test_fewer_masks_than_frames_are_told(own: PulledClip) -> None:
    assert own.masks is not None
    (own.masks / "012.png").unlink()
    follow = follow_clip(own)
    assert len(follow.frames) == 2
    assert follow.unreadable == [f"frame 3: {own.masks} holds 3 masks, none for this frame."]


def test_a_folder_without_masks_is_a_sentence(own: PulledClip, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for masks, told in (
        (tmp_path / "no", "no is no folder; give the one of the masks, in the pictures' order"),
        (tmp_path / "empty", "empty holds no masks; give a folder of pictures whose tool has the value 7"),
    ):
        with pytest.raises(InputError, match=told):
            follow_clip(PulledClip(own.frames, masks, tool_value=7))


def test_a_first_frame_without_a_tool_or_tissue_is_a_sentence(own: PulledClip) -> None:
    with pytest.raises(InputError, match=r"shows no instrument where the judged part begins; choose another"):
        follow_clip(PulledClip(own.frames, own.masks, tool_value=99))
    write(own.frames / "000.png", np.zeros((176, 240, 3), np.uint8))
    with pytest.raises(InputError, match=r"shows no tissue away from the instrument where"):
        follow_clip(own)


def test_no_frames_are_a_sentence(own: PulledClip, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no can't be opened"):
        follow_clip(PulledClip(tmp_path / "no", own.masks))
    for part in ({"start": 3}, {"start": 9}, {"stop": 1}):
        with pytest.raises(InputError, match="fewer than two frames"):
            follow_clip(PulledClip(own.frames, own.masks, **part))


def test_nothing_to_fit_is_a_sentence(own: PulledClip) -> None:
    """Of three frames after the first, one is in the first half, which is too few."""
    with pytest.raises(NothingMoves, match="In 1 of 1 frames the tissue moves"):
        evaluate_pull(own)


def test_tissue_that_is_let_go_is_told(tmp_path: Path) -> None:
    """The first half is fitted all the same."""
    told = evaluate_pull(PulledClip(*write_pull(tmp_path, np.r_[np.linspace(0, 1, 7), np.zeros(6)]))).measures
    assert told["status"] == "nothing moves in the second half"
    assert told["frames judged"] == 0
    assert 0.001 < told["foundation over stiffness"] < 1
    assert not [name for name in told if "skill" in name or "bands" in name]


@pytest.mark.slow
def test_a_real_clip_is_predicted(real_data: Path) -> None:
    """Half a minute: sixteen frames of half a megapixel."""
    clip = real_data / "recover_tissue"
    if not clip.is_dir():
        pytest.skip(f"{clip} is not there")
    told = evaluate_pull(PulledClip(clip / "img_left", clip / "tool_mask")).measures
    assert told["frames judged"] == 8
    assert told["skill of nearby, field, mean"] >= 0.74
    assert told["skill of all, field, mean"] >= 0.67
    assert 0.80 <= told["points within the 90 % bands"] <= 0.98


def test_without_masks_the_grip_is_told_by_the_automatic_ones_or_by_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The better of both; where the automatic masks show nothing, most motion is at the tool's tip."""
    folders = write_pull(tmp_path, np.linspace(0, 2, 9))
    drawn = follow_clip(PulledClip(*folders))
    chosen = follow_clip(PulledClip(folders[0]))
    assert drawn.grip == "masks"
    assert _expected_skill(chosen) > 0.8 * _expected_skill(drawn) > 0.4
    monkeypatch.setattr("evaluation.real.pulled._found_tools", lambda _: lambda _: np.zeros((176, 240), bool))
    follow = follow_clip(PulledClip(folders[0]))
    assert follow.grip == "motion"
    middle = follow.points[follow.frames[-1].gripped].mean(axis=0)
    assert np.linalg.norm(middle - [80, 88]) < 40
    assert follow.distance.min() > MARGIN
    assert follow.frames[-1].tells


def test_an_instrument_that_the_masks_find_later_tells_the_grip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the last frame of the first half alone, when the camera has moved all of the picture besides."""
    shares = np.linspace(0, 4, 9)
    folders = write_pull(tmp_path, shares, (0.0, 4.0))

    def found(_: Path) -> Callable[[Frame], np.ndarray]:
        return lambda frame: tool_mask(shares[4]) if frame.index == 4 else np.zeros((176, 240), bool)

    monkeypatch.setattr("evaluation.real.pulled._found_tools", found)
    follow = follow_clip(PulledClip(folders[0], camera=True))
    assert follow.grip == "masks"
    # From where a point began, the tool has gone as far as the tissue that it holds; at its edge some are dragged.
    gone = tissue_motion(follow.points.astype(float), shares[4]) + np.array([0, 4.0 * shares[4]])
    expected = values_at(tool_distance(tool_mask(shares[4])), follow.points + gone)
    near = expected < 40
    assert (np.abs(follow.distance - expected)[near] <= 2).mean() > 0.9
