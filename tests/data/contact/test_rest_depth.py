"""Depth at rest from the frames before a contact: averaged, moved with the picture, filled behind the tool."""

import cv2
import numpy as np
import pytest

from palpate.data.contact.geometry import TISSUE, TOOL, GeometrySettings, RestTissue, frame_geometry
from palpate.data.contact.rest_depth import FRAMES, RestDepth
from palpate.data.labels import OTHER
from palpate.data.prepared import PreparedFrame
from palpate.data.source.camera import Camera
from palpate.data.source.frames import Frame

HEIGHT, WIDTH = 60, 80
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
PLANE = 0.5 + 0.001 * COLUMNS + 0.0005 * ROWS
TOOL_AREA = np.s_[10:25, 30:45]
NOISE = 0.004
CAMERA = Camera(fx=100.0, fy=100.0, cx=40.0, cy=30.0, width=WIDTH, height=HEIGHT)
GRID = GeometrySettings(height=HEIGHT, width=WIDTH)


def texture(shift: int = 0) -> np.ndarray:
    """RGB picture moved `shift` pixels to the right."""
    noise = np.random.default_rng(5).uniform(30, 220, (HEIGHT // 3, (WIDTH + 40) // 3)).astype(np.float32)
    wide = cv2.resize(noise, (WIDTH + 40, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return np.repeat(np.clip(wide[:, 20 - shift : 20 - shift + WIDTH], 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def frame(index: int, depth: np.ndarray, *, tool: bool = False, shift: int = 0, contact: bool = False) -> PreparedFrame:
    labels = np.full((HEIGHT, WIDTH), TISSUE, np.uint8)
    if tool:
        labels[TOOL_AREA] = TOOL
    source = Frame(index, index, index / 25, texture(shift))
    geometry = object() if contact else None  # only whether there is one counts
    return PreparedFrame(source, "ok", "", depth.astype(np.float32), labels, labels, geometry)


def noisy(seed: int) -> np.ndarray:
    return PLANE + np.random.default_rng(seed).normal(0, NOISE, PLANE.shape)


def rest_of(*depths: np.ndarray) -> RestDepth:
    """At rest in frames of such depth."""
    rest = RestDepth()
    for index, depth in enumerate(depths):
        rest.push(frame(index, depth))
    return rest


def test_averaging_takes_the_noise_down_by_the_root_of_the_frames() -> None:
    rest = rest_of(*(noisy(index) for index in range(FRAMES + 5)))
    depth, known, _ = rest.at(frame(FRAMES + 5, noisy(99)))
    assert known.all()
    assert (depth - PLANE).std() == pytest.approx(NOISE / np.sqrt(FRAMES + 1), rel=0.05)


def test_a_shift_of_the_picture_is_undone() -> None:
    """Frames seen 2 pixels to the left of where they lie now: a plane with a slope would be off by 2 slopes."""
    rest, moved = rest_of(*4 * [0.5 + 0.02 * (COLUMNS > 40)]), 0.5 + 0.02 * (COLUMNS - 2 > 40)
    depth, known, _ = rest.at(frame(4, moved, shift=2))
    assert known.all()
    np.testing.assert_allclose(depth, moved, atol=1e-6)


def test_a_larger_shift_is_left_out() -> None:
    rest, now = rest_of(*4 * [PLANE + 0.1 * (COLUMNS > 40)]), noisy(3)
    np.testing.assert_allclose(rest.at(frame(4, now, shift=8)).depth, now, atol=1e-6)


def test_a_change_of_the_distance_is_undone() -> None:
    np.testing.assert_allclose(rest_of(*4 * [PLANE - 0.05]).at(frame(4, PLANE)).depth, PLANE, atol=1e-6)


def test_beside_the_tool_earlier_frames_alone_count() -> None:
    """A frayed outline: the tool's own depth is labelled as tissue up to two pixels beside it."""
    beside = np.zeros((HEIGHT, WIDTH), bool)
    beside[8:27, 28:47] = True
    onset = frame(3, np.where(beside, 0.3, PLANE), tool=True)
    assert rest_of().at(onset).depth[9, 29] == np.float32(0.3)  # nothing else is known
    np.testing.assert_allclose(rest_of(*3 * [PLANE]).at(onset).depth, PLANE, atol=1e-6)


def test_tissue_behind_the_tool_is_filled() -> None:
    onset = frame(3, np.where(frame(3, PLANE, tool=True).labels == TOOL, 0.3, PLANE), tool=True)
    unseen = RestDepth().at(onset).known
    assert not unseen[TOOL_AREA].any()
    assert unseen.sum() == unseen.size - 15 * 15
    depth, known, _ = rest_of(*3 * [PLANE]).at(onset)
    assert known.all()
    np.testing.assert_allclose(depth, PLANE, atol=1e-6)


@pytest.mark.parametrize("what", ["contact", "no mask", "no depth"])
def test_whatever_is_not_at_rest_ends_it(what: str) -> None:
    rest = rest_of(PLANE + 0.1 * (COLUMNS > 40))
    interrupting = frame(1, np.zeros_like(PLANE) if what == "no depth" else PLANE, contact=what == "contact")
    if what == "no mask":
        interrupting.picture_labels = None
    rest.push(interrupting)
    now = noisy(7)
    np.testing.assert_allclose(rest.at(frame(2, now)).depth, now, atol=1e-6)


def test_where_the_tissue_ends_behind_the_tool_is_known_once_it_was_seen() -> None:
    """Pixels beside the tool may be the tool's, so what they show isn't known."""
    onset = frame(3, PLANE, tool=True)
    before = frame(0, PLANE)
    before.labels[:15] = OTHER
    before.labels[:8, 60:70] = TOOL
    assert not RestDepth().at(onset).beyond.any()
    rest = RestDepth()
    rest.push(before)
    depth, known, beyond = rest.at(onset)
    expected = np.zeros_like(known)
    expected[10:15, 30:45] = True
    np.testing.assert_array_equal(beyond & (onset.labels == TOOL), expected)
    assert not beyond[:10, 58:72].any()
    assert known[15:25, 30:45].all()
    assert not known[10:15, 30:45].any()
    edge = frame_geometry(depth, onset.labels, CAMERA, GRID, RestTissue(depth, known, beyond)).mesh
    hidden = frame_geometry(depth, onset.labels, CAMERA, GRID, RestTissue(depth, known, np.zeros_like(known))).mesh
    behind = (edge.pixels[:, 0] == 15) & (edge.pixels[:, 1] >= 32) & (edge.pixels[:, 1] < 43)
    assert edge.rim[behind].all()
    assert not hidden.rim[behind].any()
