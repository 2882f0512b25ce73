"""A pull is found where it is, though tissue nearer to a moving camera moves more."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.grip.driver import APART, COARSER, LEAST_AROUND, find_driver
from estimators.grip.lattice import lattice_springs
from physics.sheet import equilibrium

SPACING = 8
RATIO = 0.01
"""Of foundation to springs between points: motion dies away over 139 px."""


def grid() -> np.ndarray:
    rows, columns = np.mgrid[8:320:8, 8:480:8]
    return np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float32)


def pulled(points: np.ndarray, place: tuple[float, float], way: tuple[float, float]) -> np.ndarray:
    """A sheet whose points within 16 px of a place are held at a displacement."""
    held = np.linalg.norm(points - place, axis=1) <= 16
    springs = lattice_springs(points, SPACING)
    motion = np.tile(way, (held.sum(), 1))
    return equilibrium(springs, np.ones(len(springs)), np.full(len(points), RATIO), held, motion).displacement


def camera(points: np.ndarray) -> np.ndarray:
    """Zoom, turn, shift, and tissue that curves away."""
    middle = points - [240, 160]
    return middle @ [[0.03, -0.02], [0.02, 0.03]] + [14, -9] + 1.5e-4 * np.square(middle)


def nearer(points: np.ndarray) -> np.ndarray:
    """Parallax of a flat piece at the picture's right edge, which ends sharply."""
    return np.where((points[:, :1] > 420) & (points[:, 1:] > 60) & (points[:, 1:] < 160), [16.0, 6.0], 0.0)


def test_a_pull_under_a_still_camera_is_found_where_it_is() -> None:
    """The sheet is the one that is tried; the grip is one of the places."""
    points = grid()
    found = find_driver(points, SPACING, pulled(points, (136, 184), (10, 7)), camera=False)
    assert found is not None
    np.testing.assert_array_equal(found.place, [136, 184])
    assert found.left < 0.5


@pytest.mark.parametrize("place", [(120, 200), (200, 160)])
def test_a_pull_is_found_under_a_moving_camera(place: tuple[int, int]) -> None:
    points = grid()
    own = pulled(points, place, (10, 7))
    moved = own + camera(points) + nearer(points) + np.random.default_rng(0).normal(0, 0.2, points.shape)
    moved[::11] = np.nan
    found = find_driver(points, SPACING, moved, camera=True)
    assert found is not None
    assert np.linalg.norm(found.place - place) <= APART * COARSER * SPACING
    assert found.left < 0.85
    # Beside the background the tissue there moves most of what is held, and along it.
    held = np.linalg.norm(points - place, axis=1) <= 16
    assert np.nanmean(found.own[held], axis=0) == pytest.approx(np.array([10, 7]), rel=0.5)
    far = (np.linalg.norm(points - place, axis=1) > 200) & (points[:, 0] <= 400)
    assert np.nanmedian(np.linalg.norm(found.own[far], axis=1)) < 2
    np.testing.assert_array_equal(np.isnan(found.own), np.isnan(moved))


def test_a_camera_alone_leaves_what_it_left_before() -> None:
    """Noise isn't explained by holding a sheet anywhere."""
    points = grid()
    moved = camera(points) + np.random.default_rng(1).normal(0, 0.2, points.shape)
    found = find_driver(points, SPACING, moved, camera=True)
    assert found is not None
    assert 0.95 < found.left < 1


def test_motion_that_a_background_explains_exactly_is_left_alone() -> None:
    points = grid()
    found = find_driver(points, SPACING, np.zeros(points.shape), camera=False)
    assert found is not None
    np.testing.assert_allclose(found.own, 0, atol=1e-9)


def test_too_few_points_have_no_driver() -> None:
    points = grid()
    moved = np.full(points.shape, np.nan)
    nodes = np.flatnonzero((np.rint(points / SPACING).astype(int) % COARSER == 0).all(axis=1))
    moved[nodes[: LEAST_AROUND - 1]] = 1.0
    assert find_driver(points, SPACING, moved, camera=True) is None
