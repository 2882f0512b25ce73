"""Volumes of particles below the tissue of a frame, and what of them the camera sees."""

import numpy as np
import pytest

from palpate.data.labels import OTHER, TISSUE
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.online.surface import Surface, make_surface
from tests.estimators.online.test_driven import CAMERA, DEPTH, GEOMETRY, HEIGHT, PER_PIXEL, WIDTH, first_frame

THICKNESS, PARTICLES = 0.1, 300


@pytest.fixture(scope="module")
def volume() -> Surface:
    return make_surface(first_frame(), CAMERA, GEOMETRY, PARTICLES, THICKNESS)


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
    """A cylinder along the rows, whose axis is behind it; and bumps finer than the volume is thick don't matter."""
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


def test_an_instrument_far_from_the_tissue_is_a_sentence() -> None:
    frame = first_frame()
    left = frame.picture_labels[:, :120]  # the grid's labels are some of these
    left[left == TISSUE] = OTHER
    with pytest.raises(NoEstimate, match=r"No tissue lies within 24 px of the instrument in frame 7\."):
        make_surface(frame, CAMERA, GEOMETRY, PARTICLES)


@pytest.mark.parametrize("slope", [0.0, 0.001])
def test_a_thickness_of_no_volume_is_a_sentence(slope: float) -> None:
    """Rounding leaves nothing of it, or on a slope some prisms."""
    frame = first_frame()
    frame.depth += np.float32(slope) * np.arange(frame.depth.shape[1], dtype=np.float32)
    with pytest.raises(NoEstimate, match=r"with a thickness of 1e-17 in the depth's unit; give the tissue's"):
        make_surface(frame, CAMERA, GEOMETRY, PARTICLES, 1e-17)
