"""A pressed plane under a light at the camera: what pixels show, and how that depends on every parameter."""

import numpy as np

from palpate.data.shading.light import FINE
from palpate.data.shading.sequence import MARGIN, REACH
from palpate.data.source.camera import Camera, back_project
from palpate.observations.lit_sheet import PLACING, SIDE, LitSheet, Shown
from palpate.physics.mesh import grid_mesh
from palpate.physics.shading import exchanged, log_brightness

CAMERA = Camera(fx=185.0, fy=185.0, cx=106.5, cy=59.5, width=214, height=120)
PLAIN = np.array([0.0, 0.0, 0.0, 0.0, np.log(0.53), np.log(0.1), np.log(0.13), 0.0])
"""Dent at its place, no tilt, rounded off; light that hardly spreads, Lambert's law."""


def lit(tilt=(0.0, 0.0), rest: np.ndarray | None = None) -> LitSheet:
    """Sheet of tissue at z = 0.6, pressed at row 50 and column 80."""
    mesh = grid_mesh(back_project(np.full((120, 214), 0.6), CAMERA), np.ones((120, 214), bool))
    side = FINE * SIDE
    rest = np.zeros((3, side, side)) if rest is None else rest
    return LitSheet(mesh, int(np.flatnonzero((mesh.pixels == [50, 80]).all(axis=1))[0]), rest, np.array(tilt))


def dented(sheet: LitSheet, depth: float, width: float = 2.0) -> np.ndarray:
    """Displacements of its vertices along the normal, a Gaussian of so many grid pixels, shape [1, V, 3]."""
    away = sheet.mesh.pixels[sheet.vertices] - sheet.pixel
    shape = depth * np.exp(-0.5 * np.square(away).sum(axis=1) / width**2)
    return -shape[None, :, None] * sheet.normal


def shown(sheet: LitSheet, moved: np.ndarray, others: np.ndarray) -> Shown:
    """What pixels show under all parameters."""
    return sheet.shown(sheet.placed(moved, others[:PLACING]), others[PLACING:])


def test_at_rest_nothing_changes_and_every_pixel_shows_itself():
    texture = np.random.default_rng(1).normal(size=(3, FINE * SIDE, FINE * SIDE))
    sheet = lit((0.2, -0.1), texture)
    others = PLAIN + np.array([0, 0, 0.2, -0.1, 0, 0, 0, 0.2])
    found = shown(sheet, np.zeros((2, len(sheet.vertices), 3)), others)
    np.testing.assert_allclose(found.rest, np.tile(texture[:, sheet.inner].ravel(), (2, 1)), atol=1e-9)
    np.testing.assert_allclose(found.matt, 1, atol=1e-9)
    np.testing.assert_allclose(found.gloss, found.gloss_at_rest, rtol=0.01)
    np.testing.assert_allclose(found.received, 0, atol=1e-9)


def test_a_shallow_dent_darkens_as_the_surface_itself_says():
    sheet, width = lit(), 3.0
    others = PLAIN.copy()
    others[4:6] = np.log(0.05)
    found = np.log(shown(sheet, dented(sheet, 0.004, width), others).matt[0])
    # The same surface, written down on the lattice.
    places = (np.arange(FINE * SIDE) + 0.5) / FINE - 0.5 - REACH - MARGIN
    rows, columns = np.meshgrid(places, places, indexing="ij")
    rays = sheet.rays(np.stack([rows, columns], axis=-1) + sheet.pixel)
    normal = sheet.normal
    plane = sheet.distance * (sheet.ray @ normal) / (rays @ normal)
    sunk = 0.004 * np.exp(-0.5 * (rows**2 + columns**2) / width**2)
    expected = sum(log_brightness(plane + sunk, rays)) - sum(log_brightness(plane, rays))
    # Between vertices the surface is taken as straight.
    np.testing.assert_allclose(found, expected[sheet.inner], atol=0.1 * np.abs(expected).max())
    assert expected.min() < -0.03


def test_a_dent_that_lies_aside_is_the_same_dent_elsewhere():
    sheet = lit()
    moved = dented(sheet, 0.01)
    side = FINE * (2 * REACH + 1)
    others = PLAIN, PLAIN + np.array([2, -1, 0, 0, 0, 0, 0, 0])
    here, there = (np.log(shown(sheet, moved, each).matt).reshape(side, side) for each in others)
    shifted = np.roll(here, (2 * FINE, -FINE), axis=(0, 1))
    assert np.abs(there - here).max() > 0.1
    np.testing.assert_allclose(there[6:-6, 6:-6], shifted[6:-6, 6:-6], atol=0.02)


def test_inside_a_sphere_every_place_receives_the_share_of_the_sphere_that_sends():
    """Form factors within a sphere are the sending area over the whole one, wherever it lies."""
    across = 0.8 * (np.arange(41) - 20) / 20
    x, y = np.meshgrid(across, across)
    depth = 3 + np.sqrt(4 - x**2 - y**2)  # hollow towards the camera
    area = (across[1] - across[0]) ** 2 * 2 / np.sqrt(4 - x**2 - y**2)
    found = exchanged(np.stack([x, y, depth], axis=-1)[None], np.ones((1, 41, 41)))[0]
    expected = (area.sum() - area) / (4 * np.pi * 4)
    np.testing.assert_allclose(found[2:-2, 2:-2], expected[2:-2, 2:-2], rtol=0.01)


def test_walls_of_a_dent_light_each_other_and_a_hill_s_do_not():
    sheet = lit()
    dent, hill = (shown(sheet, dented(sheet, depth), PLAIN).received[0] for depth in (0.02, -0.02))
    assert dent.max() > 0.1
    assert hill.max() < 0.5 * dent.max()
