"""Which tissue the pixels around a contact show while it moves: cameras, ramps, and the renderer as their twins."""

import cv2
import numpy as np
import pytest
from numpy.typing import ArrayLike

from benchmarks.recovery.trial import observed_contacts
from palpate.data.contact.interaction import Interaction
from palpate.data.source.camera import Camera, back_project
from palpate.data.synthetic.clip import draw_truth, synthetic_clip
from palpate.data.synthetic.scene import Scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.data.synthetic.truth import TrueMotion
from palpate.estimators.contract import ClipInfo
from palpate.physics.depth import REACH
from palpate.physics.mesh import Mesh, grid_mesh
from palpate.physics.patches import MAX_SHIFT, Patches, footprint

WIDTH, HEIGHT = 64, 48
CAMERA = Camera(fx=90.0, fy=80.0, cx=30.5, cy=21.0, width=WIDTH, height=HEIGHT)
CENTRE = (23, 33)
SIDE = 2 * REACH + 1
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
PLANE = 0.5 + 0.0007 * COLUMNS - 0.0004 * ROWS
"""Depth that grows evenly from pixel to pixel."""
CURVED = 0.5 + 0.01 * np.sin(COLUMNS / 5) + 0.008 * np.cos(ROWS / 4)
SIZES = [(WIDTH, HEIGHT), (2 * WIDTH, 2 * HEIGHT), (3 * WIDTH - 5, 3 * HEIGHT - 2)]
"""Sizes of the picture."""


def mesh_of(depth: np.ndarray, hole: tuple[int, int] | None = None) -> Mesh:
    valid = np.ones(depth.shape, bool)
    if hole is not None:
        valid[hole] = False
    return grid_mesh(back_project(depth, CAMERA), valid, max_edge=1.0)


def vertex_at(mesh: Mesh, row: int, column: int) -> int:
    return int(np.flatnonzero((mesh.pixels == (row, column)).all(axis=1))[0])


def patches_of(
    depth: np.ndarray = CURVED, size: tuple[int, int] = (WIDTH, HEIGHT), hole: tuple[int, int] | None = None
) -> tuple[Patches, Mesh]:
    mesh = mesh_of(depth, hole)
    return Patches(mesh, vertex_at(mesh, *CENTRE), size), mesh


def moves(seed: int, count: int, size: float = 2e-3, frames: int = 2) -> np.ndarray:
    """Random displacements, shape [N, V, 3]."""
    return np.random.default_rng(seed).normal(0, size, (frames, count, 3))


def shifting(patches: Patches, mesh: Mesh, shift: ArrayLike, sunk: ArrayLike = 0.0) -> np.ndarray:
    """Displacements [N, V, 3] that move the patches by so many rows and columns [N, V, 2] (or what broadcasts)."""
    rest = mesh.vertices[patches.vertices].astype(np.float64)
    pixels = mesh.pixels[patches.vertices] + np.asarray(shift)
    pixels = pixels.reshape(-1, *pixels.shape[-2:])
    rays = (pixels[..., ::-1] - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy)
    after = np.broadcast_to(rest[:, 2] + sunk, rays.shape[:-1])[..., None]
    return np.concatenate([rays * after, after], axis=-1) - rest


def pixels_of(patches: Patches, mesh: Mesh) -> np.ndarray:
    """Row and column of every vertex from the contact, shape [V, 2]."""
    return mesh.pixels[patches.vertices] - CENTRE


def samples_of(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of every pixel's samples from the contact, shape [P, K, 2], and their shares [P, K]."""
    (rows, of_rows), (columns, of_columns) = (
        footprint(centre + np.arange(-REACH, REACH + 1), cells, pixels)
        for centre, cells, pixels in zip(CENTRE, (HEIGHT, WIDTH), size[::-1], strict=True)
    )
    places = np.broadcast_arrays((rows - CENTRE[0])[:, None, :, None], (columns - CENTRE[1])[None, :, None])
    shares = np.einsum("ri,cj->rcij", of_rows, of_columns)
    return np.stack(places, axis=-1).reshape(SIDE * SIDE, -1, 2), shares.reshape(SIDE * SIDE, -1)


def window_pixels() -> np.ndarray:
    """Row and column of every pixel of a depth-change sequence from the contact, shape [P, 2]."""
    return np.mgrid[-REACH : REACH + 1, -REACH : REACH + 1].reshape(2, -1).T


@pytest.mark.parametrize(
    ("count", "pixels"), [(60, 60), (60, 120), (60, 90), (214, 854), (120, 480), (60, 353), (7, 42)]
)
def test_footprints_are_those_of_an_area_average(count: int, pixels: int) -> None:
    """Whatever the picture: of random rows, and so of ramps and steps."""
    middles, shares = footprint(np.arange(count), count, pixels)
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=1e-12)
    assert (shares >= 0).all()
    index = (middles + 0.5) * pixels / count - 0.5
    np.testing.assert_allclose(index, np.rint(index), atol=1e-9)
    index = np.rint(index).astype(int)
    assert ((index >= 0) & (index < pixels))[shares > 0].all()
    generator = np.random.default_rng(0)
    step = (np.arange(pixels) >= 0.41 * pixels) * 1.0
    for row in (np.linspace(0, 1, pixels), step, generator.random(pixels)):
        picture = np.tile(row.astype(np.float32), (2 * count, 1))
        shrunk = cv2.resize(picture, (count, count), interpolation=cv2.INTER_AREA)[0]
        np.testing.assert_allclose((shares * row[np.clip(index, 0, pixels - 1)]).sum(axis=1), shrunk, atol=2e-6)


def test_on_a_plane_shift_is_the_cameras_and_sunk_the_new_depth_less_that_at_rest_where_it_lies() -> None:
    patches, mesh = patches_of(PLANE)
    moved = moves(0, len(patches.vertices), size=0.01)
    after = mesh.vertices[patches.vertices].astype(np.float64) + moved
    places = after[..., :2] / after[..., 2:] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy)
    shift = places[..., ::-1] - mesh.pixels[patches.vertices]
    np.testing.assert_allclose(patches.shift(moved), shift, atol=1e-5)
    assert np.abs(shift).max() > 1
    np.testing.assert_allclose(patches.sunk(moved), after[..., 2] - (0.5 + places @ [0.0007, -0.0004]), atol=1e-6)


@pytest.mark.parametrize("hole", [None, (20, 30)])
def test_slopes_of_sunk_are_those_of_central_differences(hole: tuple[int, int] | None) -> None:
    patches, _ = patches_of(hole=hole)
    moved = moves(3, len(patches.vertices), size=5e-3)
    slopes = np.random.default_rng(4).normal(size=(*moved.shape, 4))
    found, step = patches.sunk_slopes(moved, slopes), 1e-6
    for index in range(4):
        change = step * slopes[..., index]
        expected = (patches.sunk(moved + change) - patches.sunk(moved - change)) / (2 * step)
        np.testing.assert_allclose(found[..., index], expected, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("shift", [(0, 0), (0, 1), (-1, 0), (1, -2)])
def test_patches_that_all_shift_alike_are_shown_so_far_on(size: tuple[int, int], shift: tuple[int, int]) -> None:
    """At rest every sample shows the vertex beneath it, also those without a share."""
    patches, mesh = patches_of(size=size)
    covering, pixels = patches.covering(shifting(patches, mesh, shift)), pixels_of(patches, mesh)
    assert covering.shape == (1, *patches.weights.shape)
    places, shares = samples_of(size)
    clear = (np.abs(places % 1 - 0.5) > 1e-3).all(axis=-1)
    assert clear.mean() > 0.9
    if shift == (0, 0):
        assert (covering >= 0).all()
    else:
        clear &= shares > 0
    np.testing.assert_array_equal(pixels[covering[0]][clear], np.rint(places)[clear] - shift)
    if size == (WIDTH, HEIGHT):
        # And so the pixels show the values of other vertices.
        values = np.random.default_rng(5).normal(size=(1, len(pixels), 2))
        there = {tuple(pixel): value for pixel, value in zip(pixels.tolist(), values[0], strict=True)}
        expected = [there[tuple(pixel)] for pixel in (window_pixels() - shift).tolist()]
        np.testing.assert_array_equal(patches.shown(values, covering)[0], expected)


def test_what_comes_from_too_far_away_is_not_known() -> None:
    patches, mesh = patches_of()
    far = MAX_SHIFT + 2
    covering = patches.covering(shifting(patches, mesh, (0, far))).reshape(SIDE, SIDE)
    assert (covering[:, far - MAX_SHIFT :] >= 0).all()
    assert (covering[:, : far - MAX_SHIFT] == -1).all()


@pytest.mark.parametrize("size", SIZES)
def test_what_a_sample_shows_lies_nearest_to_where_it_came_from(size: tuple[int, int]) -> None:
    """Brute force: tissue that shifts evenly between the vertices, x + shift(x) = sample, on a fine lattice."""
    patches, mesh = patches_of(size=size)
    rest = pixels_of(patches, mesh)
    apart = np.hypot(*rest.T)
    shift = -0.4 * rest * np.exp(-0.5 * (apart / 4) ** 2)[:, None]
    covering = patches.covering(shifting(patches, mesh, shift[None]))[0]
    reach = REACH + MAX_SHIFT
    dense = shift.reshape(2 * reach + 1, 2 * reach + 1, 2)
    fine = np.linspace(0, 2 * reach, 16 * 2 * reach + 1)
    corner = np.minimum(fine.astype(int), 2 * reach - 1)
    part = fine - corner
    across = dense[:, corner] * (1 - part)[:, None] + dense[:, corner + 1] * part[:, None]
    both = across[corner] * (1 - part)[:, None, None] + across[corner + 1] * part[:, None, None]
    origins = np.stack(np.meshgrid(fine, fine, indexing="ij"), axis=-1).reshape(-1, 2) - reach
    arrived = origins + both.reshape(-1, 2)
    generator = np.random.default_rng(6)
    places, compared = samples_of(size)[0], 0
    for pixel in generator.choice(SIDE * SIDE, 40, replace=False):
        for sample in generator.choice(places.shape[1], min(places.shape[1], 2), replace=False):
            place = places[pixel, sample]
            origin = origins[np.square(arrived - place).sum(axis=1).argmin()]
            if np.abs(origin - np.floor(origin) - 0.5).min() > 0.08:
                np.testing.assert_array_equal(rest[covering[pixel, sample]], np.rint(origin))
                compared += 1
    assert compared > 20


@pytest.mark.parametrize("size", SIZES[:2])
def test_what_is_hidden_or_folded_is_not_known(size: tuple[int, int]) -> None:
    hole = (CENTRE[0] + 2, CENTRE[1] - 3)
    patches, mesh = patches_of(size=size, hole=hole)
    moved = np.zeros((1, len(patches.vertices), 3))
    shown = patches.shown(np.ones(moved.shape[:2]), patches.covering(moved))[0]
    apart = np.abs(window_pixels() - (2, -3)).max(axis=1)
    assert np.isnan(shown[apart == 0]).all()
    np.testing.assert_array_equal(shown[apart > 1], 1)
    # One vertex that moves beyond its neighbours: which of them a pixel shows nobody knows.
    patches, mesh = patches_of(size=size)
    shift = np.zeros((1, len(patches.vertices), 2))
    shift[0, patches.vertices == vertex_at(mesh, *CENTRE)] = (0, 3)
    shown = patches.shown(np.ones(shift.shape[:2]), patches.covering(shifting(patches, mesh, shift)))[0]
    assert np.isnan(shown[SIDE * SIDE // 2])
    apart = np.abs(window_pixels()).max(axis=1)
    np.testing.assert_array_equal(shown[apart > 3], 1)


def test_pixels_turn_to_what_comes_from_beside_them() -> None:
    """Tissue that shifts by a pixel changes the depth by one pixel of its slope, and is as steep as that slope."""
    flat = np.full((HEIGHT, WIDTH), 0.5)
    patches, mesh = patches_of(flat, size=(4 * WIDTH, 4 * HEIGHT))
    pixels = pixels_of(patches, mesh)
    slope = np.array([0.0004, -0.0003])
    moved = shifting(patches, mesh, (0, 0), pixels @ slope)
    step = 1e-6
    slopes = [
        (shifting(patches, mesh, (row, column), pixels @ slope + sunk) - moved) / step
        for row, column, sunk in step * np.eye(3)
    ]
    turned, steep = patches.turning(moved, np.stack(slopes, axis=-1)), patches.steepness(moved)
    np.testing.assert_allclose(turned, np.broadcast_to([*-slope, 0.0], turned.shape), atol=1e-8)
    np.testing.assert_allclose(steep, np.hypot(*slope), rtol=1e-6)


def test_turning_adds_up_to_what_is_shown_after_it() -> None:
    """A dent that travels by a pixel: all it turns on the way is what pixels show more in the end."""
    flat = np.full((HEIGHT, WIDTH), 0.5)
    patches, mesh = patches_of(flat, size=(4 * WIDTH, 4 * HEIGHT))
    pixels = pixels_of(patches, mesh)
    dent = 0.01 * np.exp(-0.5 * np.square(pixels / 4).sum(axis=1))
    ways = np.linspace(0, 1, 17)
    moved = np.concatenate([shifting(patches, mesh, (0, way), dent) for way in ways])
    slopes = np.gradient(moved, ways, axis=0, edge_order=2)[..., None]
    total = np.trapezoid(patches.turning(moved, slopes)[..., 0], ways, axis=0)
    first, last = (patches.shown(patches.sunk(part), patches.covering(part))[0] for part in (moved[:1], moved[-1:]))
    assert np.abs(last - first).max() > 1e-3
    np.testing.assert_allclose(total, last - first, atol=5e-5)


def clip_of(seed: int, size: tuple[int, int]) -> tuple[Interaction, Scene, TrueMotion]:
    """The contact of a rendered clip without noise, as it is gathered, and its truth."""
    brief = {"frames": 9, "press_seconds": (0.16, 0.16), "onset_fraction": (0.2, 0.25)}
    scene, motion = draw_truth(SceneSettings(width=size[0], height=size[1], **brief), seed)
    clip = open_synthetic(synthetic_clip(scene, motion, seed), PREPARE)
    contacts = observed_contacts(list(clip), ClipInfo.of(clip))
    return contacts[motion.onset_frame], scene, motion


def truly_shown(contact: Interaction, scene: Scene, motion: TrueMotion) -> np.ndarray:
    """What the patches say of the true motion, shape of the depth-change sequence's change."""
    sequence = contact.sequence
    frames = motion.onset_frame + np.rint(sequence.times * scene.settings.fps).astype(int)
    whole = np.zeros((len(frames), len(scene.mesh.vertices), 3))
    whole[:, motion.moving] = motion.field[frames]
    patches = Patches(scene.mesh, scene.vertex, sequence.size)
    moved = whole[:, patches.vertices]
    return patches.shown(patches.sunk(moved), patches.covering(moved)).reshape(sequence.change.shape)


def test_rendered_clips_show_what_patches_say() -> None:
    contact, scene, motion = clip_of(2, (214, 120))
    np.testing.assert_array_equal(contact.mesh.pixels[contact.vertex], scene.mesh.pixels[scene.vertex])
    assert contact.sequence.size == (214, 120)
    expected = truly_shown(contact, scene, motion)
    assert np.isfinite(expected).all()
    assert expected.max() > 0.02
    seen = np.isfinite(contact.sequence.change)
    under = contact.sequence.times < motion.load_seconds - 1e-6
    assert not seen[under].all(axis=(1, 2)).any()  # the tool is in the way
    assert seen[~under].all()
    assert seen.mean() > 0.85
    np.testing.assert_allclose(contact.sequence.change[seen], expected[seen], atol=1e-4)


def test_a_blur_shows_less_of_a_narrow_dent() -> None:
    """Between samples a third apart a single vertex's dent is (7/9)² deep on average if it ends at its neighbours."""
    patches, mesh = patches_of(np.full((HEIGHT, WIDTH), 0.5), (3 * WIDTH, 3 * HEIGHT))
    sunk = np.where((pixels_of(patches, mesh) == 0).all(axis=1), 0.01, 0.0)
    moved = shifting(patches, mesh, 0.0, sunk)
    linear, blurred = patches.blurs(moved, patches.covering(moved))[:, 0].T.reshape(2, SIDE, SIDE)
    assert linear[REACH, REACH] == pytest.approx(0.01 * ((7 / 9) ** 2 - 1), rel=1e-3)
    assert linear[REACH, REACH + 1] == pytest.approx(0.01 * 7 / 9 / 9, rel=1e-3)
    assert blurred.sum() == pytest.approx(0.0, abs=1e-6)
    assert blurred[REACH, REACH] < -0.002
    assert patches_of()[0].blurs(moved, patches_of()[0].covering(moved)).shape[2] == 0
