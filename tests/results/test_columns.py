"""The tables' columns, and their cells."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import norm

from palpate.estimators.estimate import PressCourse
from palpate.estimators.records import CONTACTS, FRAMES, FrameEstimate, InteractionEstimate, Touch
from palpate.physics.identifiability import bounds
from tests.estimators.estimates import ESTIMATE, GOOD, frame_in_contact
from tests.results.fields import GRIP

PROMISED = (
    "frame,time_s,stiffness,stiffness_sd,damping,damping_sd,force,force_sd,contact,contact_distance,contact_u,"
    "contact_v,instrument,simulated_displacement,observed_displacement,status,damping_over_stiffness,damping_over_stiffness_sd,"
    "damping_over_stiffness_low,damping_over_stiffness_high,force_over_stiffness,force_over_stiffness_sd,"
    "force_over_stiffness_low,force_over_stiffness_high,verdict,determined"
)
DEVIATES = norm.ppf((np.arange(100_000) + 0.5) / 100_000)
"""A standard normal distribution, as evenly likely values."""


def of_frame(frame: FrameEstimate) -> dict[str, str]:
    return dict(zip(FRAMES.columns, FRAMES.row(frame), strict=True))


def of_run(run: InteractionEstimate) -> dict[str, str]:
    return dict(zip(CONTACTS.columns, CONTACTS.row(*run.rows), strict=True))


def test_the_promised_columns_are_there() -> None:
    assert set(PROMISED.split(",")) <= set(FRAMES.columns)


def test_a_frame_leaves_unknown_cells_empty() -> None:
    frame = frame_in_contact(
        "undetermined",
        (0.25, 0.125, -2.0),
        number=5,
        time_s=0.2,
        contact=True,
        touch=Touch(contact_u=3.5, contact_v=4.0),
    )
    filled = {name: value for name, value in of_frame(frame).items() if value}
    told = {"frame": "5", "time_s": "0.200000", "contact": "1", "contact_u": "3.5", "contact_v": "4"}
    told |= {"stiffness": "0.25", "damping": "0.125", "force": "2", "status": "ok", "verdict": "undetermined"}
    assert filled == told | {"damping_over_stiffness": "0.5", "force_over_stiffness": "8"}


def test_detail_stays_on_one_line() -> None:
    assert of_frame(FrameEstimate(1, 0.0, "no_mask", detail="one\ntwo,  three"))["detail"] == "one two, three"


def test_a_run_has_values_spreads_and_bounds() -> None:
    found = of_run(GOOD)
    assert found["onset_time_s"] == "0.280000"
    assert (found["onset_frame"], found["frames"], found["load_s"], found["status"]) == ("7", "8", "0.16", "ok")
    log_sds = {"stiffness": 0.1, "damping": 0.2, "force": 0.05}
    for name, value in zip(log_sds, (0.5, 0.06, 0.1), strict=True):
        assert_log_normal(found, name, value, log_sds[name])
        assert float(found[f"{name}_bound"]) == pytest.approx(log_sds[name])
    assert_log_normal(found, "damping_over_stiffness", 0.12, np.hypot(0.1, 0.2))
    assert_log_normal(found, "force_over_stiffness", 0.2, np.hypot(0.1, 0.05))
    np.testing.assert_allclose(bounds(ESTIMATE.information), [0.1, 0.2, 0.05])
    assert found["verdict"] == "determined"
    combinations = "stiffness;damping;force;damping_over_stiffness;force_over_stiffness;force_over_damping"
    assert found["determined"] == combinations
    assert found["explanation"] == ""
    assert (found["noise"], found["misfit"], found["at_bound"], found["detail"]) == ("0.001", "1.1", "", "")


def assert_log_normal(found: dict[str, str], name: str, value: float, log_sd: float) -> None:
    assert float(found[name]) == pytest.approx(value)
    draws = value * np.exp(log_sd * DEVIATES)
    assert float(found[f"{name}_sd"]) == pytest.approx(draws.std(), rel=1e-3)
    ends = [float(found[f"{name}_{end}"]) for end in ("low", "high")]
    assert ends == pytest.approx(np.quantile(draws, (0.05, 0.95)), rel=1e-4)


def test_a_run_without_estimate_has_no_numbers() -> None:
    found = of_run(InteractionEstimate(7, 7, 0.28, detail="Because."))
    told = {"onset_frame": "7", "onset_time_s": "0.280000", "frames": "0", "status": "no_estimate"}
    assert {name: value for name, value in found.items() if value} == told | {"detail": "Because."}


def test_parameters_at_their_ranges_end_and_delays_are_told() -> None:
    at_bound, delays = np.array([False, False, True]), (0.01, -0.02)
    found = of_run(
        dataclasses.replace(
            GOOD, estimate=dataclasses.replace(ESTIMATE, at_bound=at_bound, course=PressCourse(*delays))
        )
    )
    assert found["at_bound"] == "force"
    assert (float(found["delay_s"]), float(found["release_delay_s"])) == delays
    plain = of_run(GOOD)
    assert plain["delay_s"] == plain["release_delay_s"] == ""


def test_a_grip_is_told_where_nothing_else_is_determined() -> None:
    found = of_run(InteractionEstimate(0, 5, 0.0, grip=GRIP, detail="No onset."))
    assert [found[name] for name in ("verdict", "determined", "skill", "status", "frames")] == [
        *["relative_force"] * 2, "0.6", "ok", "3",
    ]  # fmt: skip
    assert found["force"] == found["stiffness"] == found["explanation"] == ""
    unexplained = of_run(InteractionEstimate(0, 5, 0.0, grip=dataclasses.replace(GRIP, skill=0.2)))
    assert (unexplained["verdict"], unexplained["status"], unexplained["skill"]) == ("", "no_estimate", "")


def test_a_press_that_is_determined_comes_before_a_grip() -> None:
    found = of_run(dataclasses.replace(GOOD, grip=GRIP))
    assert found["verdict"] == of_run(GOOD)["verdict"] == "determined"
    loose = dataclasses.replace(ESTIMATE, covariance=np.eye(3))
    vague = of_run(dataclasses.replace(GOOD, estimate=loose, grip=GRIP))
    assert (vague["verdict"], vague["explanation"]) == ("relative_force", "")
    assert vague["stiffness"] == of_run(GOOD)["stiffness"]
