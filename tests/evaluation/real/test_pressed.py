"""A press of known force over dent, drawn as a depth camera would, and what can't be used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from palpate.data.source.layout import InputError
from palpate.evaluation.real.pressed import (
    CLOCK,
    damping_time,
    deepest_dent,
    evaluate_press,
    measured_force,
)
from palpate.physics.identifiability import LIMIT
from tests.evaluation.real_clips import deep, ramp, write, write_press, write_wrench

FACTOR = 0.35
"""Force over dent [N/mm]."""


@pytest.fixture(scope="module")
def ramped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_press(tmp_path_factory.mktemp("press"), ramp(100))


def noisy(force: np.ndarray, sd: float = 0.01) -> np.ndarray:
    return force + np.random.default_rng(0).normal(0, sd, len(force))


def test_a_dent_is_found_as_deep_as_it_is(ramped: Path) -> None:
    """To the unit in which depth is stored, and what the median takes off a peak."""
    np.testing.assert_allclose(deepest_dent(ramped), ramp(100), rtol=0.01, atol=0.05)


def test_pixels_without_depth_or_far_off_are_no_dent(tmp_path: Path) -> None:
    """A sensor's holes are 0, and single wild pixels are filtered out."""
    write_press(tmp_path, np.zeros(58))
    picture = deep(2.0)
    picture[10, 10] = 300
    picture[40:52, 10:22] = 0
    picture[5:15, 60:70] -= 300  # 15 mm nearer
    write(tmp_path / "depth" / "58.png", picture)
    found = deepest_dent(tmp_path)
    np.testing.assert_allclose(found[:58], 0, atol=1e-6)
    assert found[58] == pytest.approx(2.0, rel=0.02)


def test_frames_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """10 comes after 9, and other files don't count."""
    write_press(tmp_path, np.where(np.arange(60) == 59, 2.0, 0.0))
    (tmp_path / "depth" / "notes.txt").write_text("none")
    assert deepest_dent(tmp_path).argmax() == 59


def test_force_is_above_its_mean_at_rest(tmp_path: Path) -> None:
    force = np.where(np.arange(70) < 56, 0.0, 0.1 * (np.arange(70) - 56))
    np.testing.assert_allclose(measured_force(write_wrench(tmp_path / "a.csv", force)), force, atol=1e-12)
    np.testing.assert_allclose(measured_force(write_wrench(tmp_path / "b.csv", -force)), force, atol=1e-12)
    late = np.where(np.arange(70) < 20, 5.0, force)  # before the rest
    np.testing.assert_allclose(measured_force(write_wrench(tmp_path / "c.csv", late)), late, atol=1e-12)


def test_damping_is_found_again_from_many_cycles() -> None:
    frames = np.arange(120.0)
    dent = 2.5 + 1.5 * np.sin(2 * np.pi * frames / 14)
    force = FACTOR * (dent + 4.5 * np.gradient(dent))
    time, sd = damping_time(dent, noisy(force), (10, 110))
    assert time == pytest.approx(4.5, rel=0.02)
    assert CLOCK < sd < 1.05 * CLOCK
    assert sd / time < LIMIT


def test_the_deviation_of_the_damping_is_that_of_repeats() -> None:
    """The clocks' difference added to it."""
    frames, generator = np.arange(120.0), np.random.default_rng(1)
    dent = 2.5 + 1.5 * np.sin(2 * np.pi * frames / 14)
    force = FACTOR * (dent + 4.5 * np.gradient(dent))
    drawn = [damping_time(dent, force + generator.normal(0, 0.9, 120), (10, 110)) for _ in range(300)]
    times, deviations = np.array(drawn).T
    assert np.hypot(times.std(), CLOCK) == pytest.approx(deviations.mean(), rel=0.1)
    assert times.std() > 0.5 * CLOCK


def test_clocks_that_differ_by_a_frame_are_no_damping() -> None:
    frames = np.arange(120.0)
    late = 2.5 + 1.5 * np.sin(2 * np.pi * (frames + 1) / 14)
    time, sd = damping_time(2.5 + 1.5 * np.sin(2 * np.pi * frames / 14), noisy(FACTOR * late), (10, 110))
    assert 0.5 < time < 1.5
    assert sd / time > LIMIT


def test_a_scale_is_fitted_and_later_frames_are_predicted(ramped: Path, tmp_path: Path) -> None:
    force = noisy(FACTOR * ramp(100))
    found = evaluate_press(ramped, write_wrench(tmp_path / "wrench.csv", force))
    told = found.measures
    assert (told["status"], told["frames fitted"], told["frames judged"]) == ("ok", "57 to 72", "73 to 99")
    factor, low, high = (told[f"force over dent{end} [N/mm]"] for end in ("", ", low", ", high"))
    assert factor == pytest.approx(FACTOR, rel=0.01)
    assert low < factor < high < 1.05 * factor
    assert told["damping time"] == "not determined"
    assert told["RMS error of the force [N]"] < 0.02
    assert told["RMS of the force [N]"] == pytest.approx(np.sqrt(np.square(FACTOR * ramp(100)[73:]).mean()), rel=0.01)
    assert told["frames within the 90 % intervals"] > 0.7
    np.testing.assert_allclose(found.predicted, FACTOR * ramp(100), atol=0.03)
    assert found.fitted == (57, 73)
    assert found.sd[-1] > found.sd[0] > 0


def test_where_no_later_force_is_known_the_ramps_first_part_is_fitted(ramped: Path, tmp_path: Path) -> None:
    found = evaluate_press(ramped, write_wrench(tmp_path / "wrench.csv", noisy(FACTOR * ramp(73))))
    assert (found.measures["frames fitted"], found.measures["frames judged"]) == ("57 to 66", "67 to 72")
    assert found.measures["force over dent [N/mm]"] == pytest.approx(FACTOR, rel=0.02)
    assert (len(found.force), len(found.predicted)) == (73, 100)


def test_damping_over_many_cycles_counts_as_determined(tmp_path: Path) -> None:
    """Two cycles in the frames that are fitted, and a force that never pulls, since only its size is known."""
    frames = np.arange(120)
    dent = np.where(frames < 56, 0, 4 + np.sin(2 * np.pi * frames / 8))
    force = np.where(frames < 56, 0, FACTOR * (dent + 4 * np.gradient(dent)))
    assert force.min() == 0
    press = write_press(tmp_path, dent)
    found = evaluate_press(press, write_wrench(tmp_path / "wrench.csv", force))
    assert found.measures["damping time"] == "determined"
    assert found.measures["frames judged"] == "73 to 112"
    time, sd = damping_time(found.dent, found.force, found.fitted)
    assert time == pytest.approx(4, rel=0.1)
    assert sd == pytest.approx(CLOCK, rel=0.1)
    still = evaluate_press(press, write_wrench(tmp_path / "undamped.csv", FACTOR * dent))
    assert still.measures["damping time"] == "not determined"


@pytest.mark.parametrize(("frames", "rows"), [(72, 100), (100, 72)])
def test_too_few_frames_are_a_sentence(tmp_path: Path, frames: int, rows: int) -> None:
    press, wrench = write_press(tmp_path, ramp(frames)), write_wrench(tmp_path / "wrench.csv", ramp(rows))
    with pytest.raises(InputError, match=f"has {frames} frames and .*wrench.csv {rows} rows; 73 are needed"):
        evaluate_press(press, wrench)


def test_a_folder_without_depth_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="depth holds 0 depth pictures; give the folder of a press with 56 or more"):
        deepest_dent(tmp_path)
    write_press(tmp_path, np.zeros(55))
    with pytest.raises(InputError, match="depth holds 55 depth pictures"):
        deepest_dent(tmp_path)


def test_a_damaged_picture_is_a_sentence(tmp_path: Path) -> None:
    write_press(tmp_path, ramp(60))
    (tmp_path / "depth" / "58.png").write_bytes(b"none")
    with pytest.raises(InputError, match=r"58.png can't be decoded as an image"):
        deepest_dent(tmp_path)


def test_pictures_of_two_sizes_are_a_sentence(tmp_path: Path) -> None:
    write_press(tmp_path, ramp(60))
    write(tmp_path / "depth" / "58.png", deep(1.0, (50, 80)))
    with pytest.raises(InputError, match=r"58\.png has the size \(50, 80\) and the first one \(60, 80\); give those"):
        deepest_dent(tmp_path)


@pytest.mark.parametrize(
    "table",
    ["frame,Fx_N,Fy_N\n0,1,2\n", "Fx_N,Fy_N,Fz_N\n0,1,two\n", "Fx_N,Fy_N,Fz_N\n0,1\n", "\0\xff"],
)
def test_a_table_that_is_none_is_a_sentence(tmp_path: Path, table: str) -> None:
    wrench = tmp_path / "wrench.csv"
    wrench.write_text(table, encoding="latin-1")
    with pytest.raises(
        InputError, match=r"wrench.csv is no table of forces \(.+\); give a CSV file with the columns Fx_N, Fy_N, Fz_N"
    ):
        measured_force(wrench)


def test_a_missing_or_short_table_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no.csv is no table of forces"):
        measured_force(tmp_path / "no.csv")
    with pytest.raises(InputError, match=r"wrench.csv has 55 rows; 56 or more are needed, one a frame"):
        measured_force(write_wrench(tmp_path / "wrench.csv", np.zeros(55)))


def test_pictures_of_two_sizes_at_rest_are_a_sentence(tmp_path: Path) -> None:
    write_press(tmp_path, ramp(60))
    write(tmp_path / "depth" / "30.png", deep(0.0, (50, 80)))
    with pytest.raises(InputError, match="give those of one press"):
        deepest_dent(tmp_path)


def test_a_press_that_leaves_no_dent_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        evaluate_press(write_press(tmp_path, np.zeros(80)), write_wrench(tmp_path / "wrench.csv", ramp(80)))


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_force_that_is_no_number_is_a_sentence(tmp_path: Path, wrong: float) -> None:
    force = ramp(80)
    force[60] = wrong
    with pytest.raises(InputError, match=r"wrench.csv"):
        measured_force(write_wrench(tmp_path / "wrench.csv", force))


def test_colour_pictures_are_no_depth(tmp_path: Path) -> None:
    for index in range(60):
        write(tmp_path / "depth" / f"{index}.png", np.dstack([deep(0.0)] * 3))
    with pytest.raises(InputError):
        deepest_dent(tmp_path)
