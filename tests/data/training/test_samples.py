"""Which frames become samples, and what the simulation is compared with."""

import math
from dataclasses import replace

import numpy as np
import pytest

from palpate.data.clip import prepare
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.contact.interaction import Interaction
from palpate.data.training.samples import SampleSettings, builder_of, list_frames, make_interaction, make_sample
from palpate.physics.mechanics import Mechanics
from tests.data.clips import DEPTH_STEP, GRID, SETTINGS, remove_depth, remove_frame, write_clip

PAIRS = SampleSettings(geometry=GRID)
TRAJECTORY = SampleSettings(window=4, observation="trajectory", geometry=GRID)


def steps_of(contact: Interaction) -> list[int]:
    """Indices into a trajectory at which it was observed."""
    return contact.observation.steps(contact.time_step).tolist()


def load_steps(contact: Interaction) -> float:
    """Steps under load, which all come first."""
    assert (np.diff(contact.load.factor) <= 0).all()
    return contact.load.factor.sum()


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """Contact in frames 3 to 7 of 12, 40 ms apart."""
    folder = tmp_path_factory.mktemp("samples")
    return prepare(write_clip(folder / "clip"), SETTINGS, folder / "cache")


def test_pairs_are_consecutive_frames_in_contact_and_the_rest_is_counted(clip):
    assert len(clip) == 12
    assert list_frames(clip, PAIRS) == ([3, 4, 5, 6], {"no_tool": 7, "next frame not in contact": 1})


def test_no_pair_crosses_a_gap(tmp_path):
    folder = write_clip(tmp_path / "clip")
    remove_frame(folder, 5)
    clip = prepare(folder, SETTINGS, tmp_path / "cache")
    frames, left_out = list_frames(clip, PAIRS)
    assert (clip.times[frames].tolist(), left_out["no next frame"]) == (pytest.approx([0.12, 0.24]), 1)


def test_a_pair_observes_one_displacement_at_one_step(clip):
    sample = make_sample(clip, 4, replace(PAIRS, window=3))
    assert np.array_equal(sample.window_a, [clip.depth(2), clip.depth(3), clip.depth(4)])
    assert np.array_equal(sample.window_b, [clip.depth(7), clip.depth(6), clip.depth(5)])
    for contact, frame, sign in ((sample.interaction_a, 4, 1), (sample.interaction_b, 5, -1)):
        assert (steps_of(contact), load_steps(contact)) == ([199], 50)
        assert contact.moved[0, 2] == pytest.approx(sign * DEPTH_STEP, abs=2e-4)
        assert (contact.vertex, contact.direction) == (clip.vertex[frame], pytest.approx(clip.normal[frame]))
        assert len(contact.mesh.vertices) == len(clip.mesh(frame).vertices)


def test_a_trajectory_is_observed_at_the_frames_time_stamps(clip):
    assert list_frames(clip, TRAJECTORY) == ([3, 4, 5, 6], {"no_tool": 3, "onset outside the window": 5})
    sample = make_sample(clip, 5, TRAJECTORY)
    contact = sample.interaction_a
    # Frames 40 ms apart are 8 steps of 5 ms; index i is the time (i + 1)·Δt.
    assert steps_of(contact) == [8 * k - 1 for k in range(1, 9)]
    assert contact.moved[:, 2] == pytest.approx(DEPTH_STEP * np.arange(1, 9), abs=2e-4)
    assert load_steps(contact) == 5 * 8  # contact in frames 3 to 7, out of it in frame 8
    assert contact.vertex == clip.vertex[3]
    assert sample.interaction_b is contact


def test_a_trajectory_ends_with_its_horizon_and_with_the_rollout(clip):
    run = builder_of(clip, 3, TRAJECTORY)
    assert steps_of(run.build(TRAJECTORY.mechanics, 3)) == [7, 15, 23]
    assert steps_of(run.build(TRAJECTORY.mechanics, "press")) == [7, 15, 23, 31]  # contact in frames 3 to 7
    brief = make_interaction(clip, 4, replace(TRAJECTORY, mechanics=Mechanics(steps=20, load_steps=5)))
    assert (steps_of(brief), load_steps(brief)) == ([7, 15], 20)


def spoiled(tmp_path, frames: tuple[int, ...], what: str, contact: tuple[int, ...] = (3, 4, 5, 6, 7)):
    """A clip some of whose frames have no depth or no mask."""
    folder = write_clip(tmp_path / "clip", contact=contact)
    if what == "depth":
        remove_depth(folder, *frames)
    else:
        for index in frames:
            (folder / f"frame_{index}_endo_color_mask.png").unlink()
    return prepare(folder, SETTINGS, tmp_path / "cache")


def test_a_frame_without_depth_within_a_press_is_no_release(tmp_path):
    clip = spoiled(tmp_path, (5,), "depth")
    assert clip.status[4:7].tolist() == ["ok", "bad_depth", "ok"]
    run = builder_of(clip, 3, TRAJECTORY)
    assert (run.pressed, run.load_seconds) == (4, pytest.approx(0.2))
    contact = make_interaction(clip, 3, TRAJECTORY)
    assert load_steps(contact) == 5 * 8
    assert steps_of(contact) == [7, 23, 31, 39, 47, 55, 63]  # all but the frame itself


@pytest.mark.parametrize(("frames", "what"), [((8,), "depth"), ((8, 9), "depth"), ((8,), "mask")])
def test_after_an_unknown_frame_without_contact_nothing_is_observed(tmp_path, frames, what):
    clip = spoiled(tmp_path, frames, what, contact=tuple(range(3, frames[-1] + 1)))
    assert clip.status[8] == ("bad_depth" if what == "depth" else "no_mask")
    run = builder_of(clip, 3, TRAJECTORY)
    assert (run.pressed, run.load_seconds) == (4, None)
    contact = make_interaction(clip, 3, TRAJECTORY)
    assert load_steps(contact) == 200  # it wasn't seen to end
    assert steps_of(contact) == [7, 15, 23, 31]  # frames 4 to 7


def test_direction_of_the_observed_motion(clip):
    along = replace(PAIRS, geometry=GeometrySettings(height=48, width=64, force_direction="displacement"))
    sample = make_sample(clip, 4, along)
    motion, direction = sample.interaction_a.moved[0], sample.interaction_a.direction
    assert direction == pytest.approx(-motion / np.linalg.norm(motion), abs=1e-5)
    assert min(direction @ clip.normal[4], sample.interaction_b.direction @ clip.normal[5]) > 0


def test_a_longer_horizon_predicts_a_later_frame(clip):
    """Contact in frames 3 to 7 of 12, 40 ms apart, followed to the second's end; 8 steps of the rollout a frame."""
    settings = replace(TRAJECTORY, horizon=3, onset_within=26)
    frames, _ = list_frames(clip, settings)
    assert frames == [frame for frame in list_frames(clip, replace(settings, horizon=1))[0] if frame + 3 < len(clip)]
    assert frames
    sample = make_sample(clip, 4, settings)
    assert np.array_equal(sample.window_a[-1], clip.depth(4))
    assert np.array_equal(sample.window_b, [clip.depth(10), clip.depth(9), clip.depth(8), clip.depth(7)])
    assert (sample.course_a, sample.course_b) == ((8, 32), (32, 8))


@pytest.mark.parametrize(
    ("name", "value"), [("window", 0), ("min_clip_deformation", math.nan), ("onset_within", 0), ("horizon", 0)]
)
def test_impossible_settings_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        replace(TRAJECTORY, **{name: value})
