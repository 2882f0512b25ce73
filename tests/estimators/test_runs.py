"""Runs of contact gathered frame by frame are those that a whole clip shows."""

import math
import threading
from concurrent.futures import Executor
from concurrent.futures.process import BrokenProcessPool
from typing import NamedTuple
from unittest.mock import create_autospec

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as some

from palpate.api import open_estimator
from palpate.data.contact.interaction import Interaction
from palpate.data.prepared import OUT_OF_CONTACT, STATUSES, PreparedFrame
from palpate.data.shading.sequence import RestingLight
from palpate.estimators import run_tracker
from palpate.estimators import runs as module
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip.grip_estimate import PullResult
from palpate.estimators.grip.recorder import GripRecorder
from palpate.estimators.records import InteractionEstimate
from palpate.estimators.run_tracker import Run, RunTracker
from palpate.estimators.runs import frame_estimate
from palpate.physics.mechanics import Mechanics
from tests.estimators.sessions import State, clip_info, follow, linked, prepared_frame, touched
from tests.physics.sheets import sheet

MESH = sheet(5, 5)
CONTACT = touched(MESH, 12, np.array([0.0, 0.0, -1.0]), 0.001)
SECONDS = 1.0


class Seen(NamedTuple):
    """A run of contact of a whole clip."""

    first: int
    last: int
    onset_seen: bool
    load_s: float | None


def whole_clip_runs(frames: list[PreparedFrame], bridge_frames: int) -> list[Seen]:
    """Runs by their definition: contact of one tracked point that is missing on at most `bridge_frames` in a row."""
    runs: list[list[int]] = []
    for index in [index for index, frame in enumerate(frames) if frame.in_contact]:
        frame = frames[index]
        begins = frame.track_start == index
        same = runs and frames[runs[-1][0]].track_start == frame.track_start
        if same and not begins and index - runs[-1][-1] - 1 <= bridge_frames:
            runs[-1].append(index)
        else:
            runs.append([index])
    found = []
    for first, *_, last in ([*run, run[-1]] for run in runs):
        onset_seen = frames[first].track_start == first
        after = frames[last + 1] if last + 1 < len(frames) else None
        released = after is not None and frames[last].consecutive and after.status in OUT_OF_CONTACT
        load = after.frame.time_s - frames[first].frame.time_s if onset_seen and released else None
        found.append(Seen(first, last, onset_seen, load))
    return found


def tracked_runs(frames: list[PreparedFrame], bridge_frames: int) -> list[Run]:
    """Runs of a tracker to which the frames are given one by one."""
    tracker = RunTracker(clip_info(bridge_frames=bridge_frames), SECONDS)
    found = [tracker.push(frame) for frame in frames] + [tracker.finish()]
    assert tracker.finish() is None
    return [run for run in found if run is not None]


states = some.builds(
    State,
    status=some.one_of(some.sampled_from(("ok", "no_contact")), some.sampled_from(STATUSES)),
    missing=some.sampled_from((0, 0, 0, 0, 0, 1, 3)),
    rested=some.sampled_from((True, True, True, False)),
)


def clip_of(words: str) -> list[State]:
    """ok, no_contact, bad_depth and unreadable frames by their first letters."""
    names = {name[0]: name for name in ("ok", "no_contact", "bad_depth", "unreadable")}
    return [State(names[letter]) for letter in words]


@settings(max_examples=300, deadline=None)
@given(some.lists(states, max_size=40), some.integers(0, 3))
@example(clip_of("nooonnoonnnnnnnnnnnoooo"), 2)
@example(clip_of("ooonooobbooouooo"), 1)
def test_runs_are_those_of_the_whole_clip(clip: list[State], bridge_frames: int) -> None:
    frames = linked(clip, CONTACT, bridge_frames)
    runs = tracked_runs(frames, bridge_frames)
    loads = [None if run.builder is None else run.builder.load_seconds for run in runs]
    found = [Seen(run.index, run.last, run.builder is not None, load) for run, load in zip(runs, loads, strict=True)]
    assert found == whole_clip_runs(frames, bridge_frames)


@pytest.mark.parametrize(
    ("words", "runs"),
    [
        ("nnooonn", [Seen(2, 4, True, 0.12)]),
        ("nnooo", [Seen(2, 4, True, None)]),
        ("ooonn", [Seen(0, 2, False, None)]),
        ("nononoonnn", [Seen(1, 6, True, 0.24)]),  # flicker
        ("nooonnnoo", [Seen(1, 3, True, 0.12), Seen(7, 8, True, None)]),  # contact was missing on three frames
        ("noobnnn", [Seen(1, 2, True, None)]),  # nobody saw the release
        ("noouoon", [Seen(1, 2, True, None), Seen(4, 5, False, None)]),
        ("oonoo", [Seen(0, 4, False, None)]),
    ],
)
def test_small_clips(words: str, runs: list[Seen]) -> None:
    frames = linked(clip_of(words), CONTACT)
    expected = [seen._replace(load_s=seen.load_s and pytest.approx(seen.load_s)) for seen in runs]
    assert whole_clip_runs(frames, 2) == expected
    assert [run.index for run in tracked_runs(frames, 2)] == [seen.first for seen in runs]


def test_why_nothing_is_known_of_a_run() -> None:
    unseen, unfollowed = (tracked_runs(linked(clip_of(words), CONTACT), 2)[0] for words in ("oon", "noon"))
    assert unseen.unobserved == run_tracker.NO_ONSET
    lost = "The tissue at the contact could not be followed after its onset."
    assert unfollowed.unobserved == f"{unfollowed.detail} {lost}".strip()
    assert len(unfollowed.builder.build(Mechanics()).observation) == 0


def judged(*probabilities: float) -> list[PreparedFrame]:
    """A clip whose tool is at tissue in the picture and hovers where the probability of contact is below a half."""
    states = [State("ok" if each >= 0.5 else "no_contact", probability=each) for each in probabilities]
    return linked(states, CONTACT)


def test_a_run_whose_tool_hovers_was_none_unless_tissue_ever_moved_with_it() -> None:
    passing, released, unknown = judged(0.7, 0.1, 0.0), judged(0.7, 0.95, 0.6, 0.2), judged(0.7, 0.8, 0.7)
    (run,) = tracked_runs(passing, 2)
    assert (run.passed, run.estimate().load_s) == (True, None)
    assert run.unobserved.startswith("No contact: the instrument moves")
    for frames in (released, unknown):
        (run,) = tracked_runs(frames, 2)
        assert (run.passed, run.unobserved) == (False, run_tracker.NO_ONSET)
    # A tool that hovers long after another run says nothing of it.
    assert [run.passed for run in tracked_runs(judged(0.7, *[math.nan] * 4, 0.7, 0.1), 2)] == [False, True]


def test_a_run_that_begins_where_a_hovering_tool_stops_is_undecided() -> None:
    """It may be a press: that the tool hovers before and afterwards speaks against neither."""
    hovers = State("no_contact", probability=0.1)
    stands, sunk = State("ok", probability=0.7, undecided=True), State("ok", probability=0.99)
    frames = linked([State("no_contact"), hovers, stands, stands, hovers], CONTACT)
    (run,) = tracked_runs(frames, 2)
    assert (run.passed, run.unobserved) == (False, f"{run_tracker.UNDECIDED} {run_tracker.NO_ONSET}")
    told = frame_estimate(frames[2], clip_info(), whole=True)
    assert (told.status, told.contact, told.detail) == ("ok", None, run_tracker.UNDECIDED)
    assert told.touch.contact_probability == pytest.approx(0.7)
    (run,) = tracked_runs(linked([State("no_contact"), hovers, stands, sunk, hovers], CONTACT), 2)
    assert (run.passed, run.unobserved) == (False, run_tracker.NO_ONSET)


def test_contact_after_hovering_has_no_onset() -> None:
    """When tissue began to follow the tool is known some frames late, and what it was like at rest is not."""
    (_, held) = tracked_runs(judged(math.nan, 0.7, *[0.1] * 4, 0.8, 0.99), 2)
    assert (held.index, held.builder) == (6, None)
    assert tracked_runs(linked(clip_of("nnoo"), CONTACT), 2)[0].builder is not None


def test_frames_say_how_contact_is_known() -> None:
    told = [frame_estimate(frame, clip_info(), whole=True) for frame in judged(0.7, 0.95, 0.2, math.nan)]
    assert [item.contact for item in told] == [None, True, False, False]
    assert [item.touch.contact_probability for item in told] == [0.7, 0.95, 0.2, None]
    assert [item.detail for item in told[:2]] == [module.OUTLINES_ALONE, ""]


def test_a_run_keeps_what_was_seen_of_it() -> None:
    """Displacements from rest at the frames' times, up to the horizon; a lost point gives none."""
    moved = [(0.0, 0.0, 0.001 * index) for index in range(32)]
    moved[3] = None
    clip = [State("ok" if index < 6 else "no_contact", moved=place) for index, place in enumerate(moved)]
    frames = linked([State("no_contact"), *clip], CONTACT)
    assert frames[-1].track_start == -1  # it is followed over 0.3 s
    (run,) = tracked_runs(frames, 2)
    seen = run.builder.build(Mechanics()).observation
    kept = [1, 2, 4, 5, 6, 7]
    np.testing.assert_allclose(seen.times, np.array(kept) / 25)
    np.testing.assert_allclose(seen.displacement[0], [moved[index] for index in kept], atol=1e-7)
    assert run.estimate().load_s == pytest.approx(6 / 25)
    assert (run.number, run.time_s) == (1, pytest.approx(0.04))


def test_without_a_noise_level_rest_is_where_the_point_was_at_the_onset() -> None:
    """With one, it is the smoothed surface."""
    position = MESH.vertices[12] + np.array([0.0, 0.0, 0.01])
    for noise, rest in ((math.nan, position), (0.001, MESH.vertices[12])):
        found, tracker = touched(MESH, 12, CONTACT.normal, noise), RunTracker(clip_info(), SECONDS)
        tracker.push(prepared_frame(0, "ok", found, track_start=0, track_position=position))
        np.testing.assert_allclose(tracker.current.builder.rest, rest, rtol=1e-6)


def test_a_grip_that_is_not_explained_says_so() -> None:
    grip = PullResult(0.2, -math.inf, *np.ones((3, 2)))
    recorder = create_autospec(GripRecorder, instance=True)
    recorder.motion.return_value.estimate.return_value = grip
    record = InteractionEstimate(0, 0, 0.0, detail="No onset.")
    found = module.RunSession(clip_info(), Mechanics())._gripped(record, recorder, True)
    assert found.grip is grip
    assert found.detail == "No onset. A gripped sheet doesn't explain the motion (skill 0.20)."


def test_fits_of_a_live_source_wait_and_more_than_four_are_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    made, session = threading.Event(), module.RunSession(clip_info(), Mechanics())

    def recorded(run: Run, _: object) -> InteractionEstimate:
        made.wait()
        return run.estimate()

    monkeypatch.setattr(session, "_recorded", recorded)
    session.by_light, session.fitter = True, create_autospec(Executor, instance=True)
    runs = [Run(frame, clip_info(), SECONDS, RestingLight()) for frame in linked([State("ok")] * 6, CONTACT)]
    said = [found for run in runs for found in session._ended(run)]
    assert [(found.onset_frame, found.detail) for found in said] == [(4, module.TOO_MANY), (5, module.TOO_MANY)]
    made.set()
    assert [(found.onset_frame, found.detail) for found in session.finish()] == [(index, "") for index in range(4)]


def test_pulls_of_a_live_source_are_fitted_by_the_process_and_wait_as_presses_do() -> None:
    """Their fits take as long, and frames come meanwhile."""
    session, fitter = module.RunSession(clip_info(), Mechanics()), create_autospec(Executor, instance=True)
    session.fitter, recorder = fitter, create_autospec(GripRecorder, instance=True)
    grip = fitter.submit.return_value.result.return_value = PullResult(0.9, -math.inf, *np.ones((3, 2)))
    session._grip = recorder
    (first, *_) = linked([State("ok")] * 2, CONTACT)
    said = [*session._ended(Run(first, clip_info(), SECONDS)), *session.finish()]
    assert [found.grip for found in said] == [grip]
    fitter.submit.assert_called_once_with(recorder.motion.return_value.estimate)


def test_a_fit_whose_process_is_gone_says_so() -> None:
    session, fitter = module.RunSession(clip_info(), Mechanics()), create_autospec(Executor, instance=True)
    fitter.submit.side_effect, session.fitter = BrokenProcessPool, fitter
    with pytest.raises(NoEstimate, match="killed, maybe for want of memory"):
        session._computed(module.fit_shading, create_autospec(Interaction, instance=True), 0.04)


@pytest.mark.parametrize(("name", "followed"), [("direct", True), ("network", False)])
def test_motion_around_the_instrument_is_recorded_after_an_onset_that_was_seen(
    name: str, followed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`direct` estimates a grip wherever the press is undetermined; `network` only where depth tells nothing."""
    made = create_autospec(GripRecorder)
    made.return_value.motion.return_value.estimate.return_value = PullResult(0.5, -math.inf, *np.ones((3, 2)))
    monkeypatch.setattr(module, "GripRecorder", made)
    frames = linked([State("no_contact"), *[State("ok")] * 2], CONTACT)
    (run,) = follow(open_estimator(name).start(clip_info()), frames)[1]
    assert (run.onset_frame, made.called, run.grip is not None) == (1, followed, followed)
