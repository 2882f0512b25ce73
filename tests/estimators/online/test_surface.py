"""Volumes of particles below the tissue of a frame, and what a mask pins of it."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from palpate.data.labels import OTHER, TISSUE
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.online.given import Pins
from palpate.estimators.online.surface import Surface, facing, make_surface, uncovered
from tests.estimators.online.test_driven import CAMERA, DEPTH, GEOMETRY, HEIGHT, PER_PIXEL, WIDTH, first_frame, path_at
from tests.physics.pbd.particles import sheet

THICKNESS, PARTICLES = 0.1, 300


@pytest.fixture(scope="module")
def volume() -> Surface:
    return make_surface(first_frame(), CAMERA, GEOMETRY, PARTICLES, THICKNESS)


def right_pins(beyond: int) -> Pins:
    """What lies right of a column."""
    return Pins(Path("pins.png"), np.broadcast_to(np.arange(WIDTH) > beyond, (HEIGHT, WIDTH)))


def test_layers_lie_along_the_normal_as_far_apart_as_particles_are(volume: Surface) -> None:
    rest, count = volume.body.rest, len(volume.seen)
    layers = len(rest) // count
    assert 0.7 * PARTICLES < len(rest) < 1.3 * PARTICLES
    np.testing.assert_array_equal(volume.seen, np.arange(count))
    for layer, places in enumerate(rest.reshape(layers, count, 3)):
        np.testing.assert_allclose(places[:, :2], rest[:count, :2], atol=1e-6)
        np.testing.assert_allclose(places[:, 2], DEPTH + THICKNESS * layer / (layers - 1), atol=1e-6)
    across = PER_PIXEL * np.sqrt(WIDTH * HEIGHT / count)
    assert 0.6 < across / (THICKNESS / (layers - 1)) < 1.6
    one, two, three = rest[volume.faces].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(two - one, three - one), axis=1).sum() / 2
    assert volume.body.layout.rest[volume.body.kinds[1]].sum() == pytest.approx(THICKNESS * area, rel=1e-6)
    np.testing.assert_allclose(volume.project(rest), volume.pixels, atol=1e-9)


def test_the_tool_moves_the_surface_and_the_edge_is_pinned_through(volume: Surface) -> None:
    count = len(volume.seen)
    sheet = make_surface(first_frame(), CAMERA, GEOMETRY, PARTICLES * count // len(volume.body.rest))
    assert volume.gripped.max() < count
    np.testing.assert_array_equal(volume.gripped, sheet.gripped)
    for layer in volume.body.pinned.reshape(-1, count):
        np.testing.assert_array_equal(layer, sheet.body.pinned)
    lowest = volume.body.pinned[-count:]
    assert 0 < lowest.sum() < 0.5 * count


def test_a_bent_surface_is_followed_along_smoothed_normals() -> None:
    """Of a cylinder along the rows, whose axis is behind it; and bumps finer than the volume is thick don't matter."""
    frame = first_frame()
    columns = np.arange(frame.depth.shape[1])
    bent = 0.5 + 0.25 * (1 - np.sqrt(1 - np.square((columns - 59.5) / 120)))
    bumps = np.random.default_rng(0).normal(0, 0.002, frame.depth.shape)
    for depth in (bent + 0 * bumps, bent + bumps):
        frame.depth = depth.astype(np.float32)
        found = make_surface(frame, CAMERA, GEOMETRY, PARTICLES, THICKNESS)
        rest, count = found.body.rest, len(found.seen)
        below = rest[-count:] - rest[:count]
        np.testing.assert_allclose(np.linalg.norm(below, axis=1), THICKNESS, rtol=1e-6)
        side = np.abs(rest[:count, 0]) > 0.1
        inward = -np.sign(rest[:count, 0]) * below[:, 0]
        assert (inward[side] > 0).all()
        assert inward[side].mean() > 0.01


def test_white_is_pinned_with_all_below_and_nothing_else() -> None:
    for thickness in (None, THICKNESS):
        found = make_surface(first_frame(), CAMERA, GEOMETRY, PARTICLES, thickness, right_pins(200))
        upper = found.pixels[found.seen, 0] > 200.5
        assert upper.any()
        np.testing.assert_array_equal(found.body.pinned, np.tile(upper, len(found.body.rest) // len(found.seen)))


def test_what_the_tool_holds_is_not_pinned_and_a_mask_that_pins_no_tissue_is_a_sentence() -> None:
    found = make_surface(first_frame(), CAMERA, GEOMETRY, PARTICLES, None, right_pins(-1))
    np.testing.assert_array_equal(np.flatnonzero(~found.body.pinned), found.gripped)
    sentence = r"pins\.png is white at none of the \d+ particles of free tissue in frame 7; paint wider areas there\."
    with pytest.raises(NoEstimate, match=sentence):
        make_surface(first_frame(), CAMERA, GEOMETRY, PARTICLES, None, right_pins(WIDTH))


@pytest.mark.parametrize(("particles", "several"), [(PARTICLES, True), (30, False)])
def test_the_tissue_where_a_path_begins_is_gripped_and_the_rest_is_not(particles: int, several: bool) -> None:
    """Within 24 px of it, or the nearest particle where none is; the instrument's mask doesn't count then."""
    before = make_surface(first_frame(), CAMERA, GEOMETRY, particles, THICKNESS)
    face = before.pixels[before.faces[-1]]
    place = 0.52 * face[0] + 0.48 * face[np.linalg.norm(face - face[0], axis=1).argmax()]
    found = make_surface(first_frame(), CAMERA, GEOMETRY, particles, THICKNESS, path=path_at(*place))
    apart = np.linalg.norm(found.pixels[found.seen] - place, axis=1)
    assert (apart.min() < 24) == several
    np.testing.assert_array_equal(found.gripped, np.flatnonzero(apart < 24) if several else [apart.argmin()])
    assert not found.body.pinned[found.gripped].any()


def test_with_a_path_the_instrument_may_be_far_from_the_tissue() -> None:
    frame = first_frame()
    left = frame.view[1][:, :120]  # the grid's labels are some of these
    left[left == TISSUE] = OTHER
    with pytest.raises(NoEstimate, match=r"No tissue lies within 24 px of the instrument in frame 7\."):
        make_surface(frame, CAMERA, GEOMETRY, PARTICLES)
    found = make_surface(frame, CAMERA, GEOMETRY, PARTICLES, path=path_at(200, 80))
    assert np.linalg.norm(found.pixels[found.gripped] - (200, 80), axis=1).max() <= 24


@pytest.mark.parametrize("slope", [0.0, 0.001])
def test_a_thickness_of_no_volume_is_a_sentence(slope: float) -> None:
    """Of which rounding leaves nothing, or of a slope some prisms."""
    frame = first_frame()
    frame.depth += np.float32(slope) * np.arange(frame.depth.shape[1], dtype=np.float32)
    with pytest.raises(NoEstimate, match=r"with a thickness of 1e-17 in the depth's unit; give the tissue's"):
        make_surface(frame, CAMERA, GEOMETRY, PARTICLES, 1e-17)


def test_distances_are_told_in_pixels_of_the_clip() -> None:
    """Whose pictures are followed at most 854 px wide."""
    small, share = first_frame(), 8
    picture, labels = (image.repeat(share, axis=0).repeat(share, axis=1) for image in small.view)
    frame = dataclasses.replace(small, frame=dataclasses.replace(small.frame, image=picture), picture_labels=labels)
    camera = CAMERA.scaled(share * WIDTH, share * HEIGHT)
    outside = path_at(share * WIDTH + 1000, share * HEIGHT / 2)
    with pytest.raises(NoEstimate, match=r"path\.csv is 1\d\d\d px away from all tissue in frame 7"):
        make_surface(frame, camera, GEOMETRY, PARTICLES, path=outside)


BODY = sheet(9, 8)
REST = BODY.rest - BODY.rest.mean(axis=0) + [0, 0, 0.2]


FOLDED = np.where(REST[:, 1:2] > 1e-9, REST * [1, -0.98, 1] - [0, 0, 0.003], REST)
"""The rows beyond the middle one laid back over the others, 3 mm nearer to the camera; not particle on particle."""


def hidden_by_brute_force(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Every particle against every triangle, by where its line of sight meets the triangle's plane."""
    found = np.zeros(len(points), bool)
    for face in faces:
        one, two, three = points[face]
        normal = np.cross(two - one, three - one)
        inverse = np.linalg.pinv(np.stack([two - one, three - one], axis=1))
        for index, point in enumerate(points):
            if index in face or abs(normal @ point) < 1e-15:
                continue
            share = (normal @ one) / (normal @ point)
            u, v = inverse @ (share * point - one)
            found[index] |= 0 < share < 1 - 1e-9 and min(u, v, 1 - u - v) > 1e-6
    return found


def test_a_sheet_is_seen_whole_wherever_it_lies_and_moves_a_little():
    moved = REST + [0.01, -0.004, 0.02] + 5e-4 * np.random.default_rng(0).normal(size=REST.shape)
    for points in (REST, moved):
        assert facing(points, REST, BODY.faces).all()
        assert uncovered(points, BODY.faces).all()


def test_what_is_folded_over_faces_away_and_covers_what_lies_below():
    rows = REST[:, 1]
    seen = facing(FOLDED, REST, BODY.faces)
    assert seen[rows < 1e-9].all()
    assert not seen[rows > 1e-9].any()
    hidden = ~uncovered(FOLDED, BODY.faces)
    inner = np.abs(REST[:, 0]) < np.abs(REST[:, 0]).max() - 1e-9
    under = (rows < -1e-3) & (rows > rows.min() + 1e-3)
    assert hidden[under & inner].all()
    assert not hidden[rows > 1e-9].any()


def test_it_is_that_of_brute_force():
    random = np.random.default_rng(1)
    for points in (FOLDED, REST + random.normal(0, 0.01, REST.shape)):
        expected = hidden_by_brute_force(points, BODY.faces)
        assert 0.1 < expected.mean() < 0.9
        np.testing.assert_array_equal(~uncovered(points, BODY.faces), expected)


def test_what_lies_behind_the_camera_is_not_seen():
    points = REST.copy()
    points[:8, 2] = -0.1
    seen = uncovered(points, BODY.faces)
    assert not seen[:8].any()
    assert seen[8:].all()
    assert not uncovered(-REST, BODY.faces).any()
