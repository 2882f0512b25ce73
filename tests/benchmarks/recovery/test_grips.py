"""Suites of grips: what is compared, the table, and one small clip from pictures to numbers."""

import dataclasses
import functools
import math
from typing import Any

import numpy as np
import pytest

from benchmarks.harness import Row
from benchmarks.recovery import trial
from benchmarks.recovery.grip_truth import compare_fields, moving_frames, picture_motion, true_log
from benchmarks.recovery.grips import grip_table
from benchmarks.recovery.suites import EVERY
from benchmarks.recovery.trial import Trial, run_trial
from palpate.data.synthetic.clip import draw_truth
from palpate.data.synthetic.grip import GrippedMotion
from palpate.data.synthetic.render import rest_view
from palpate.data.synthetic.scene import Scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.surface import deformed_view
from palpate.estimators.grip.stiffness_fit import StiffnessField
from palpate.estimators.open import EstimatorOptions

SMALL = {
    "width": 214, "height": 120, "frames": 10, "action": "grip", "onset_fraction": (0.0, 0.0), "spread": (12.0, 12.0),
    "peak_displacement": (0.02, 0.03),
}  # fmt: skip


@functools.cache
def drawn(**changes: Any) -> tuple[Scene, GrippedMotion]:
    scene, motion = draw_truth(SceneSettings(**(SMALL | changes)), 7401)
    assert isinstance(motion, GrippedMotion)
    return scene, motion


def recovery(index: int, error: float, **changes) -> Row:
    foundation = np.array([-3.0, -3.0 + error, 0.1])
    curve = np.array([[0.2, 0.6, 1.0], [0.2, 0.65, 1.0], [0.01, 0.02, 0.0]])
    found = {"suite": "retraction", "index": index, "skill": 0.8, "contact_right": 0.9, "verdict": "foundation"}
    return found | {"foundation": foundation, "force": foundation + 8.0, "curve": curve} | changes


def test_the_table_holds_errors_and_what_intervals_hold() -> None:
    rows = [recovery(0, 0.1), recovery(1, -0.2), {"suite": "hover", "index": 0, "contact_right": 1.0}]
    table = {(row["suite"], row["quantity"]): row for row in grip_table(rows).to_dict("records")}
    found = table["retraction", "foundation over stiffness"]
    error = math.sqrt((0.1**2 + 0.2**2) / 2)
    assert (found["n"], found["rmse"]) == (2, pytest.approx(error))
    assert found["coverage90"] == 0.5  # 0.1 lies within 1.645 · 0.1, 0.2 does not
    curve = table["retraction", "relative force"]
    assert (curve["n"], curve["coverage90"]) == (4, 0.5)
    assert table["retraction", "clips whose foundation is determined"]["value"] == 1
    assert table["hover", "clips whose foundation is determined"]["value"] == 0
    assert table["hover", "moving frames whose contact is right"]["value"] == 1
    assert ("hover", "relative force") not in table


def test_a_stiffness_field_is_compared_where_tissue_moves() -> None:
    scene, motion = drawn(regions=3.0)
    row, column = np.mgrid[8:112:8, 8:206:8]
    points = np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    true = 5 * picture_motion(scene, motion, 9, points)  # of a picture five times as wide, say
    moves = np.linalg.norm(true, axis=1) > 5
    shape, low, extent = (25, 13), points.min(axis=0), np.ptp(points, axis=0)
    log = true_log(points, scene, motion)
    # Knots lie at the points, columns outside: the truth itself, and all but a knot of what moves known exactly.
    knots = log.reshape(row.shape).T.ravel()
    sure = 1e-4 * np.eye(len(knots))
    picture = np.zeros((120, 214, 3), np.uint8)
    field = StiffnessField(shape, low, extent, knots, sure, 9 * sure, 0.0, points[moves], 0.0, picture)
    found = compare_fields(field, points, true, scene, motion)
    assert (found["rank"], found["held"], found["knots"]) == (pytest.approx(1), 1, moves.sum())
    share = (log[moves] > 0.5 * (motion.log_stiffness.max() + motion.log_stiffness.min())).mean()
    assert found["rank_most"] == pytest.approx(math.sqrt(3 * share * (1 - share)))
    off = knots.copy()
    place = np.flatnonzero(moves.reshape(row.shape).T.ravel())[0]
    off[place] += 1.0
    told = compare_fields(dataclasses.replace(field, log_stiffness=off), points, true, scene, motion)
    # The others are off, too, because their mean is.
    assert told["rank"] < 1
    assert told["held"] <= 1 - 1 / moves.sum()


def test_true_motion_is_that_of_the_pictures() -> None:
    scene, motion = drawn()
    view = deformed_view(scene, motion, 9, rest_view(scene))
    row, column = np.mgrid[10:110:10, 10:204:10]
    points = np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    moved = picture_motion(scene, motion, 9, points)
    assert np.linalg.norm(moved, axis=1).max() > 3
    for point, shift in zip(points, moved, strict=True):
        at = np.rint(point + shift).astype(int)
        came = np.array([view.rest_u[at[1], at[0]], view.rest_v[at[1], at[0]]])
        # To within the picture's pixels, and what the motion stretches between them.
        np.testing.assert_allclose(came, point, atol=1.2)


def test_contact_is_judged_where_tool_or_tissue_moves() -> None:
    scene, motion = drawn()
    moves = moving_frames(scene, motion)
    place = scene.mesh.pixels[scene.vertex][None, ::-1].astype(np.float64)
    ways = [picture_motion(scene, motion, index, place)[0] for index in range(10)]
    steps = np.linalg.norm(np.diff(ways, axis=0), axis=1)
    assert moves.tolist() == [False, *(steps > 1.0)]
    assert 2 < moves.sum() < 10
    assert moving_frames(*drawn(onset_fraction=(1.0, 1.0)))[1:].all()


def test_suites_are_drawn_from_settings_that_are_allowed() -> None:
    for name, suite in EVERY.items():
        if suite.of != "grip":
            continue
        settings = suite.settings(0)
        assert settings.action == "grip"
        assert (settings.width, settings.height) == (854, 480)
        assert settings == suite.settings(5) == suite.truth_settings(2, (214, 120))
        assert suite.name == name
    assert EVERY["hover"].settings(0).onset_fraction == (1.0, 1.0)


def test_what_breaks_is_a_result(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("out of tissue")

    monkeypatch.setattr(trial, "synthetic_clip", broken)
    monkeypatch.setattr(trial, "draw_truth", lambda *_: drawn())
    trial._truth.cache_clear()
    [row] = run_trial(Trial(3, 5, {"retraction": {"direct": EstimatorOptions("direct")}}))
    trial._truth.cache_clear()
    assert (row["suite"], row["index"], row["estimator"], row["status"]) == ("retraction", 3, "direct", "error")
    assert row["reason"] == "RuntimeError: out of tissue"


@pytest.mark.slow
def test_a_retraction_is_told_by_the_session_of_users(monkeypatch: pytest.MonkeyPatch) -> None:
    """In fewer pictures, of half the suite's size; in smaller ones the tissue moves by too few pixels."""
    for name, size in (("width", 640), ("height", 360), ("frames", 12)):
        monkeypatch.setitem(EVERY["retraction"].truth, name, size)
    [row] = run_trial(Trial(0, 7401, {"retraction": {"direct": EstimatorOptions("direct", threads=1)}}))
    assert row["status"] == "ok"
    assert row["contact_right"] > 0.9
    assert row["verdict"] == "foundation"
    assert abs(row["foundation"][1] - row["foundation"][0]) < 0.7
    assert row["skill"] > 0.5
