"""The benchmark of the online estimator judges every method on the same truth."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import online, online_cost
from estimators.online.objective import Weights
from physics.pbd.stiffness import Stiffness


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"ROWS": 7, "COLUMNS": 6, "POINTS": 400, "FOLLOWED": 40, "HORIZON": 3}.items():
        monkeypatch.setattr(online, name, value)


def test_the_truth_flows_down_its_energy(small: None) -> None:
    """It holds what is pinned, follows the grip, and settles under one that stands still."""
    body = online.sheet()
    field = np.full(body.count, 2.0)
    grip = np.array([body.count - 1])
    path = np.array([[0.0, 0.004, 0.0]] * 60)
    states = online.simulated(body, grip, Stiffness(field, np.full(body.count, 0.01)), path)
    np.testing.assert_allclose(states[:, grip[0]] - body.rest[grip[0]], path, atol=1e-15)
    assert (states[:, body.pinned] == body.rest[body.pinned]).all()
    speed = np.abs(np.diff(states, axis=0)).max(axis=(1, 2))
    assert speed[-1] < 0.05 * speed[0]  # it settles


def test_the_truth_has_a_gap_that_noise_widens(small: None, monkeypatch: pytest.MonkeyPatch) -> None:
    noisy = online.floor(online.make_scene(6), 3)
    monkeypatch.setattr(online, "NOISE", 0.0)
    assert 0 < online.floor(online.make_scene(6), 3) < noisy


def test_every_method_gets_a_row(small: None) -> None:
    scene = online.make_scene(12)
    assert scene.clouds.shape == (12, 400, 3)
    assert scene.moving().any()
    found = list(online.rows(scene, ["k1"], ["tracks", "both"], 3, Weights()))
    assert [row[1:3] for row in found] == [
        ["", "PBD"],
        ["tracks", "PBD-RM"],
        ["tracks", "PBD-RM-ON"],
        ["both", "PBD-RM"],
        ["both", "PBD-RM-ON"],
    ]
    shown = [dict(zip(online.COLUMNS_SHOWN, row, strict=True)) for row in found]
    assert [row["gap now [mm]"] != "" for row in shown] == [False, True, True, True, True]
    assert [row["rank correlation"] != "" for row in shown] == [False, False, True, False, True]


def test_costs_are_those_of_steps_with_snapshots(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sheet and a block, and a sheet of another size; CPU time is the longer thread's at least, twice it at most."""
    monkeypatch.setattr(online_cost, "POINTS", 300)
    monkeypatch.setattr(online_cost, "JUDGED", 150)
    found = [dict(zip(online_cost.COLUMNS, row, strict=True)) for row in online_cost.rows(["tracks"], [40], 6)]
    assert [row["body"] for row in found] == ["sheet", "block", "sheet"]
    assert [row["over wall"] != "" for row in found] == [True, True, False]
    for row in found:
        assert (
            0 < float(row["longer thread [ms]"]) <= float(row["CPU [ms]"]) <= 2 * float(row["longer thread [ms]"]) + 1
        )
