"""A young contact moves to the tissue that yields: constructed frames whose pressed pixel is known."""

import dataclasses
from itertools import pairwise

import cv2
import numpy as np
import pytest

from palpate.data.contact.geometry import TISSUE, TOOL, GeometrySettings, frame_geometry
from palpate.data.contact.motion import DENTED, LOST, ContactMotion
from palpate.data.contact.refinement import REFINE_FRAMES, pressed_pixel
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.camera import Camera
from palpate.data.source.frames import Frame
from palpate.physics.mesh import contact_normal

HEIGHT, WIDTH = 48, 64
CAMERA = Camera(80.0, 80.0, 31.5, 23.5, WIDTH, HEIGHT)
SETTINGS = GeometrySettings(height=HEIGHT, width=WIDTH, smoothing=3.0)
NOISE, DENT = 0.0005, 0.01
ONSET = 3
AWAY = (-2, 1)
"""Where the tissue yields, from the contact that is detected at the onset, (u, v) [grid pixels]."""


def picture() -> np.ndarray:
    coarse = np.random.default_rng(2).uniform(40, 220, (HEIGHT // 3, WIDTH // 3)).astype(np.float32)
    grey = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def frame(index: int, *, contact: bool, dent: tuple[int, int] | None = None) -> PreparedFrame:
    """Flat tissue left of column 40, a tool beside it in frames in contact, one pixel (u, v) pressed in."""
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[:, :40] = TISSUE
    if contact:
        labels[20:28, 40:] = TOOL
    generator = np.random.default_rng(100 + index)
    depth = np.where(labels > 0, 0.5 + generator.normal(0, NOISE, labels.shape), 0).astype(np.float32)
    if dent is not None:
        depth[dent[1], dent[0]] += DENT
    prepared = PreparedFrame(Frame(index, index, index / 25, picture()), "no_tool", "", depth, labels, labels)
    if contact:
        prepared.status, prepared.geometry = "ok", frame_geometry(depth, labels, CAMERA, SETTINGS)
    return prepared


def motion(settings: GeometrySettings = SETTINGS, *, from_shading: bool = False) -> ContactMotion:
    return ContactMotion(CAMERA, (WIDTH, HEIGHT), PrepareSettings(geometry=settings), from_shading=from_shading)


def link(linked: ContactMotion, frames: list[PreparedFrame]) -> None:
    for before, after in pairwise(frames):
        linked.link(before, after)


def follow(linked: ContactMotion, pressed: int, *, dented: bool = True) -> tuple[list[PreparedFrame], tuple[int, int]]:
    """Link three frames at rest, an onset, `pressed` frames with the dent, and one after the release."""
    frames = [frame(index, contact=False) for index in range(ONSET)] + [frame(ONSET, contact=True)]
    detected = frames[ONSET].geometry.pixel
    dent = (detected[0] + AWAY[0], detected[1] + AWAY[1])
    last = ONSET + pressed
    frames += [frame(index, contact=True, dent=dent if dented else None) for index in range(ONSET + 1, last + 1)]
    frames.append(frame(last + 1, contact=False))
    link(linked, frames)
    return frames, dent


@pytest.fixture
def onset() -> PreparedFrame:
    return frame(ONSET, contact=True)


def later(onset: PreparedFrame, across: int | None = None) -> list[tuple[PreparedFrame, np.ndarray, float]]:
    """Four frames after an onset whose tissue stays in place, pressed in so many pixels beside the contact."""
    u, v = onset.geometry.pixel
    dent = None if across is None else (u + across, v)
    return [(frame(ONSET + 1 + k, contact=True, dent=dent), np.array([u, v], float), 0.0) for k in range(4)]


@pytest.mark.parametrize("pressed", [REFINE_FRAMES + 2, 2])
def test_the_contact_moves_to_the_pressed_pixel(pressed: int) -> None:
    linked = motion()
    frames, dent = follow(linked, pressed)
    geometry = frames[ONSET].geometry
    assert linked.settled
    assert geometry.pixel == dent
    assert tuple(geometry.mesh.pixels[geometry.vertex][::-1]) == dent
    np.testing.assert_allclose(geometry.normal, contact_normal(geometry.mesh, geometry.vertex))
    # The pixel's own track, also in the frames that were linked before it was chosen.
    for later in frames[ONSET + 1 : ONSET + 1 + pressed]:
        assert later.track_start == ONSET
        assert later.track_position[2] == pytest.approx(later.depth[dent[1], dent[0]], abs=1e-6)
        assert later.track_position[2] - 0.5 == pytest.approx(DENT, abs=4 * NOISE)
    assert frames[-1].track_position[2] == pytest.approx(0.5, abs=4 * NOISE)
    assert not any(prepared.detail for prepared in frames[ONSET:-1])  # clean outlines and a followed contact


def test_noise_alone_does_not_move_it(onset: PreparedFrame) -> None:
    frames, _ = follow(motion(), REFINE_FRAMES, dented=False)
    assert frames[ONSET].geometry.pixel == onset.geometry.pixel


def test_a_contact_without_a_noise_level_stays_where_it_was_detected(onset: PreparedFrame) -> None:
    raw = GeometrySettings(height=HEIGHT, width=WIDTH)
    linked = motion(raw)
    onset.geometry = frame_geometry(onset.depth, onset.labels, CAMERA, raw)
    detected = onset.geometry.pixel
    linked.link(frame(ONSET - 1, contact=False), onset)
    assert linked.settled
    linked.link(onset, later(onset, -2)[0][0])
    assert onset.geometry.pixel == detected


def test_frames_wait_until_the_contact_is_settled() -> None:
    linked, settled = motion(), []
    frames = [frame(ONSET + k, contact=k >= 0) for k in range(-1, REFINE_FRAMES + 1)]
    for before, after in pairwise(frames):
        linked.link(before, after)
        settled.append(linked.settled)
    assert settled == [False] * REFINE_FRAMES + [True]


def test_the_mesh_at_rest_has_less_noise_and_no_hole_under_the_tool(onset: PreparedFrame) -> None:
    frames, _ = follow(motion(), REFINE_FRAMES)
    alone, rest = onset.geometry.mesh, frames[ONSET].geometry.mesh
    assert rest.vertices[:, 2].std() < 0.8 * alone.vertices[:, 2].std()
    assert frames[ONSET].geometry.noise == pytest.approx(NOISE, rel=0.1)


def test_pressed_pixel_needs_enough_frames_and_a_clear_change(onset: PreparedFrame) -> None:
    u, v = onset.geometry.pixel
    seen, dent = later(onset, -1), (u - 1, v)
    assert pressed_pixel(onset, seen, 3.5) == dent
    assert pressed_pixel(onset, seen, 1000.0) is None
    assert pressed_pixel(onset, [], 3.5) is None
    # A pixel seen in fewer than half of the frames does not count.
    for prepared, _, _ in seen[1:]:
        prepared.labels[v, u - 1] = 0
    assert pressed_pixel(onset, seen, 3.5) != dent
    # Tissue that has moved in the picture is compared with itself.
    moved = [(prepared, place - (1, 0), away) for prepared, place, away in later(onset, -2)]
    assert pressed_pixel(onset, moved, 3.5) == dent


def test_pressed_tissue_is_found_all_along_the_touching_outline(onset: PreparedFrame) -> None:
    u, v = onset.geometry.pixel
    assert 20 <= v <= 27  # the tool's rows
    far = 27 if v < 24 else 20  # beyond REFINE_REACH of what was detected
    seen = later(onset)
    for prepared, _, _ in seen:
        prepared.depth[far, u] += DENT
        # A tool pixel that is taken for tissue: in front of it, and by more.
        prepared.depth[v, u - 1] -= 3 * DENT
    assert pressed_pixel(onset, seen, 3.5) == (u, far)
    # Away from the outline nothing is looked for.
    assert pressed_pixel(onset, later(onset, -12), 3.5) is None


def test_tissue_that_is_pulled_counts_where_nothing_is_pressed(onset: PreparedFrame) -> None:
    u, v = onset.geometry.pixel
    seen = later(onset)
    for prepared, _, _ in seen:
        prepared.depth[v, u - 1] -= DENT
    assert pressed_pixel(onset, seen, 3.5) == (u - 1, v)


def test_of_equal_dents_the_one_that_masks_show_most_often_is_tissue(onset: PreparedFrame) -> None:
    """The tip of the tool goes as deep as the tissue it presses; frayed outlines show it as tissue now and then."""
    u, v = onset.geometry.pixel
    seen = later(onset, -2)
    for k, (prepared, _, _) in enumerate(seen):
        prepared.depth[v, u - 1] = 0.5 + DENT + NOISE / 2  # hardly deeper
        if k % 2:
            prepared.labels[v, u - 1] = TOOL
    assert pressed_pixel(onset, seen, 3.5) == (u - 2, v)
    for prepared, _, _ in seen:
        prepared.depth[v, u - 1] += 10 * NOISE  # deeper beyond doubt
    assert pressed_pixel(onset, seen, 3.5) == (u - 1, v)


def test_noise_is_measured_away_from_the_outlines() -> None:
    onset = frame(ONSET, contact=True)
    onset.depth[18:30, 38:40] -= 20 * NOISE  # tool that counts as tissue
    link(motion(), [frame(index, contact=False) for index in range(ONSET)] + [onset])
    assert onset.geometry.noise == pytest.approx(NOISE, rel=0.1)
    assert onset.geometry.mesh.vertices[:, 2] == pytest.approx(0.5, abs=2 * NOISE)  # nor is the rest shape dented


@pytest.mark.parametrize("what", ["no flow", "no depth"])
def test_a_lost_track_is_told(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    linked = motion()
    frames = [frame(index, contact=index >= ONSET) for index in range(ONSET + 4)]
    link(linked, frames[:-1])
    if what == "no flow":
        monkeypatch.setattr(linked._tracker, "near", lambda *arguments: np.full(2, np.nan))
    else:
        frames[-1].depth[:, 20:] = 0
    linked.link(*frames[-2:])
    assert not np.isfinite(frames[-1].track_position).any()
    assert [prepared.detail for prepared in frames[ONSET:]] == ["", "", "", LOST]


def press_again(settings: GeometrySettings, pause: int, left: float) -> list[PreparedFrame]:
    """The last four frames of: a press of six frames, `pause` frames without contact and with a dent of `left`, and
    another press, during which the contact flickers."""
    linked = motion(settings)
    frames, dent = follow(linked, REFINE_FRAMES)
    for index in range(len(frames), len(frames) + pause):
        frames.append(frame(index, contact=False))
        frames[-1].depth[dent[1], dent[0]] += np.float32(left)
    frames += [frame(len(frames) + k, contact=k != 2) for k in range(4)]
    link(linked, frames[-5 - pause :])
    return frames[-4:]


SUBTRACTED = dataclasses.replace(SETTINGS, rigid_motion="subtract")


@pytest.mark.parametrize(
    ("settings", "pause", "left", "refused"),
    [
        (SUBTRACTED, 8, 0.0, False),  # followed, and back at rest
        (SUBTRACTED, 8, DENT / 2, True),  # followed, and still dented
        (SETTINGS, 8, 0.0, True),  # the camera's motion is in the track, so only time tells
        (SETTINGS, 30, 0.0, False),
    ],
)
def test_a_contact_on_dented_tissue_has_no_onset_at_rest(settings, pause, left, refused) -> None:
    frames = press_again(settings, pause, left)
    told = DENTED if refused else ""
    assert [prepared.detail for prepared in frames] == [told, told, "", told]  # all that are in contact
    assert {prepared.track_start for prepared in frames} == {-1 if refused else frames[0].frame.index}


@pytest.mark.parametrize("what", ["at rest again", "out of view"])
def test_a_contact_after_a_refused_one_is_judged_anew(what: str) -> None:
    linked = motion()
    frames, _ = follow(linked, REFINE_FRAMES)
    count = len(frames)
    frames += [frame(count + k, contact=k >= 8) for k in range(10)]  # soon after the first
    count = len(frames)
    if what == "at rest again":
        frames += [frame(count + k, contact=k >= 30) for k in range(32)]
    else:
        frames.append(frame(count, contact=False))
        frames[-1].picture_labels = None
        frames += [frame(count + 1 + k, contact=True) for k in range(2)]
    link(linked, frames[REFINE_FRAMES + ONSET + 1 :])
    assert [prepared.detail for prepared in frames[count - 2 : count]] == [DENTED] * 2
    assert [prepared.detail for prepared in frames[-2:]] == ["", ""]
    start = frames[-2].frame.index if what == "at rest again" else -1  # back in view, contact is already there
    assert [prepared.track_start for prepared in frames[-2:]] == [start] * 2


def test_a_camera_that_comes_nearer_hides_no_dent(onset: PreparedFrame) -> None:
    """All depth falls by 0.02 a frame while the contact is pressed away: the dent changes least in depth."""
    u, v = onset.geometry.pixel
    still = later(onset, -1)
    known = [(pressed, place, -0.02 * k) for k, (pressed, place, _) in enumerate(still, 1)]
    for pressed, _, away in known:
        pressed.depth = np.where(pressed.depth > 0, pressed.depth + np.float32(away), 0)
    assert pressed_pixel(onset, known, 3.5) == (u - 1, v)
    assert pressed_pixel(onset, still, 3.5) != (u - 1, v)
