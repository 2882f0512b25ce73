"""Depth from stereo pairs whose depth is known: a texture on a surface, seen by two cameras."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from palpate.data.clip import ClipStream
from palpate.data.depth.normalise import DepthSettings, estimate_scale, open_depth
from palpate.data.depth.sources import DepthSource
from palpate.data.settings import PrepareSettings
from palpate.data.source.camera import Camera, load_camera
from palpate.data.source.frames import FrameSource, open_source
from palpate.data.source.images import read_image
from palpate.data.source.layout import ClipLayout, InputError, load_layout
from palpate.estimators.force_scale import ClipLength

WIDTH, HEIGHT, FOCAL, BASELINE = 740, 540, 732.0, 0.0046
LAYOUT = ClipLayout(image="left/{number}.png", right="right/{number}.png", camera="camera.yaml")
ROWS, COLUMNS = np.indices((HEIGHT, WIDTH), np.float32)
PLANE = 0.08 + 4e-5 * (COLUMNS - 370) + 3e-5 * (ROWS - 270)
CURVED = 0.07 + 0.03 * ((COLUMNS - 370) / 370) ** 2 + 0.01 * np.sin(ROWS / 60)
LEFT = {"fx": FOCAL, "fy": FOCAL, "cx": 369.5, "cy": 269.5, "width": WIDTH, "height": HEIGHT}


def texture(size: int, seed: int = 0) -> np.ndarray:
    """Detail of all sizes from 2 to 32 px, [size, size] float32."""
    generator, found = np.random.default_rng(seed), np.full((size, size), 120, np.float32)
    for step, strength in ((2, 40), (4, 40), (8, 40), (32, 50)):
        cells = generator.uniform(-1, 1, 2 * (size // step + 3,)).astype(np.float32)
        found += strength * cv2.resize(cells, None, fx=step, fy=step, interpolation=cv2.INTER_CUBIC)[:size, :size]
    return found


def seen(values: np.ndarray, seed: int = 0) -> np.ndarray:
    """A picture of some brightness, with the camera's noise, RGB."""
    noisy = values + np.random.default_rng(seed).normal(0, 2, values.shape)
    return np.repeat(np.clip(noisy, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def pair(depth: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The two pictures of a surface with that depth in the left one."""
    disparity, print_ = (FOCAL * BASELINE / depth).astype(np.float32), texture(1000)
    there = COLUMNS + disparity.mean()
    for _ in range(30):
        there = COLUMNS + cv2.remap(disparity, there, ROWS, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    right = cv2.remap(print_, there, ROWS, cv2.INTER_CUBIC)
    return seen(print_[:HEIGHT, :WIDTH], 2 * seed + 1), seen(right, 2 * seed + 2)


def write(folder: Path, pictures: list[tuple[np.ndarray, np.ndarray]], **camera: Any) -> Path:
    """A clip of pairs with its camera file."""
    for name, side in (("left", 0), ("right", 1)):
        (folder / name).mkdir(parents=True)
        for number, both in enumerate(pictures):
            cv2.imwrite(str(folder / name / f"{number}.png"), both[side])
    (folder / "camera.yaml").write_text(yaml.safe_dump(LEFT | {"baseline": BASELINE} | camera))
    return folder


def opened(
    clip: Path, layout: ClipLayout = LAYOUT, settings: DepthSettings | None = None
) -> tuple[DepthSource, FrameSource, float]:
    """A clip's depth with its constants frozen, its pictures, and its scale."""
    source, settings = open_source(clip, layout), settings or DepthSettings("stereo")
    depth = open_depth(settings, layout, source)
    return depth, source, estimate_scale(source, depth, settings)[0]


@pytest.mark.parametrize("surface", [PLANE, CURVED], ids=["plane", "curved"])
def test_depth_is_metric_within_a_percent(tmp_path: Path, surface: np.ndarray) -> None:
    depth, source, scale = opened(write(tmp_path / "clip", [pair(surface)], baseline_sd=0.01 * BASELINE))
    found = depth(next(iter(source)))
    known, hidden = found > 0, FOCAL * BASELINE / surface + 2 > COLUMNS
    error = np.abs(found / surface - 1)[known]
    assert np.median(error) < 0.004
    assert np.quantile(error, 0.95) < 0.01
    assert known[~hidden].mean() > 0.97
    assert known[FOCAL * BASELINE / surface > COLUMNS + 2].mean() < 0.01  # the right picture does not show it
    assert scale == pytest.approx(np.quantile(surface, 0.999), rel=0.02)
    assert depth.metres is not None
    assert depth.metres == (1.0, pytest.approx(math.hypot(0.01, 0.25 / 42), rel=0.05), "stereo")
    assert not depth.warnings


def test_a_clips_scene_unit_is_in_metres_by_stereo(tmp_path: Path) -> None:
    clip = write(tmp_path / "clip", [pair(PLANE)])
    settings = PrepareSettings(DepthSettings("stereo"), layout=LAYOUT)
    stream = ClipStream(open_source(clip, LAYOUT), settings)
    z, length = next(iter(stream)).depth, ClipLength.of(stream)
    assert length.metres is not None
    assert z[60, 100] * length.metres == pytest.approx(PLANE[270, 346], rel=0.01)
    assert length.record["by"] == "stereo"
    assert length.record["mm_low"] < 1000 * stream.scale < length.record["mm_high"]
    assert stream.sources["depth"] == "stereo"


def test_a_pair_shifted_by_whole_pixels_is_one(tmp_path: Path) -> None:
    """Its rows lie exactly level, which is not the same as too few features to tell."""
    print_ = np.repeat(np.clip(texture(1000), 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    depth, source, _ = opened(write(tmp_path / "clip", [(print_[:HEIGHT, :WIDTH], print_[:HEIGHT, 40:780])]))
    found = depth(next(iter(source)))
    assert np.median(found[found > 0]) == pytest.approx(FOCAL * BASELINE / 40, rel=0.004)
    assert not depth.warnings


@pytest.mark.parametrize("across", [True, False], ids=["side-by-side", "top-bottom"])
def test_a_picture_may_hold_both(tmp_path: Path, across: bool) -> None:
    left, right = pair(PLANE)
    clip = tmp_path / "clip"
    clip.mkdir()
    cv2.imwrite(str(clip / "0.png"), np.concatenate([left, right], axis=int(across)))
    (clip / "camera.yaml").write_text(yaml.safe_dump(LEFT | {"baseline": BASELINE}))
    layout = replace(LAYOUT, image="{number}.png", right="side-by-side" if across else "top-bottom")
    depth, source, _ = opened(clip, layout)
    frame = next(iter(source))
    assert source.size == (WIDTH, HEIGHT)
    assert (frame.picture == left).all()
    assert frame.right is not None
    assert (frame.right == right).all()
    found = depth(frame)
    assert np.median(np.abs(found / PLANE - 1)[found > 0]) < 0.004


def test_a_second_video_is_read_in_step(tmp_path: Path) -> None:
    """Each frame has a depth of its own, so that another frame's right picture would show."""
    depths = [0.06, 0.07, 0.08, 0.09]
    for side, name in enumerate(("pull.avi", "pull_right.avi")):
        video = cv2.VideoWriter(str(tmp_path / name), cv2.VideoWriter.fourcc(*"MJPG"), 25, (WIDTH, HEIGHT))
        for number, z in enumerate(depths):
            video.write(pair(np.full_like(PLANE, z), number)[side])
        video.release()
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(LEFT | {"baseline": BASELINE}))
    layout = ClipLayout(right="{name}_right.avi", camera=str(tmp_path / "camera.yaml"))
    depth, source, _ = opened(tmp_path / "pull.avi", layout)
    frames = list(source)
    for index in (0, 1, 2, 3, 1, 3):
        found = depth(frames[index])
        assert np.median(found[found > 0]) == pytest.approx(depths[index], rel=0.01)
    with pytest.raises(InputError, match=r"pull_right.avi has no frame 9; give a right picture for every left one"):
        depth(replace(frames[3], index=9, number=9))
    (tmp_path / "left").mkdir()
    (tmp_path / "pull.avi").rename(tmp_path / "left" / "pull.avi")
    depth, source, _ = opened(tmp_path / "left" / "pull.avi", replace(layout, right="../{name}_right.avi"))
    found = depth(next(iter(source)))
    assert np.median(found[found > 0]) == pytest.approx(0.06, rel=0.01)


def test_a_calibrated_pair_is_rectified_and_its_depth_is_the_left_cameras(tmp_path: Path) -> None:
    """A textured plane, z = 0.08 + 0.3 x in the left camera, seen by two turned cameras with lenses of their own."""
    right = LEFT | {"fx": 760.0, "fy": 755.0, "cx": 380.0, "distortion": [0.05, -0.02, 0.0, 0.0]}
    turn = cv2.Rodrigues(np.radians([1.0, -1.5, 2.0]))[0]
    offset = np.array([-BASELINE, 2e-4, -1e-4])
    left = LEFT | {"distortion": [-0.15, 0.03, 1e-3, 0.0]}
    normal, print_ = np.array([-0.3, 0.0, 1.0]), texture(1600)
    pixels, pictures, truth = np.stack([COLUMNS, ROWS], -1).reshape(-1, 1, 2), [], None
    for entries, turned, moved in ((left, np.eye(3), np.zeros(3)), (right, turn, offset)):
        matrix = Camera(**LEFT | {name: entries[name] for name in ("fx", "fy", "cx")}).matrix
        flat = cv2.undistortPoints(pixels, matrix, np.array(entries["distortion"]))[:, 0]
        rays, centre = np.column_stack([flat, np.ones(len(flat))]) @ turned, -turned.T @ moved
        points = centre + rays * ((0.08 - normal @ centre) / (rays @ normal))[:, None]
        places = (points[:, :2] * 8000 + 800).astype(np.float32).reshape(HEIGHT, WIDTH, 2)
        pictures.append(seen(cv2.remap(print_, *cv2.split(places), cv2.INTER_CUBIC), len(pictures)))
        truth = points[:, 2].reshape(HEIGHT, WIDTH) if truth is None else truth
    told = {"rotation": turn.ravel().tolist(), "translation": offset.tolist(), "right": right, "baseline": None}
    clip = write(tmp_path / "clip", [(pictures[0], pictures[1])], distortion=left["distortion"], **told)
    depth, source, _ = opened(clip)
    found = depth(next(iter(source)))
    known = found > 0
    assert known.mean() > 0.8
    assert np.median(np.abs(found / truth - 1)[known]) < 0.006
    assert not depth.warnings


def test_rows_a_little_off_are_brought_together_and_that_is_said(tmp_path: Path) -> None:
    left, right = pair(PLANE)
    move = cv2.getRotationMatrix2D((369.5, 269.5), 0.3, 1.0)
    move[1, 2] += 3.0
    clip = write(
        tmp_path / "clip", [(left, cv2.warpAffine(right, move, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT))]
    )
    depth, source, _ = opened(clip)
    found = depth(next(iter(source)))
    assert np.median(np.abs(found / PLANE - 1)[found > 0]) < 0.006
    apart = re.search(r"lie up to ([\d.]+) px off those of the left ones", depth.warnings[0])
    assert apart is not None
    assert float(apart[1]) == pytest.approx(3 + 369.5 * math.radians(0.3), abs=0.5)
    assert depth.metres is not None
    assert depth.metres[1] == pytest.approx(float(apart[1]) / 42, rel=0.1)  # as much may be off across rows


def test_noise_falls_from_frame_to_frame_and_what_moves_is_not_held_back(tmp_path: Path) -> None:
    still = [pair(PLANE, seed) for seed in range(8)]
    depth, source, _ = opened(write(tmp_path / "clip", [*still, pair(PLANE + 0.003)]))
    frames = list(source)
    steadied = np.stack([depth(frame) for frame in frames])
    alone = np.stack([depth(frames[index]) for index in (7, 5, 3, 1)])
    known = (steadied[4:8] > 0).all(axis=0) & (alone > 0).all(axis=0)
    assert np.median(steadied[4:8].std(axis=0)[known]) < 0.8 * np.median(alone.std(axis=0)[known])
    moved = (steadied[8] - steadied[7])[known & (steadied[8] > 0)]
    assert np.median(moved) == pytest.approx(0.003, rel=0.05)


TURNED = [0, -1, 0, 1, 0, 0, 0, 0, 2]


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        ({"baseline": 0}, "baseline is 0; give a positive number"),
        ({"baseline": 100 * BASELINE}, "m away by its camera's baseline; give that in metres"),
        ({"baseline": 4.6}, "its cameras are 4.6 m apart; give metres, not millimetres"),
        ({"baseline": None}, "has no camera with a baseline; give a camera file with one, in metres"),
        ({"translation": [-0.004, 0, 0]}, "baseline and translation both tell where the right camera is; give one"),
        ({"baseline": None, "translation": [0.004, 0, 0]}, "translation leads to no negative x"),
        ({"rotation": TURNED}, "rotation is no rotation; give its nine numbers row by row"),
        ({"right": 3}, "right, is not a mapping of names to values"),
    ],
)
def test_a_camera_file_that_can_t_be(tmp_path: Path, camera: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        opened(write(tmp_path / "clip", [pair(PLANE)], **camera))


def test_pictures_that_are_no_pair_are_answered_with_a_sentence(tmp_path: Path) -> None:
    left, right = pair(PLANE)
    with pytest.raises(InputError, match=r"clip has no right pictures; say in a layout file where they are"):
        opened(write(tmp_path / "a" / "clip", [(left, right)]), replace(LAYOUT, right=None))
    with pytest.raises(InputError, match=r"is a folder and layout.right is 'right.mp4'; write \{number\} in it"):
        opened(tmp_path / "a" / "clip", replace(LAYOUT, right="right.mp4"))
    with pytest.raises(InputError, match=r"right/0.png is 370x270 while its left picture is 740x540; give both at one"):
        opened(write(tmp_path / "b" / "clip", [(left, cv2.resize(right, (370, 270)))]))
    with pytest.raises(InputError, match=r"is not rectified \(its rows are up to 30 px apart\); rectify it"):
        opened(write(tmp_path / "c" / "clip", [(left, np.roll(right, 30, axis=0))]))
    swapped = {"e": (right, left), "f": (seen(texture(1000)[:HEIGHT, 40:780]), seen(texture(1000)[:HEIGHT, :WIDTH]))}
    for folder, both in swapped.items():
        with pytest.raises(InputError, match=r"Left and right pictures of .*clip are swapped; exchange them"):
            opened(write(tmp_path / folder / "clip", [both]))
    depth, _, _ = opened(write(tmp_path / "g" / "clip", [(left, seen(texture(1000, 5)[:HEIGHT, :WIDTH]))]))
    assert "share too few features to compare rows; look whether they are a pair" in depth.warnings[0]
    assert depth.metres is None
    clip = write(tmp_path / "d" / "clip", 3 * [(left, right)])
    (clip / "right" / "1.png").unlink()
    depth, source, _ = opened(clip)
    frames = list(source)
    assert depth(frames[2]).any()
    with pytest.raises(InputError, match=r"right/1.png can't be read \(No such file or directory\); check the file"):
        depth(frames[1])


def test_stored_depth_is_metric_by_the_camera_file(tmp_path: Path) -> None:
    clip = write(tmp_path / "clip", [pair(PLANE)], metres_per_depth=0.001, metres_per_depth_sd=2e-5)
    np.save(clip / "0.npy", 1000 * PLANE)
    layout = replace(LAYOUT, depth="{number}.npy", right=None)
    depth, _, scale = opened(clip, layout, DepthSettings("stored"))
    assert depth.metres == (0.001, pytest.approx(0.02), "the camera file")
    assert scale == pytest.approx(1000 * np.quantile(PLANE, 0.999), rel=2e-3)


def features(left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where features lie in the left picture, and by how much farther left in the right one [px], shape [n] each."""
    finder = cv2.SIFT.create(4000, contrastThreshold=0.01)
    here, there = (finder.detectAndCompute(picture, None) for picture in (left, right))
    pairs = cv2.BFMatcher(crossCheck=True).match(here[1], there[1])
    found = np.array([here[0][pair.queryIdx].pt for pair in pairs])
    across, down = (found - np.array([there[0][pair.trainIdx].pt for pair in pairs])).T
    near = np.abs(down - np.median(down)) < 3
    columns, rows = found[near].round().astype(int).T
    return columns, rows, across[near]


def test_a_real_pair_agrees_with_the_disparity_of_a_network(real_data: Path) -> None:
    """Most of the difference is 0.8 px of disparity, the same in every frame, that features have as our depth does.

    Features matched one by one, in pictures as they are, lie nearer to our depth than to the network's, and 2.0 to
    2.3 % of its disparity away: the network's own error leaves no room to agree with it within 2 %.
    """
    layout = load_layout(Path(__file__).parents[3] / "configs" / "layouts" / "recover_tissue.yaml")
    depth, source, _ = opened(real_data / "recover_tissue", layout)
    assert "were brought together by features" in depth.warnings[0]
    product = load_camera(layout.camera or "").fx * 0.004552
    for frame in list(source)[::5]:
        given = np.load(source.path / "disp" / f"{frame.number:04d}.npz")["disparity"]
        tissue = cv2.imread(str(source.path / "tool_mask" / f"{frame.number:04d}.png"), cv2.IMREAD_GRAYSCALE) == 1
        found = depth(frame)
        known = (found > 0) & (given > 0) & tissue
        own = product / found[known]
        assert known.sum() > 0.9 * ((given > 0) & tissue).sum()
        assert np.median(np.abs(given[known] / own - 1)) < 0.024
        shared = np.median(own - given[known])
        assert np.median(np.abs((given[known] + shared) / own - 1)) < 0.014
        right = read_image(source.path / "img_right" / f"{frame.number:04d}.jpg")
        columns, rows, apart = features(frame.picture, right)
        held = known[rows, columns] & (np.abs(apart - given[rows, columns]) < 4)
        columns, rows, apart = columns[held], rows[held], apart[held]
        assert np.median(np.abs(apart - product / found[rows, columns])) < 0.45
        assert np.median(apart - given[rows, columns]) == pytest.approx(-0.8, abs=0.2)
        off = np.median(np.abs(apart / given[rows, columns] - 1))
        print(f"frame {frame.number}: {off:.2%} by {held.sum()} features")
