"""One builder: a run of contact read from a prepared clip is to the last digit the one that was pushed frame by frame.

The streamed side goes through `palpate.estimators.runs`, the stored one through `data.training.samples`, as users' do.
"""

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest

from palpate.data.cache import PreparedClip
from palpate.data.clip import ClipStream
from palpate.data.contact.interaction import Interaction
from palpate.data.settings import PrepareSettings
from palpate.data.source.frames import open_source
from palpate.data.training.samples import SampleSettings, builder_of
from palpate.estimators.contract import ClipInfo
from palpate.estimators.run_tracker import Run, RunTracker
from palpate.physics.mechanics import Mechanics
from tests.data.clips import GRID, SETTINGS, remove_depth, remove_frame, stored, write_clip

MECHANICS = Mechanics()
SMOOTH = dataclasses.replace(GRID, smoothing=4.0)
"""With it the depth's noise is known, and the rest surface is the mean of many frames."""
ALONG = dataclasses.replace(SMOOTH, force_direction="displacement")
PRESS = (3, 4, 5, 6, 7)
CLIPS = {
    "press": (PRESS, {}, {3: (0.2, 8)}),
    "flicker": ((3, 4, 6, 7), {}, {3: (0.2, 8)}),
    "gap within the press": (PRESS, {"missing": 5}, {3: (None, 1)}),
    "gap behind the press": (PRESS, {"missing": 8}, {3: (None, 4)}),
    "frame without depth within the press": (PRESS, {"flat": 5}, {3: (0.2, 7)}),
    "frame without depth behind the press": ((*PRESS, 8), {"flat": 8}, {3: (None, 4)}),
    "never released": ((8, 9, 10, 11), {}, {8: (None, 3)}),
    "two presses": ((2, 3, 4, 9, 10), {}, {2: (0.12, 6), 9: (0.08, 2)}),
    "press after one whose onset was not seen": ((0, 1, 6, 7, 8), {}, {6: (0.12, 5)}),
}
"""Frames in contact of 12, 40 ms apart, and what is wrong with the clip; for every onset when its release was seen [s]
and in how many frames the tissue was followed and may be counted."""


def open_clip(folder: Path, name: str, settings: PrepareSettings) -> ClipStream:
    """One of CLIPS, written and opened."""
    contact, spoiled, _ = CLIPS[name]
    write_clip(folder, contact)
    if "missing" in spoiled:
        remove_frame(folder, spoiled["missing"])
    if "flat" in spoiled:
        remove_depth(folder, spoiled["flat"])
    return ClipStream(open_source(folder, settings.layout), settings)


def tracked(clip: ClipStream) -> dict[int, Run]:
    """Runs of contact whose onset was observed, by it, from frames pushed one by one."""
    tracker = RunTracker(ClipInfo.of(clip), MECHANICS.seconds)
    runs = [*(tracker.push(frame) for frame in clip), tracker.finish()]
    return {run.index: run for run in runs if run is not None and run.builder is not None}


def require_same(first: Interaction, second: Interaction) -> None:
    """Every array and number equal, and of one type."""
    for name in ("mesh", "load", "observation"):
        ours, theirs = (vars(getattr(interaction, name)) for interaction in (first, second))
        assert ours.keys() == theirs.keys()
        for field, value in ours.items():
            np.testing.assert_array_equal(value, theirs[field], err_msg=f"{name}.{field}", strict=True)
    assert first.time_step == second.time_step
    assert (first.sequence is None) == (second.sequence is None)
    if first.sequence is not None and second.sequence is not None:
        assert (first.sequence.noise, first.sequence.size) == (second.sequence.noise, second.sequence.size)
        np.testing.assert_array_equal(first.sequence.times, second.sequence.times)
        np.testing.assert_array_equal(first.sequence.change, second.sequence.change, strict=True)


def require_one_builder(runs: dict[int, Run], prepared: PreparedClip, settings: PrepareSettings) -> None:
    """Compare the runs of a stream with those of the same clip from a cache, whole and until any of their frames."""
    samples = SampleSettings(observation="trajectory", geometry=settings.geometry)
    onsets = np.flatnonzero(prepared.track_start == np.arange(len(prepared))).tolist()
    assert onsets == list(runs)
    for onset, run in runs.items():
        batch = builder_of(prepared, onset, samples, sequence_until=len(prepared) - 1)
        assert (run.builder.pressed, run.builder.load_seconds) == (batch.pressed, batch.load_seconds)
        for horizon, until in itertools.product((None, 3, "press"), (None, 0.0, 0.12, 0.16, 0.36)):
            told = MECHANICS, horizon, until
            require_same(run.builder.build(*told), batch.build(*told))


@pytest.mark.parametrize("geometry", [GRID, ALONG], ids=["plain", "noise known, along the motion"])
@pytest.mark.parametrize("name", CLIPS)
def test_stream_and_prepared_clip_give_the_same_interaction(name: str, geometry, tmp_path: Path) -> None:
    settings = dataclasses.replace(SETTINGS, geometry=geometry)
    clip = open_clip(tmp_path / "clip", name, settings)
    runs = tracked(clip)
    builders = {onset: run.builder for onset, run in runs.items()}
    found = {onset: (run.load_seconds, len(run.build(MECHANICS).observation.times)) for onset, run in builders.items()}
    contact, _, expected = CLIPS[name]
    assert found == {
        onset: (load and pytest.approx(load), count)
        for onset, (load, count) in expected.items()
        if onset == min(contact) or geometry.smoothing == 0  # else what was pressed before may be dented still
    }
    require_one_builder(runs, stored(clip, tmp_path / "cache"), settings)


def test_until_a_frame_a_run_is_what_was_known_then(tmp_path: Path) -> None:
    """Nothing comes from later frames: cut short, the stream says the same."""
    settings = dataclasses.replace(SETTINGS, geometry=ALONG)
    clip = open_clip(tmp_path / "clip", "press", settings)
    whole = tracked(clip)[3].builder
    tracker, compared = RunTracker(ClipInfo.of(clip), MECHANICS.seconds), 0
    for frame in clip:
        tracker.push(frame)
        if tracker.current is not None:
            for horizon in (None, 3, "press"):
                told = MECHANICS, horizon, frame.frame.time_s - whole.start
                require_same(tracker.current.builder.build(*told), whole.build(*told))
                compared += 1
    assert compared == 27
