"""The sequence of a dent: what the camera did is taken off, what the depth's noise is like is measured far away."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from palpate.data.contact import depth_sequence
from palpate.data.labels import TISSUE, TOOL
from palpate.data.source.camera import Camera, back_project
from palpate.physics.mesh import Mesh, grid_mesh

WIDTH, HEIGHT = 120, 96
CENTRE = np.array([45, 57])
"""Row and column of the contact."""
SIDE = 2 * depth_sequence.KEPT + 1
CAMERA = Camera.from_field_of_view(60, WIDTH, HEIGHT)
SIGMA = 1e-3
STEP = 1 / 255
"""Step of depth in 8 bits."""
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
REST = (0.5 + 0.02 * np.sin(COLUMNS / 31) + 0.0007 * ROWS).astype(np.float32)
TISSUE_ALL = np.full((HEIGHT, WIDTH), TISSUE, np.uint8)


def mesh_of(depth: np.ndarray = REST, valid: np.ndarray | None = None) -> Mesh:
    return grid_mesh(back_project(depth, CAMERA), np.ones(depth.shape, bool) if valid is None else valid, max_edge=1.0)


MESH = mesh_of()
VERTEX = int(np.flatnonzero((MESH.pixels == CENTRE).all(axis=1))[0])


def seen(depth: np.ndarray, labels: np.ndarray = TISSUE_ALL) -> SimpleNamespace:
    """A frame."""
    return SimpleNamespace(depth=depth, labels=labels)


def recorder(sigma: float = SIGMA) -> depth_sequence.SequenceRecorder:
    return depth_sequence.SequenceRecorder(MESH, VERTEX, sigma, (WIDTH, HEIGHT))


def noise_of(frames: np.ndarray, sigma: float = SIGMA) -> depth_sequence.SequenceNoise:
    """Noise as measured in frames of errors [N, H, W] about tissue at rest."""
    made = recorder(sigma)
    for errors in frames:
        assert made.frame(seen(REST + errors)) is not None
    return made.noise(99)


def white(seed: int, count: int = 12) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, HEIGHT, WIDTH))


def blurred(noise: np.ndarray, blur: float) -> np.ndarray:
    """Neighbours mixed, of the same size as before."""
    mixed = gaussian_filter(noise, (0, blur, blur), mode="wrap")
    return mixed / mixed.std()


APART = np.hypot(ROWS - CENTRE[0], COLUMNS - CENTRE[1])
DENT = 0.03 * np.exp(-0.5 * (APART / 4) ** 2) * (APART < depth_sequence.FAR)
"""Around the contact; it ends before the tissue that is far."""
SEEN = DENT[depth_sequence.window_around(CENTRE)]


@pytest.mark.parametrize("motion", [(0, 0, 0), (0.02, 0, 0), (0, 0.01, -0.004), (-0.013, -0.006, 0.009)], ids=str)
def test_scale_and_tilt_of_the_whole_depth_are_taken_off(motion: tuple[float, float, float]) -> None:
    """Relative to the distance, as a camera or a depth network changes them."""
    scale, down, across = motion
    moved = scale + (down * (ROWS - CENTRE[0]) + across * (COLUMNS - CENTRE[1])) / depth_sequence.FAR
    change = recorder().frame(seen(REST * (1 + moved) + DENT))
    assert (change.dtype, change.shape) == (np.float32, (SIDE, SIDE))
    np.testing.assert_allclose(change, SEEN, atol=3e-7 if any(motion) else 2e-7)
    assert SEEN[depth_sequence.KEPT, depth_sequence.KEPT] == pytest.approx(0.03)


def test_what_is_hidden_is_not_a_number() -> None:
    depth, labels = REST + DENT, TISSUE_ALL.copy()
    row, column = CENTRE
    labels[row, column : column + 40] = TOOL
    depth[row - 3, column - 2] = 0
    hidden = np.zeros((SIDE, SIDE), bool)
    hidden[depth_sequence.KEPT, depth_sequence.KEPT :] = True
    hidden[depth_sequence.KEPT - 3, depth_sequence.KEPT - 2] = True
    change = recorder().frame(seen(depth, labels))
    np.testing.assert_array_equal(np.isnan(change), hidden)
    np.testing.assert_allclose(change[~hidden], SEEN[~hidden], atol=2e-7)


@pytest.mark.parametrize("corner", [(3, 2), (HEIGHT - 4, WIDTH - 1)])
def test_outside_the_picture_and_the_mesh_is_not_a_number(corner: tuple[int, int]) -> None:
    valid = (ROWS > 1) | (COLUMNS > 60)
    mesh = mesh_of(valid=valid)
    vertex = int(np.flatnonzero((mesh.pixels == corner).all(axis=1))[0])
    change = depth_sequence.SequenceRecorder(mesh, vertex, SIGMA, (WIDTH, HEIGHT)).frame(seen(REST))
    there = np.pad(valid, depth_sequence.KEPT)[depth_sequence.window_around(np.array(corner) + depth_sequence.KEPT)]
    np.testing.assert_array_equal(np.isfinite(change), there)
    np.testing.assert_allclose(change[there], 0, atol=1e-7)
    assert not there.all()


def test_too_little_far_tissue_tells_nothing_of_the_camera() -> None:
    apart = np.maximum(np.abs(ROWS - CENTRE[0]), np.abs(COLUMNS - CENTRE[1]))
    labels = np.where(apart < depth_sequence.FAR, TISSUE, TOOL).astype(np.uint8)
    made = recorder()
    assert made.frame(seen(REST, labels)) is None
    labels[0, : depth_sequence.MIN_FAR - 100] = labels[-1, :99] = TISSUE
    assert made.frame(seen(REST, labels)) is None
    labels[-1, 99] = TISSUE
    assert made.frame(seen(REST, labels)) is not None


def test_what_is_rounded_stays_in_its_place() -> None:
    rounded = np.rint(REST.astype(np.float64) / STEP) * STEP - REST
    sigma = STEP / math.sqrt(12)
    noise = noise_of(np.repeat(rounded[None], 4, axis=0), sigma)
    assert noise.in_time == pytest.approx(0, abs=1e-3 * sigma)
    assert noise.in_place == pytest.approx(sigma, rel=1e-6)
    # Rounding errors of slanting tissue go together, those of neighbours in one row more than those in one column.
    assert noise.correlated_in_time == 1
    assert noise.correlated_in_place > 2


@pytest.mark.parametrize("share", [0.4, 0.8])
def test_noise_in_time_and_in_place_are_told_apart(share: float) -> None:
    in_place, in_time = SIGMA * math.sqrt(share), SIGMA * math.sqrt(1 - share)
    noise = noise_of(in_time * white(1) + in_place * white(2, 1))
    assert noise.in_time == pytest.approx(in_time, rel=0.01)
    assert noise.in_place == pytest.approx(in_place, rel=0.01)
    assert noise.total == pytest.approx(SIGMA, rel=1e-9)
    assert (noise.correlated_in_time, noise.correlated_in_place) == (1, 1)


@pytest.mark.parametrize("blur", [0.6, 1.0, 1.5])
def test_blurred_noise_makes_neighbours_alike(blur: float) -> None:
    """The sum of all correlations of noise that was blurred with a kernel w is 1/Σw² an axis: about 4πσ² for both."""
    kernel = gaussian_filter1d(np.eye(49)[24], blur)
    expected = np.square(kernel).sum() ** -2
    assert expected == pytest.approx(4 * math.pi * blur**2, rel=0.12)
    new = noise_of(SIGMA * blurred(white(3), blur))
    assert (new.in_time, new.in_place, new.correlated_in_place) == (SIGMA, 0.0, 1.0)
    assert new.correlated_in_time == pytest.approx(expected, rel=0.08)
    still = noise_of(np.repeat(SIGMA * blurred(white(5, 1), blur), 3, axis=0))
    assert still.in_place == pytest.approx(SIGMA, rel=1e-3)
    assert still.correlated_in_place == pytest.approx(expected, rel=0.2)


def test_noise_is_not_that_of_tissue_that_moves() -> None:
    """A few wild pixels, and what another instrument does far away, don't count."""
    frames = SIGMA * white(6)
    frames[3:, :8, :40] += 0.03
    frames[5, 80:, 3] = 0.2
    assert noise_of(frames) == depth_sequence.SequenceNoise(SIGMA, 0.0)


def test_before_a_second_frame_all_noise_counts_as_new() -> None:
    made = recorder()
    for _ in range(2):
        assert made.noise(99) == depth_sequence.SequenceNoise(SIGMA, 0.0)
        made.frame(seen(REST))
    assert made.noise(99) == depth_sequence.SequenceNoise(0.0, pytest.approx(SIGMA), 1.0, 1.0)


def test_a_sequence_holds_frames_times_and_size() -> None:
    made = recorder()
    changes = [made.frame(seen(REST + amount * DENT)) for amount in (0.5, 1.0, 0.25)]
    sequence = made.record(np.array([0.04, 0.08, 0.12]), changes, 2)
    inner = slice(depth_sequence.KEPT - depth_sequence.REACH, depth_sequence.KEPT + depth_sequence.REACH + 1)
    np.testing.assert_array_equal(sequence.around, np.stack(changes))
    np.testing.assert_array_equal(sequence.change, np.stack(changes)[:, inner, inner])
    assert sequence.times.tolist() == [0.04, 0.08, 0.12]
    assert (sequence.size, sequence.noise) == ((WIDTH, HEIGHT), made.noise(99))
    for chosen in (np.array([True, False, True]), np.array([0, 2])):
        part = sequence.chosen(chosen)
        assert part.times.tolist() == [0.04, 0.12]
        np.testing.assert_array_equal(part.around, np.stack([changes[0], changes[2]]))
        np.testing.assert_array_equal(part.change, part.around[:, inner, inner])
        assert dataclasses.replace(part, times=sequence.times, change=sequence.change).noise == sequence.noise
    empty = made.record(np.array([]), [], 0)
    assert (empty.times.shape, empty.around.shape) == ((0,), (0, SIDE, SIDE))


@pytest.mark.parametrize("aside", [(0, 0), (2, -5), (-7, 6)])
def test_a_sequence_elsewhere_is_that_of_a_contact_there(aside: tuple[int, int]) -> None:
    found = []
    for row, column in ((0, 0), aside):
        mesh = mesh_of()
        vertex = int(np.flatnonzero((mesh.pixels == np.add(CENTRE, (row, column))).all(axis=1))[0])
        made = depth_sequence.SequenceRecorder(mesh, vertex, SIGMA, (WIDTH, HEIGHT))
        found.append(made.record(np.array([0.04]), [made.frame(seen(REST + DENT))], 1))
    moved = found[0].elsewhere(*aside)
    known = np.isfinite(moved.change)
    np.testing.assert_allclose(moved.change[known], found[1].change[known], atol=4e-7)
    beyond = [max(abs(way) - (depth_sequence.KEPT - depth_sequence.REACH), 0) for way in aside]
    assert known.sum() == np.prod([moved.change.shape[1] - lost for lost in beyond])
    back = moved.elsewhere(*np.negative(aside)).change
    np.testing.assert_array_equal(back, np.where(np.isfinite(back), found[0].change, np.nan))
