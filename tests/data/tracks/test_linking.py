"""Places of one picture in another one, and how much two places resemble each other."""

import numpy as np
import pytest

from palpate.data.tracks import linking
from tests.data.tracks.test_following import HEIGHT, WIDTH, shift, texture, warped

PLACES = np.array([[40.0, 40.0], [88.0, 64.0], [120.0, 90.0]], np.float32)
WIDE = np.stack(np.meshgrid(np.arange(20.0, 150, 5), np.arange(20.0, 110, 5)), axis=-1).reshape(-1, 2)


def gray(picture: np.ndarray) -> np.ndarray:
    return picture.mean(axis=2).astype(np.uint8)


def prepared(linker: linking.Linker, *pictures: np.ndarray) -> list[linking.Prepared]:
    return [linker.prepared(gray(picture)) for picture in pictures]


@pytest.mark.parametrize("light", [0, 30])
def test_a_shift_is_found_there_and_back(light: int) -> None:
    """In whichever light."""
    linker = linking.Linker()
    one, other = prepared(linker, texture(1), warped(texture(1), shift(6.0, -4.0)) - np.uint8(light))
    places, returned = linker.link(one, other, PLACES)
    np.testing.assert_allclose(places - PLACES, np.broadcast_to([6.0, -4.0], PLACES.shape), atol=0.25)
    assert returned.max() < 0.2


ALL = np.ones(len(PLACES), bool)


def grid_of(motion: tuple[float, float]) -> np.ndarray:
    """Equal motion at all places of a grid 8 px apart."""
    rows, columns = len(range(8, HEIGHT - 8, 8)), len(range(8, WIDTH - 8, 8))
    return np.broadcast_to(np.float32(motion), (rows, columns, 2))


def test_a_way_that_is_known_roughly_is_found_there_and_back() -> None:
    linker = linking.Linker(spacing=8)
    one, other = prepared(linker, texture(1), warped(texture(1), shift(6.0, -4.0)))
    places, returned = linker.refine(one, other, PLACES, grid_of((5.0, -3.0)), ALL)
    np.testing.assert_allclose(places - PLACES, np.broadcast_to([6.0, -4.0], PLACES.shape), atol=0.1)
    assert returned.max() < 0.2


def test_a_window_that_is_stretched_and_turned_is_found_where_the_motion_is_known_roughly() -> None:
    """By a fifth, and a twelfth of a turn: as it stands a window resembles nothing."""
    slope = np.array([[0.2, 0.5], [-0.5, 0.2]])
    middle = np.array([WIDTH, HEIGHT]) / 2
    still = grid_of((0.0, 0.0))
    linker = linking.Linker(np.ones(still.shape[:2], bool), 8)
    places = 8.0 * (1 + np.indices(still.shape[:2])[::-1].reshape(2, -1).T)
    one, other = prepared(linker, texture(1), warped(texture(1), lambda at: (at - middle) @ slope))
    true = (places - middle) @ slope
    near = np.linalg.norm(places - middle, axis=1) < 30
    off = {}
    for known in (0.0, 0.95):
        guess = (known * true).reshape(still.shape).astype(np.float32)
        there, _ = linker.refine(one, other, places, guess, np.ones(len(places), bool))
        off[known] = np.median(np.linalg.norm(there - places - true, axis=1)[near])
    assert off[0.95] < 0.1
    assert off[0.0] > 1


def test_what_leads_astray_is_not_found() -> None:
    """A guess that is wrong by more than is believed, and a surface without a pattern."""
    linker, still = linking.Linker(spacing=8), grid_of((0.0, 0.0))
    one, other, plain = prepared(linker, texture(1), texture(2), np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    places, returned = linker.refine(plain, plain, PLACES, still, ALL)
    np.testing.assert_array_equal(places, PLACES)
    assert np.isinf(returned).all()
    places, returned = linker.refine(one, other, WIDE, still, np.ones(len(WIDE), bool))
    assert np.abs(places - WIDE).max() <= linking.MAX_STEP
    assert np.isinf(returned).any()


def test_places_at_an_instruments_edge_count_only_for_one_another() -> None:
    """Half of the places move by 1 px, those at the edge by 5."""
    grid = np.ones((12, 12), bool)
    linker, columns = linking.Linker(grid, 8), np.tile(np.arange(12), 12)
    step = np.where(columns[:, None] < 6, [1.0, 0.0], [5.0, 0.0]).astype(np.float32)
    found = linker._filtered(step, None, columns < 6)[:, 0]
    np.testing.assert_allclose(found[columns < 6], 1.0, atol=1e-5)
    assert found[columns == 6].max() < 4.9
    assert linker._filtered(step, None)[columns == 5, 0].min() > 1.2


def test_neighbours_on_the_grid_that_are_seen_tell_a_motion_together() -> None:
    """A patch of another picture, unseen: without its neighbours its points go somewhere. The pictures are noisy."""
    rows, columns = np.mgrid[8 : HEIGHT - 8 : 8, 8 : WIDTH - 8 : 8]
    places = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float32)
    now = warped(texture(1), shift(2.0, 1.0))
    now[56:72, 80:96] = texture(3)[56:72, 80:96]
    random, off = np.random.default_rng(2), {}
    one, other = (np.clip(picture + random.normal(0, 4, picture.shape), 0, 255) for picture in (texture(1), now))
    for grid in (None, np.ones(rows.shape, bool)):
        linker = linking.Linker(grid)
        hidden = np.hypot(*(places - [88, 64]).T) < 5
        there, _ = linker.link(*prepared(linker, one.astype(np.uint8), other.astype(np.uint8)), places, ~hidden)
        off[grid is None] = np.linalg.norm(there - places - [2.0, 1.0], axis=1)
    assert hidden.sum() == 1
    assert off[False][hidden] < 0.5 < off[True][hidden]
    assert np.median(off[False]) < 0.7 * np.median(off[True])


def test_the_filter_widens_no_motion_that_dies_away() -> None:
    """A Gaussian turns u = cos(kx) into exp(-k²σ²/2); twice it less a wider one errs in the fourth order only."""
    grid = np.ones((60, 60), bool)
    linker = linking.Linker(grid, 8)
    columns = np.tile(np.arange(60.0), 60)
    for wave in (0.2, 0.4):
        motion = np.column_stack([np.cos(wave * columns), np.sin(wave * columns)]).astype(np.float32)
        inner = (columns > 6) & (columns < 53)
        left = (linker._filtered(motion, None)[inner] / motion[inner]).mean(axis=0)
        window = 1 + (linking.WINDOW / 8 * wave) ** 2 / 24  # which windows take off, and the filter gives back
        np.testing.assert_allclose(left, window, atol=2 * (wave**2 / 2) ** 2)
        assert np.abs(left - window).max() < 0.3 * (1 - np.exp(-(wave**2) / 2))


def alike(one: np.ndarray, other: np.ndarray, places: np.ndarray) -> np.ndarray:
    """How much the same places of two pictures resemble each other."""
    return linking.resemblance(linking.patterns(one, places), linking.patterns(other, places))


def test_resemblance_is_the_correlation_of_the_patterns() -> None:
    """By hand, and whatever the light: half as bright is the same pattern, its negative the opposite."""
    one, other = gray(texture(1)), gray(texture(2))
    steps = np.arange(-linking.REACH, linking.REACH + 1, linking.STEP)
    for place in PLACES.astype(int):
        columns, rows = np.meshgrid(place[0] + steps, place[1] + steps)
        expected = np.corrcoef(one[rows, columns].ravel(), other[rows, columns].ravel())[0, 1]
        assert alike(one, other, place[None]) == pytest.approx(expected, abs=1e-4)
    assert alike(one, one // 2, PLACES) == pytest.approx(1, abs=0.01)
    assert alike(one, 255 - one, PLACES) == pytest.approx(-1, abs=1e-5)


def test_places_on_plain_tissue_are_known_not_to_be_followed() -> None:
    """Those that are left out are the very ones that following loses, so that leaving them out changes nothing."""
    picture = texture(1)
    picture[:, WIDTH // 2 :] = 120
    one, other = gray(picture), gray(warped(picture, shift(1.0, 0.0)))
    usable = linking.textured(one, WIDE)
    column = WIDE[:, 0]
    assert usable[column < WIDTH / 2 - 10].all()
    assert not usable[column > WIDTH / 2 + 10].any()
    known = linking.followed(one, other, WIDE)[1]
    assert not known[~usable].any()
    np.testing.assert_array_equal(linking.followed(one, other, WIDE[usable])[1], known[usable])
    assert linking.textured(one, WIDE[:0]).shape == (0,)
