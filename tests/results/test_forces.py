"""forces.json: what is known of the force in every frame of a run of contact, and for how long it is not."""

import dataclasses
import json
import math

import numpy as np
import pytest

from palpate.common.files import as_json
from palpate.estimators.estimate import PressCourse
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.physics.load import PressShape
from palpate.results.artefacts.forces import RELATIVE, ContactForce, forces_record
from tests.estimators.estimates import ESTIMATE, GOOD, NONE
from tests.results.fields import GRIP, PULL

STEP = 0.04
BLIND = dataclasses.replace(ESTIMATE, given_verdict="onset_in_view", covariance=None)


def told(run: InteractionEstimate, contact: str, *, newtons=None, calibrated=(), seconds=math.inf) -> dict:
    """What forces.json has of a run in frames of which `x` are in contact, `?` undecided, and `.` not."""
    states, onset = [{"x": True, "?": None, ".": False}[letter] for letter in contact], contact.index("x")
    estimates = [FrameEstimate(at, STEP * at, "ok", contact=touches) for at, touches in enumerate(states)]
    run = dataclasses.replace(run, onset=onset, onset_frame=onset, onset_time_s=STEP * onset)
    found = forces_record([ContactForce.of(run, estimates, newtons, seconds)], estimates, 25.0, calibrated)
    document = json.loads(as_json(found))
    return document["contacts"][0]


def test_a_press_is_held_and_unknown_after_what_was_observed_or_estimated() -> None:
    """GOOD is pressed for four frames and followed for eight after its onset."""
    found = told(GOOD, "..xxxx..")
    assert found == found | {"unit": RELATIVE, "mean": 1, "peak": 1, "mean_low": None, "why": "", "unknown_s": 0}
    assert (found["contact_frames"], found["contact_s"]) == (4, pytest.approx(4 * STEP))
    held = dataclasses.replace(GOOD, load_s=None)
    late = told(held, ".xxxxx?xxxxxx?.")  # the last undecided frame belongs to nothing
    assert late["time_s"] == pytest.approx([STEP * index for index in range(1, 13)])
    assert late["force"] == [1] * 9 + [None] * 3
    assert (late["contact_frames"], late["unknown_frames"], late["unknown_s"]) == (12, 3, pytest.approx(3 * STEP))
    assert late["why"].startswith("What the force is after the part")
    assert told(held, "xxxxxxxxxxxx", seconds=4.5 * STEP)["unknown_frames"] == 7  # the network was trained so far
    assert told(GOOD, "xx.xx")["contact_frames"] == 4  # contact flickers


def test_a_press_that_rises_and_falls() -> None:
    shape = PressShape(rise=2 * STEP, fall=2 * STEP)
    estimate = dataclasses.replace(ESTIMATE, course=PressCourse(-STEP / 2, STEP / 2, shape=shape))
    found = told(dataclasses.replace(GOOD, estimate=estimate, load_s=6 * STEP), "xxxxxx")
    assert [*found["force"], found["mean"]] == pytest.approx([0.25, 0.75, 1, 1, 1, 0.75, 4.75 / 6])


def test_a_press_in_newtons_has_the_interval_of_its_calibration() -> None:
    row = {"onset_frame": 2, "determined": "stiffness;force", "force": 0.5, "force_low": 0.4, "force_high": 0.625}
    row["force_unit"] = "N, by stiffness"
    found = told(GOOD, "..xxxx..", calibrated=[row])
    numbers = [found[f"{name}{end}"] for name in ("mean", "peak") for end in ("", "_low", "_high")]
    assert (found["unit"], numbers) == ("N, by stiffness", pytest.approx([0.5, 0.4, 0.625] * 2))
    assert told(GOOD, "..xxxx..", calibrated=[row | {"determined": "stiffness"}])["unit"] == RELATIVE


def test_a_pull_is_relative_to_its_own_peak_and_unknown_where_frames_are_missing() -> None:
    """The third, fourth, fifth and seventh of eight frames are known."""
    times, force, sd = STEP * np.array([2, 3, 4, 6]), np.array([0.5, 2.0, 1.5, 1.0]), np.full(4, 0.1)
    grip = dataclasses.replace(GRIP, times=times, force=force, force_sd=sd)
    run = dataclasses.replace(NONE, grip=grip)
    found = told(run, ".xxxxxxxx")
    assert found["force"] == [None, None, 0.25, 1, 0.75, None, 0.5, None]
    assert found["force_low"][3] == pytest.approx(1 - 1.6448536 * 0.1 / 2)
    assert (found["unit"], found["mean"], found["peak"]) == (RELATIVE, pytest.approx(2.5 / 4), 1)
    assert found["mean_high"] - found["mean"] == pytest.approx(1.6448536 * 0.1 / 2)
    assert (found["peak_time_s"], found["unknown_frames"]) == (pytest.approx(4 * STEP), 4)
    every = dataclasses.replace(grip, times=STEP * np.array([1, 3, 5, 7]))  # every second frame of a long pull
    between = told(dataclasses.replace(NONE, grip=every), "x" * 8)["force"][1:]
    assert between == pytest.approx([0.25, 0.625, 1, 0.875, 0.75, 0.625, 0.5])
    in_newtons = told(run, ".xxxxxxxx", newtons=np.outer([-2, -3, -1], force))
    assert [in_newtons[f"peak{end}"] for end in ("", "_low", "_high", "_time_s")] == [-4, -6, -2, pytest.approx(0.16)]
    assert in_newtons["unit"] == "N, by the force that was measured for a while"


@pytest.mark.parametrize(
    ("run", "why"),
    [
        (NONE, "Because."),
        (dataclasses.replace(NONE, detail=""), "Nothing is determined of the force."),
        (dataclasses.replace(GOOD, estimate=dataclasses.replace(ESTIMATE, covariance=np.eye(3))), "Nothing is"),
        (dataclasses.replace(GOOD, estimate=dataclasses.replace(ESTIMATE, misfit=9.0)), "Nothing is determined"),
        (dataclasses.replace(NONE, field=PULL), "--estimator online tells no force."),
        (dataclasses.replace(GOOD, estimate=BLIND), "The onset was observed; the model does not say what"),
    ],
)
def test_where_nothing_is_determined_all_of_the_contact_is_unknown(run: InteractionEstimate, why: str) -> None:
    found = told(run, ".xxx")
    assert found == found | {"unit": "", "mean": None, "peak": None, "peak_time_s": None, "force": [None] * 3}
    assert (found["unknown_frames"], found["unknown_s"]) == (3, pytest.approx(3 * STEP))
    assert found["why"].startswith(why)
