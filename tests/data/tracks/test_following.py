"""Points followed through drawn pictures that move as stated, and the reasons for which a point is lost."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from palpate.data.labels import TISSUE, TOOL
from palpate.data.tracks import following
from palpate.data.tracks.following import RELINKED, SPACING, PointFollower, Shown, lit_field

HEIGHT, WIDTH = 128, 176
NO_TOOL = np.zeros((HEIGHT, WIDTH), bool)
EVERY = slice(SPACING, -SPACING, SPACING)
"""Where points begin, along an axis."""
Motion = Callable[[np.ndarray], np.ndarray]


def texture(seed: int = 0, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """An RGB picture of smoothed noise, bright everywhere."""
    noise = np.random.default_rng(seed).normal(size=(height, width, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.clip(140 + 40 * smooth / smooth.std(), 60, 250).astype(np.uint8)


def warped(picture: np.ndarray, motion: Motion) -> np.ndarray:
    """The picture when every place moves by `motion(place)`; which place came here is found by iteration."""
    here = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).reshape(-1, 2).astype(np.float64)
    source = here.copy()
    for _ in range(30):
        source = here - motion(source)
    maps = source.reshape(HEIGHT, WIDTH, 2).astype(np.float32)
    return cv2.remap(picture, maps[..., 0], maps[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def bulge(share: float) -> Motion:
    """A smooth swelling and a shift, up to about 5 px."""

    def motion(places: np.ndarray) -> np.ndarray:
        off = places - [WIDTH / 2, HEIGHT / 2]
        near = np.exp(-np.square(off).sum(axis=1, keepdims=True) / (2 * 35**2))
        return share * (0.1 * off * near + [3.0, -1.5])

    return motion


def shift(columns: float, rows: float) -> Motion:
    return lambda places: np.broadcast_to([columns, rows], places.shape)


def left_of(column: int) -> np.ndarray:
    return np.broadcast_to(np.arange(WIDTH) < column, (HEIGHT, WIDTH))


def shown(picture: np.ndarray, tool: np.ndarray) -> Shown:
    return Shown.of_view((picture, np.where(tool, TOOL, TISSUE).astype(np.uint8)))


def test_points_are_a_grid_away_from_the_tool() -> None:
    follower = PointFollower(shown(texture(), left_of(40)))
    columns, rows = follower.points.T
    assert follower.spacing == SPACING
    assert (sorted(set(columns)), sorted(set(rows))) == ([*range(48, 161, 8)], [*range(8, 113, 8)])
    np.testing.assert_allclose(follower.distance, columns - 39, atol=0.2)
    assert follower.followed.all()
    np.testing.assert_array_equal(follower.moved, 0)


def after(picture: np.ndarray, following: np.ndarray, tool: np.ndarray = NO_TOOL) -> PointFollower:
    """Points of one picture, followed to another."""
    follower = PointFollower(shown(picture, tool))
    follower.step(shown(following, tool))
    return follower


@pytest.mark.parametrize("frames", [1, 4])
def test_a_smooth_motion_is_followed(frames: int) -> None:
    """Half-resolution flow errs by a tenth of a pixel, so that errors of frames add up."""
    picture = texture(1)
    follower = PointFollower(shown(picture, NO_TOOL))
    for share in np.arange(1, frames + 1) / frames:
        follower.step(shown(warped(picture, bulge(share)), NO_TOOL))
    expected = bulge(1)(follower.points.astype(np.float64))
    assert np.linalg.norm(expected, axis=1).max() > 5
    off = np.linalg.norm(follower.moved - expected, axis=1)[follower.followed]
    assert follower.followed.mean() > 0.9
    assert np.median(off) < 0.15 * frames
    assert np.quantile(off, 0.95) < (0.4 if frames == 1 else 0.6)


def test_points_under_the_tool_are_lost_until_the_first_picture_tells_where_they_are() -> None:
    picture = texture(2)
    follower = PointFollower(shown(picture, NO_TOOL))
    columns = follower.points[:, 0]
    follower.step(shown(picture, left_of(81)))
    seen = columns - 80 > following.TOUCHED
    for _ in range(RELINKED - 2):
        np.testing.assert_array_equal(follower.followed, seen)
        assert np.isnan(follower.moved[columns <= 80]).all()
        np.testing.assert_allclose(follower.moved[columns > 88], 0, atol=0.05)
        np.testing.assert_array_equal(follower.place[columns <= 80], follower.points[columns <= 80])
        follower.step(shown(picture, NO_TOOL))
    follower.step(shown(picture, NO_TOOL))
    assert follower.followed.all()
    np.testing.assert_allclose(follower.moved, 0, atol=0.05)


def test_a_point_behind_the_tool_is_found_where_its_neighbours_went() -> None:
    """A shift under a tool that passes."""
    picture = texture(6)
    follower = PointFollower(shown(picture, NO_TOOL))
    hidden = np.hypot(*(follower.points - [96, 64]).T) < 24
    tool = np.hypot(*np.meshgrid(np.arange(WIDTH) - 96, np.arange(HEIGHT) - 64)) < 30
    for index in range(1, RELINKED):
        now = warped(picture, shift(2.0 * index, -index))
        now[tool] = 30
        follower.step(shown(now, tool))
        assert not follower.followed[hidden].any()
    follower.step(shown(warped(picture, shift(2.0 * RELINKED, -RELINKED)), NO_TOOL))
    assert follower.followed[hidden].mean() > 0.9
    off = np.linalg.norm(follower.moved - [2.0 * RELINKED, -RELINKED], axis=1)[hidden & follower.followed]
    assert np.median(off) < 0.3


def test_another_tissue_is_not_taken_for_a_lost_point() -> None:
    """What appears behind the tool has another pattern."""
    picture, other = texture(2), texture(7)
    follower = PointFollower(shown(picture, NO_TOOL))
    changed = np.where(left_of(81)[..., None], other, picture)
    follower.step(shown(picture, left_of(81)))
    for _ in range(RELINKED - 1):
        follower.step(shown(changed, NO_TOOL))
    assert follower.followed[follower.points[:, 0] <= 72].mean() < 0.05


def test_links_to_the_first_picture_keep_errors_from_adding_up() -> None:
    """There and back by half pixels."""
    picture = texture(8)
    follower, way = PointFollower(shown(picture, NO_TOOL)), (0.0, 0.0)
    for index in range(1, 4 * RELINKED + 1):
        way = 1.5 * np.sin(index), 0.7 * np.cos(index)
        follower.step(shown(warped(picture, shift(*way)), NO_TOOL))
    off = (follower.moved - way)[follower.followed]
    assert np.sqrt(np.square(off).mean()) < 0.12


def test_what_flow_back_does_not_return_is_lost() -> None:
    """Half of the picture becomes another one."""
    follower = after(texture(4), np.where(left_of(WIDTH // 2)[..., None], texture(5), texture(4)))
    columns = follower.points[:, 0]
    changed, same = columns < WIDTH / 2 - 16, columns > WIDTH / 2 + 16
    assert follower.followed[changed].mean() < 0.8
    assert follower.followed[same].all()


def test_a_round_field_is_lit_up_to_its_rim() -> None:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    radius = np.hypot(columns - WIDTH / 2, rows - HEIGHT / 2)
    picture = np.where(radius[..., None] < 55, 90, 6).astype(np.uint8) * np.ones((1, 1, 3), np.uint8)
    lit = lit_field(picture)
    assert lit[radius < 55 - following.RIM // 2 * np.sqrt(2) - 1].all()
    assert not lit[radius > 55 - following.RIM // 2].any()
    assert lit.sum() == (cv2.blur((radius < 55).astype(np.float32), (following.RIM, following.RIM)) > 1 - 1e-4).sum()
    follower = PointFollower(shown(picture, NO_TOOL))
    assert lit[follower.points[:, 1].astype(int), follower.points[:, 0].astype(int)].all()
    assert len(follower.points) == lit[EVERY, EVERY].sum()


def test_wide_pictures_are_shrunk_before_their_points_are_followed() -> None:
    wide = np.repeat(np.random.default_rng(0).integers(40, 250, (300, 1708), np.uint8)[..., None], 3, axis=2)
    wide = cv2.GaussianBlur(wide, (0, 0), 3)
    tool = np.zeros(wide.shape[:2], bool)
    tool[100:200, 800:900] = True
    follower = PointFollower(shown(wide, tool))
    assert follower.points.max(axis=0) == pytest.approx([848, 136], abs=8)
    np.testing.assert_allclose(np.linalg.norm(follower.points - [425, 75], axis=1).min(), 30, atol=8)
    follower.step(shown(np.roll(wide, 4, axis=1), np.roll(tool, 4, axis=1)))
    np.testing.assert_allclose(np.nanmedian(follower.moved, axis=0), [2.0, 0.0], atol=0.1)
