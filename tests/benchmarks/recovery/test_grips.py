"""Suites of grips: what is compared, the table, and one small clip from pictures to numbers."""

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.harness import Row
from benchmarks.recovery import trial
from benchmarks.recovery.grips import grip_table, moving_frames
from benchmarks.recovery.suites import EVERY
from benchmarks.recovery.trial import Trial, run_trial
from palpate.data.synthetic.clip import draw_truth
from palpate.data.synthetic.grip import GrippedMotion
from palpate.data.synthetic.scene import Scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.estimators.open import settings_of

SMALL = {
    "width": 214, "height": 120, "frames": 10, "action": "grip", "onset_fraction": (0.0, 0.0), "spread": (12.0, 12.0),
    "peak_displacement": (0.02, 0.03),
}  # fmt: skip


@functools.cache
def drawn(**changes: Any) -> tuple[Scene, GrippedMotion]:
    scene, motion = draw_truth(SceneSettings(**(SMALL | changes)), 7401)
    assert isinstance(motion, GrippedMotion)
    return scene, motion


def recovery(index: int, error: float) -> Row:
    curve = np.array([[0.2, 0.6, 1.0], [0.2, 0.6 + error, 1.0], [0.01, 0.1, 0.0]])
    found = {"suite": "retraction", "index": index, "skill": 0.8, "contact_right": 0.9}
    return found | {"verdict": "relative_force", "curve": curve}


def test_the_table_holds_errors_and_coverage() -> None:
    rows = [recovery(0, 0.1), recovery(1, -0.2), {"suite": "hover", "index": 0, "contact_right": 1.0}]
    table = {(row["suite"], row["quantity"]): row for row in grip_table(rows).to_dict("records")}
    curve = table["retraction", "relative force"]
    assert (curve["n"], curve["rmse"]) == (4, pytest.approx(math.sqrt((0.1**2 + 0.2**2) / 4)))
    assert curve["coverage90"] == 0.75  # 0.1 lies within 1.645 · 0.1, 0.2 does not
    assert table["retraction", "clips whose relative force is determined"]["value"] == 1
    assert table["hover", "clips whose relative force is determined"]["value"] == 0
    assert table["hover", "moving frames whose contact is right"]["value"] == 1
    assert ("hover", "relative force") not in table


def test_contact_is_judged_where_tool_or_tissue_moves() -> None:
    scene, motion = drawn()
    moves = moving_frames(scene, motion)
    camera, vertex = scene.camera, scene.mesh.vertices[scene.vertex]
    moved = vertex + motion.field[:, scene.vertex]
    place = moved[:, :2] / moved[:, 2:] * [camera.fx, camera.fy]
    assert moves.tolist() == [False, *(np.linalg.norm(np.diff(place, axis=0), axis=1) > 1.0)]
    assert 2 < moves.sum() < 10
    assert moving_frames(*drawn(onset_fraction=(1.0, 1.0)))[1:].all()


def test_suites_are_drawn_from_settings_that_are_allowed() -> None:
    for name, suite in EVERY.items():
        if suite.of != "grip":
            continue
        settings = suite.settings(0)
        assert settings.action in ("grip", "hover", "pass")
        assert (settings.width, settings.height) == (854, 480)
        assert settings == suite.settings(5) == replace(suite.truth_settings(2, (214, 120)), **suite.errors)
        assert suite.name == name
    assert EVERY["hover"].settings(0).onset_fraction == (1.0, 1.0)


def test_what_breaks_is_a_result(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("out of tissue")

    monkeypatch.setattr(trial, "synthetic_clip", broken)
    monkeypatch.setattr(trial, "draw_truth", lambda *_: drawn())
    trial._truth.cache_clear()
    [row] = run_trial(Trial(3, 5, {"retraction": {"direct": settings_of("direct")}}))
    trial._truth.cache_clear()
    assert (row["suite"], row["index"], row["estimator"], row["status"]) == ("retraction", 3, "direct", "error")
    assert row["reason"] == "RuntimeError: out of tissue"


@pytest.mark.acceptance
def test_a_retraction_is_told_by_the_session_of_users(monkeypatch: pytest.MonkeyPatch) -> None:
    """In fewer pictures, of half the suite's size; in smaller ones the tissue moves by too few pixels."""
    for name, size in (("width", 640), ("height", 360), ("frames", 12)):
        monkeypatch.setitem(EVERY["retraction"].truth, name, size)
    [row] = run_trial(Trial(0, 7401, {"retraction": {"direct": settings_of("direct")}}))
    assert row["status"] == "ok"
    assert row["contact_right"] > 0.9
    assert row["verdict"] == "relative_force"
    true, force, _ = row["curve"]
    np.testing.assert_allclose(force, true, atol=0.1)
    assert row["skill"] > 0.5
