"""Presses that no tool is seen to make, found by their dents; and what is no press."""

import dataclasses

import cv2
import numpy as np
import pytest

from benchmarks.recovery.trial import observed_contacts
from palpate.data.contact import depth_change as changes
from palpate.data.contact.dents import EARLIER, EARLY, LATE, MIN_REST, RECOVERS, DentContacts
from palpate.data.contact.depth_sequence import REACH
from palpate.data.contact.geometry import NO_DENT, GeometrySettings, GeometryStatus, RestTissue, dent_geometry
from palpate.data.contact.interaction import Interaction
from palpate.data.labels import TISSUE, TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.camera import Camera
from palpate.data.source.frames import Frame
from palpate.data.synthetic.clip import SyntheticClip, synthetic_clip
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.source import open_synthetic
from palpate.data.tracks.following import Shown
from palpate.estimators.contract import ClipInfo
from tests.data.clips import make_clip

UNSEEN = SceneSettings(width=214, height=120, frames=36, tool_in_view=False, depth_noise=0.001)
MOTION = PrepareSettings(geometry=GeometrySettings(smoothing=4.0, rigid_motion="subtract", contact="motion"))
STEP = 0.004
"""Approach of the camera in a frame, as a share of the distance."""


def prepared(clip: SyntheticClip) -> tuple[list[PreparedFrame], dict[int, Interaction]]:
    """Its frames, and its runs of contact by their onset."""
    stream = open_synthetic(clip, MOTION)
    frames = list(stream)
    return frames, observed_contacts(frames, ClipInfo.of(stream))


@pytest.mark.parametrize("seed", [11, 12])
def test_a_drawn_press_without_a_tool_is_found_where_and_when_it_was(seed: int) -> None:
    """One that begins and ends between frames."""
    clip = make_clip(dataclasses.replace(UNSEEN, onset_delay=(0.0, 1.0), release_delay=(0.0, 1.0)), seed)
    assert not (clip.labels == 31).any()  # CholecSeg8k's grasper
    frames, runs = prepared(clip)
    [(onset, contact)] = runs.items()
    motion = clip.motion
    assert onset - motion.onset_frame in (0, 1)
    assert contact.released
    release = onset + round(contact.load_seconds * 25)
    assert release - motion.release_frame in (0, 1)
    assert np.abs(contact.mesh.pixels[contact.vertex] - clip.scene.mesh.pixels[clip.scene.vertex]).max() <= 1
    assert [frame.in_contact for frame in frames] == [onset <= frame.frame.index < release for frame in frames]
    assert frames[release].detail == RECOVERS
    assert contact.noise == pytest.approx(0.001, rel=0.1)
    first = frames[onset].contact
    assert (first.touching, np.isnan(first.tool_point).all(), np.isnan(first.distance)) == (False, True, True)
    # The mesh is at rest: no trace of the dent, which the frames after it show.
    true = clip.scene.mesh.vertices[clip.scene.vertex, 2]
    assert first.mesh.vertices[first.vertex, 2] == pytest.approx(true, abs=0.002)
    assert contact.moved[:, 2].max() == pytest.approx(motion.contact[:, 2].max(), abs=0.003)
    assert np.isfinite(contact.sequence.change[:, REACH, REACH]).all()


def still(settings: SceneSettings, seed: int) -> SyntheticClip:
    """A clip in which nothing happens."""
    drawn = make_clip(dataclasses.replace(settings, frames=14, press_seconds=(0.2, 0.2)), seed)
    motion = dataclasses.replace(drawn.motion, field=np.zeros_like(drawn.motion.field))
    return synthetic_clip(drawn.scene, motion, seed)


def approached(clip: SyntheticClip, step: float, aside: float) -> SyntheticClip:
    """The same seen by a camera that comes nearer by a share of 0.5 scene units and goes aside [px] in every frame."""
    size, moved = clip.depth.shape[:0:-1], {}
    for name, flags in {"images": cv2.INTER_LINEAR, "labels": cv2.INTER_NEAREST, "depth": cv2.INTER_NEAREST}.items():
        moved[name] = getattr(clip, name).copy()
        for index, picture in enumerate(moved[name]):
            zoom = 1 + step * index
            centre = np.array([clip.camera.cx, clip.camera.cy]) * (1 - zoom)
            move = np.array([[zoom, 0, centre[0] + aside * index], [0, zoom, centre[1]]])
            picture[:] = cv2.warpAffine(picture, move, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    moved["depth"] -= (0.5 * step * np.arange(len(clip.depth), dtype=np.float32))[:, None, None]
    return dataclasses.replace(clip, **moved)


@pytest.mark.parametrize(
    "errors",
    [{"depth_noise": 0.001}, {"depth_noise": 0.0, "depth_bits": 8}, {"depth_noise": 0.004, "scale_flicker": 0.005}],
    ids=["noise", "rounded", "flicker"],
)
def test_nothing_is_found_where_nothing_is_pressed(errors: dict) -> None:
    quiet = still(dataclasses.replace(UNSEEN, **errors), 21)
    for seen in (quiet, approached(quiet, STEP, 0.0), approached(quiet, -STEP, 0.0), approached(quiet, 0.0, 0.5)):
        frames, runs = prepared(seen)
        assert not runs
        assert [frame.status for frame in frames] == ["no_contact"] * 14
        assert ([frame.detail for frame in frames[-3:]], frames[0].detail) == ([NO_DENT] * 3, EARLY)


HEIGHT, WIDTH = 60, 80
CAMERA = Camera(100.0, 100.0, 39.5, 29.5, WIDTH, HEIGHT)
GRID = GeometrySettings(height=HEIGHT, width=WIDTH, smoothing=3.0, contact="motion")
PLACE = 33, 41
"""Row and column."""
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
PRESSED = np.exp(-(np.square(ROWS - PLACE[0]) + np.square(COLUMNS - PLACE[1])) / 8)


def frame(index: int, dent: float = 0.0, number: int | None = None) -> PreparedFrame:
    """Flat tissue with noise, pressed by so much over some pixels, and a tool in one corner."""
    generator = np.random.default_rng(index)
    picture = np.random.default_rng(0).integers(40, 220, (HEIGHT // 4, WIDTH // 4, 3)).astype(np.uint8)
    picture = cv2.resize(picture, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    labels = np.full((HEIGHT, WIDTH), TISSUE, np.uint8)
    labels[:10, :10] = TOOL
    depth = 0.5 + generator.normal(0, 5e-4, labels.shape) + dent * PRESSED
    # What the tool's pixels show is no tissue that sinks.
    depth[:10, :10] = 0.3 + 0.05 * (index % 2)
    shown = Frame(index, index if number is None else number, index / 25, picture)
    return PreparedFrame(shown, "no_contact", NO_DENT, depth.astype(np.float32), labels, labels)


def told(frames: list[PreparedFrame]) -> list[PreparedFrame]:
    """The same frames as they come out again."""
    finder = DentContacts(CAMERA, GRID)
    return [each for given in frames for each in finder.push(given)] + finder.finish()


def pressed(frames: list[PreparedFrame]) -> list[int]:
    """Indices of the frames in contact."""
    return [each.frame.index for each in frames if each.in_contact]


@pytest.mark.parametrize(
    ("dents", "expected"),
    [
        ([0.0] * 6 + [0.005, 0.008, 0.01, 0.012, 0.014, 0.016, 0.018, 0.01, 0.006, 0.003] + [0.0] * 6, [*range(5, 12)]),
        ([0.0] * 8 + [0.02] + [0.0] * 8, []),
        ([0.0] * 8 + [-0.02] * 8, []),
        ([0.02] * 16, []),
        (2 * ([0.0] * 8 + [0.01] * 5) + [0.0] * 6, [*range(7, 12), *range(20, 25)]),
        ([0.0] * 8 + [0.01] * 8, [*range(7, 16)]),
        (
            [0.0] * 8 + [0.02] * 4 + [0.012, 0.009, 0.007, 0.005] + [0.0] * 5 + [0.006] * 5 + [0.0] * 4,
            [*range(7, 11), *range(20, 25)],
        ),
    ],
    ids=["growing", "one frame", "bump", "there already", "two presses", "to the end", "a press on what is left"],
)
def test_contact_lasts_from_the_last_frame_without_a_dent_to_the_one_before_the_deepest(dents, expected) -> None:
    """A growing dent is deepest when the force has ended; of one that is going back what is left is no rest."""
    frames = told([frame(index, dent) for index, dent in enumerate(dents)])
    assert [each.frame.index for each in frames] == list(range(len(dents)))
    assert pressed(frames) == expected
    for index in expected:
        assert np.abs(np.subtract(frames[index].contact.pixel[::-1], PLACE)).max() <= 1


def test_frames_wait_longer_under_a_press() -> None:
    finder = DentContacts(CAMERA, GRID)
    counts = [len(finder.push(frame(index, 0.01 * (index > 7)))) for index in range(20)]
    assert counts == [0] * EARLIER + [1] * (9 - EARLIER) + [0] * (LATE - EARLIER) + [1] * (11 - LATE + EARLIER)
    assert len(finder.finish()) == LATE


def test_a_press_ends_with_what_is_known_before_a_gap() -> None:
    frames = told([frame(index, 0.01 * (index > 7), number=index + (index > 11)) for index in range(20)])
    assert pressed(frames) == [*range(7, 12)]
    rested = MIN_REST + EARLIER
    early = [index < rested or 12 <= index < 12 + rested for index in range(20)]
    assert [item.detail == EARLY for item in frames] == early


def test_a_frame_without_depth_ends_what_is_known() -> None:
    frames = [frame(index, 0.01 * (index > 7)) for index in range(14)]
    frames[10].status = "bad_depth"
    assert (pressed(told(frames)), frames[10].status) == ([7, 8, 9], "bad_depth")


def test_change_is_told_without_the_camera_s_and_with_its_noise() -> None:
    resting, generator = np.full((HEIGHT, WIDTH), 0.5), np.random.default_rng(3)
    known, dent = np.ones((HEIGHT, WIDTH), bool), 0.01 * PRESSED
    tilted = 0.003 + 1e-4 * ROWS - 2e-4 * COLUMNS
    seen = resting + dent + tilted + generator.normal(0, 1e-3, known.shape)
    change = changes.depth_change(seen, resting, known)
    # White noise of a blur of width s: σ / (2 √π s).
    expected = [1e-3, 1e-3 / (2 * np.sqrt(np.pi)), 1e-3 / (4 * np.sqrt(np.pi))]
    np.testing.assert_allclose(change.noise, expected, rtol=0.15)
    # A Gaussian of width 2 blurred by one of width s, less what a blur of 12 leaves of it.
    peak = [0.01 * (4 / (4 + s**2) - 4 / (4 + 144)) for s in changes.SCALES]
    assert change.contrast[0, 33, 41] == pytest.approx(peak[0], abs=3e-3)
    np.testing.assert_allclose(change.contrast[1:, 33, 41], peak[1:], atol=8e-4)
    assert change.sigmas()[33, 41] > 25 > 6 > np.abs(change.sigmas()[:, :20]).max()
    # Nothing has sunk where, or beside where, tissue has come nearer.
    bump = changes.depth_change(resting - dent + generator.normal(0, 1e-4, known.shape), resting, known)
    assert bump.sigmas().max() < 6
    known[:, 60:] = False
    assert np.isnan(changes.depth_change(seen, resting, known).contrast[:, :, 60:]).all()


def test_the_picture_s_motion_is_followed() -> None:
    before, after = frame(0), frame(1)
    zoom = np.array([[1.02, 0, 1.5], [0, 1.02, -0.8]])
    moved = cv2.warpAffine(before.frame.picture, zoom, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    after.frame = dataclasses.replace(after.frame, image=moved)

    def motion(before: PreparedFrame, after: PreparedFrame) -> np.ndarray:
        one, other = (Shown.of(frame.frame.picture, np.zeros((HEIGHT, WIDTH), bool)) for frame in (before, after))
        return changes.grid_motion(changes.picture_motion(one, other), one, before)

    corners = np.array([[5.0, 5, 1], [75, 5, 1], [40, 55, 1]]).T
    np.testing.assert_allclose((motion(before, after) @ corners)[:2], zoom @ corners, atol=0.25)
    after.frame = dataclasses.replace(after.frame, image=np.zeros_like(moved))
    np.testing.assert_array_equal(motion(after, before), np.eye(3))


def test_a_contact_lies_on_the_mesh() -> None:
    seen = frame(0).depth, frame(0).labels
    geometry = dent_geometry(*seen, (41, 33), CAMERA, GRID)
    assert geometry.pixel == (41, 33)
    np.testing.assert_array_equal(geometry.mesh.vertices[geometry.vertex], geometry.tissue_point)
    np.testing.assert_allclose(geometry.normal, [0, 0, -1], atol=0.05)
    assert geometry.noise == pytest.approx(5e-4, rel=0.1)
    nothing = RestTissue(np.zeros((HEIGHT, WIDTH), np.float32), np.zeros((HEIGHT, WIDTH), bool), np.zeros((1, 1), bool))
    with pytest.raises(GeometryStatus, match="so rough"):
        dent_geometry(*seen, (41, 33), CAMERA, GRID, nothing)


def test_a_noise_level_is_needed() -> None:
    with pytest.raises(ValueError, match=r"geometry\.contact motion needs a rest shape and its noise"):
        GeometrySettings(contact="motion")
