"""Runs of contact, rows of the table, and the clip's folder."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from data.collected import CollectedClip
from data.samples import ContactCase
from estimators.estimate import ContactEstimate
from evaluation.contact_picture import MOST_PANELS, along_force, draw_fits, fitted_path, shown_path
from evaluation.contact_results import (
    COLUMNS,
    ContactResult,
    ContactRun,
    contact_runs,
    count_contacts,
    doubts,
    load_seconds,
    table_row,
    write_contacts,
)
from evaluation.results import COLUMNS as FRAME_COLUMNS
from physics.identifiability import bounds
from physics.mechanics import Mechanics
from physics.mesh import contact_normal
from tests.physics.sheets import sheet

MECHANICS = Mechanics(time_step=0.0025, steps=400, scheme="dkd")
RANGES = ((0.05, 1.0), (0.005, 0.5), (0.01, 0.3))
MESH = sheet(9, 9)
CASE = ContactCase(
    mesh=MESH,
    vertex=40,
    direction=contact_normal(MESH, 40).astype(np.float32),
    load_steps=64,
    steps=16 * np.arange(1, 9) - 1,
    displacement=np.zeros((8, 3), np.float32),
    weight=np.ones(8, np.float32),
    noise=0.001,
)
ESTIMATE = ContactEstimate(
    theta=np.array([0.5, 0.06, -0.1]),
    covariance=np.diag([0.01, 0.04, 0.0025]),
    information=np.diag([100.0, 25.0, 400.0]),
    noise=0.001,
    misfit=1.1,
    at_bound=np.zeros(3, bool),
)
GOOD = ContactResult(7, 0.28, 0.16, CASE, ESTIMATE)
DEVIATES = norm.ppf((np.arange(100_000) + 0.5) / 100_000)
"""A standard normal distribution, as evenly likely values."""


def clip(contact: str, starts: list[int]) -> CollectedClip:
    """A clip from a picture of its contact ('#' in contact, 'x' before a gap in the numbers, '?' not known)."""
    found = CollectedClip("clip", 25.0, [])
    found._meshes = [None] * len(contact)
    found.contact = np.array([letter in "#x" for letter in contact])
    statuses = {"#": "ok", "x": "ok", "?": "bad_depth"}
    found.status = [statuses.get(letter, "no_tool") for letter in contact]
    found.consecutive = np.array([letter != "x" for letter in contact])
    found.consecutive[-1] = False
    found.track_start = np.array(starts)
    found.times = 0.04 * np.arange(len(contact))
    return found


@pytest.mark.parametrize(
    ("contact", "starts", "runs"),
    [
        ("..##..", [-1, -1, 2, 2, 2, 2], [(2, 3, True)]),
        ("##....", [-1] * 6, [(0, 1, False)]),
        ("..#.#.", [-1, -1, 2, 2, 2, 2], [(2, 4, True)]),  # one frame of flicker
        ("#...##", [0, 0, 0, 0, 4, 4], [(0, 0, True), (4, 5, True)]),
        ("##..##", [-1] * 6, [(0, 1, False), (4, 5, False)]),
        ("##.###", [-1, -1, -1, 3, 3, 3], [(0, 1, False), (3, 5, True)]),
        ("......", [-1] * 6, []),
    ],
)
def test_runs_of_contact(contact: str, starts: list[int], runs: list[tuple[int, int, bool]]) -> None:
    assert contact_runs(clip(contact, starts), 1) == [ContactRun(*run) for run in runs]


def test_the_load_lasts_from_a_seen_onset_to_a_seen_release() -> None:
    assert load_seconds(clip("..##..", [-1, -1, 2, 2, 2, 2]), ContactRun(2, 3, True)) == pytest.approx(0.08)
    assert load_seconds(clip("..####", [-1, -1, 2, 2, 2, 2]), ContactRun(2, 5, True)) is None
    assert load_seconds(clip("..#x..", [-1, -1, 2, 2, -1, -1]), ContactRun(2, 3, True)) is None
    assert load_seconds(clip("..##?.", [-1, -1, 2, 2, -1, -1]), ContactRun(2, 3, True)) is None
    assert load_seconds(clip("####..", [-1] * 6), ContactRun(0, 3, False)) is None


def test_a_row_has_values_spreads_and_bounds() -> None:
    row = dict(zip(COLUMNS, table_row(GOOD), strict=True))
    assert row["onset_time_s"] == "0.280000"
    assert (row["onset_frame"], row["frames"], row["load_s"], row["status"]) == ("7", "8", "0.16", "ok")
    for name, value, log_sd in (("stiffness", 0.5, 0.1), ("damping", 0.06, 0.2), ("force", 0.1, 0.05)):
        assert float(row[name]) == pytest.approx(value)
        draws = value * np.exp(log_sd * DEVIATES)  # log-normal, as in parameters.csv
        assert float(row[f"{name}_sd"]) == pytest.approx(draws.std(), rel=1e-3)
        ends = [float(row[f"{name}_{end}"]) for end in ("low", "high")]
        assert ends == pytest.approx(np.quantile(draws, (0.05, 0.95)), rel=1e-4)
        assert float(row[f"{name}_bound"]) == pytest.approx(log_sd)
    np.testing.assert_allclose(bounds(ESTIMATE.information), [0.1, 0.2, 0.05])
    assert row["verdict"] == "determined"
    assert row["explanation"] == "F (±0.05), k_s (±0.1), k_d (±0.2) are determined"
    assert (row["noise"], row["misfit"], row["at_bound"], row["detail"]) == ("0.001", "1.1", "", "")


def test_uncertainty_has_the_names_and_the_order_of_the_table_of_frames() -> None:
    def of_parameters(columns: dict[str, str]) -> list[str]:
        return [name for name in columns if name.startswith(("stiffness", "damping", "force"))]

    assert of_parameters(COLUMNS) == of_parameters(FRAME_COLUMNS)
    assert len(of_parameters(COLUMNS)) == 15


def test_a_run_without_estimate_has_no_numbers() -> None:
    row = dict(zip(COLUMNS, table_row(ContactResult(7, 0.28, None, None, None, "Because.")), strict=True))
    filled = {name: value for name, value in row.items() if value}
    assert filled == {
        "onset_frame": "7",
        "onset_time_s": "0.280000",
        "frames": "0",
        "status": "no_estimate",
        "detail": "Because.",
    }


def test_doubts_name_a_misfit_and_parameters_at_their_ranges_end() -> None:
    assert doubts(ESTIMATE, RANGES) == ""
    assert doubts(dataclasses.replace(ESTIMATE, misfit=1.5), RANGES) == ""
    poor = dataclasses.replace(ESTIMATE, misfit=2.34, at_bound=np.array([False, False, True]))
    told = doubts(poor, RANGES)
    assert told.startswith("The model does not explain the data: they lie 2.3 times the noise from it")
    assert told.endswith("The best fit lies at the end of the force's admissible range, 0.01 to 0.3.")
    stuck = dataclasses.replace(GOOD, estimate=poor, detail=told)
    assert dict(zip(COLUMNS, table_row(stuck), strict=True))["at_bound"] == "force"


def test_doubts_name_a_press_aslant_to_the_line_of_sight_whose_uncertainties_were_widened() -> None:
    facing, aslant = (dataclasses.replace(ESTIMATE, misfit=7.0, view_angle=angle) for angle in (3.0, 12.0))
    misfit = "The model does not explain the data: they lie 7 times the noise from it"
    assert doubts(facing, RANGES) == f"{misfit}, so the uncertainties are too small."
    angle = (
        "The tissue is pressed at 12° to the line of sight, so its dent may hide its own bottom; intervals are widened."
    )
    assert doubts(aslant, RANGES) == f"{angle} {misfit}."
    assert doubts(dataclasses.replace(aslant, misfit=1.0), RANGES) == angle


def test_counts_by_verdict() -> None:
    failed = ContactResult(1, 0.0, None, None, None, "")
    loose = dataclasses.replace(GOOD, estimate=dataclasses.replace(ESTIMATE, covariance=np.eye(3)))
    assert count_contacts([failed, GOOD, loose, GOOD]) == {"determined": 2, "undetermined": 1, "no_estimate": 1}
    assert count_contacts([]) == {}


def test_the_folder_replaces_an_earlier_one_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "clip"
    write_contacts(folder, [GOOD], MECHANICS, {"program": "estimate.py"}, "clip")
    write_contacts(folder, [], MECHANICS, {"program": "estimate.py"}, "clip")
    with (folder / "contacts.csv").open(encoding="utf-8", newline="") as stream:
        assert list(csv.reader(stream)) == [list(COLUMNS)]

    def fail(*_: object) -> None:
        raise RuntimeError

    monkeypatch.setattr("evaluation.contact_results.write_record", fail)
    with pytest.raises(RuntimeError):
        write_contacts(folder, [GOOD], MECHANICS, {}, "clip")
    assert [path.name for path in tmp_path.iterdir()] == ["clip"]
    assert len((folder / "contacts.csv").read_text(encoding="utf-8").splitlines()) == 1


def test_displacements_count_along_the_force() -> None:
    """F < 0 presses against the normal, so motion against it is positive."""
    pressed = -0.02 * CASE.direction[None].astype(float)
    np.testing.assert_allclose(along_force(CASE, ESTIMATE.theta, pressed), [0.02], rtol=1e-6)
    np.testing.assert_allclose(along_force(CASE, -ESTIMATE.theta, pressed), [-0.02], rtol=1e-6)
    path = along_force(CASE, ESTIMATE.theta, fitted_path(CASE, ESTIMATE, MECHANICS))
    assert path.shape == (CASE.steps[-1] + 1,)
    assert (path[:64] > 0).all()
    # While the force lasts the motion begins with F/m·t²/2, damping and springs being zero at first.
    assert path[0] == pytest.approx(0.1 / 0.001 * 0.0025**2 / 2, rel=0.1)


def test_a_press_that_began_earlier_has_moved_for_longer() -> None:
    shift = 8 * MECHANICS.time_step
    early, late = (dataclasses.replace(ESTIMATE, delays=(delay, delay)) for delay in (-shift, shift))
    plain = fitted_path(CASE, ESTIMATE, MECHANICS)
    assert len(fitted_path(CASE, early, MECHANICS)) == len(plain) + 8
    np.testing.assert_array_equal(fitted_path(CASE, early, MECHANICS)[: len(plain)], plain)
    np.testing.assert_array_equal(fitted_path(CASE, late, MECHANICS), plain)
    held = dataclasses.replace(ESTIMATE, delays=(0.0, shift))
    longer = fitted_path(CASE, held, MECHANICS)
    np.testing.assert_array_equal(longer[: CASE.load_steps], plain[: CASE.load_steps])
    assert not np.allclose(longer[CASE.load_steps + 1 :], plain[CASE.load_steps + 1 :], atol=1e-5)
    # What is drawn is at rest until the press begins, and then the same motion.
    times, shown = shown_path(CASE, late, MECHANICS)
    assert not shown[times < shift].any()
    _, usual = shown_path(CASE, ESTIMATE, MECHANICS)
    np.testing.assert_allclose(np.interp(times[:-8], times - shift, shown), usual[:-8], atol=1e-4)


def test_a_release_is_drawn_where_one_was_seen() -> None:
    def releases(load_steps: int, *delays: float) -> int:
        estimate = dataclasses.replace(ESTIMATE, delays=delays)
        result = dataclasses.replace(GOOD, case=dataclasses.replace(CASE, load_steps=load_steps), estimate=estimate)
        return int((draw_fits([result], MECHANICS, "clip") == (234, 88, 12)).all(axis=2).sum())

    assert releases(CASE.load_steps) > 100
    assert releases(CASE.load_steps, -0.01, -0.01) > 100
    assert releases(MECHANICS.steps, -0.01) == 0


def test_delays_are_told_and_doubted_at_the_end_of_their_range() -> None:
    found = dict(zip(COLUMNS, table_row(dataclasses.replace(GOOD, estimate=with_delays(0.01, -0.02))), strict=True))
    assert (float(found["delay_s"]), float(found["release_delay_s"])) == (0.01, -0.02)
    plain = dict(zip(COLUMNS, table_row(GOOD), strict=True))
    assert plain["delay_s"] == plain["release_delay_s"] == ""
    stuck = dataclasses.replace(with_delays(0.04), delays_at_end=True)
    ranges = ((0.05, 1.0), (0.005, 0.5), (0.01, 0.3))
    assert "begun or ended a whole frame" in doubts(stuck, ranges)
    assert "begun" not in doubts(with_delays(0.01), ranges)


def with_delays(*delays: float) -> ContactEstimate:
    return dataclasses.replace(ESTIMATE, delays=delays)


def test_the_picture_has_a_panel_for_each_fit_up_to_a_number() -> None:
    heights = [len(draw_fits([GOOD] * count, MECHANICS, "clip")) for count in (0, 1, 2, MOST_PANELS, MOST_PANELS + 3)]
    assert heights[2] - heights[1] == heights[1] - heights[0] > 300
    assert heights[3] == heights[4] == heights[0] + MOST_PANELS * (heights[1] - heights[0])
    assert len(draw_fits([ContactResult(1, 0.0, None, None, None, "")], MECHANICS, "clip")) == heights[0]
