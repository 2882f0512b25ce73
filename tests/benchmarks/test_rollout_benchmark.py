"""The rollout's benchmark runs, checks what it times, and its contenders solve the same problem."""

from __future__ import annotations

import csv
import importlib.util

import numpy as np
import pytest

from benchmarks import rollout
from benchmarks.rollout_cases import GRID, Ours, make_task
from physics import jit


def test_baseline_and_our_backends_agree():
    task = make_task(2, 1.0, (24, 32))
    baseline = rollout.EdgeList(task)
    expected, gradient = baseline.forward(), baseline.total()
    for variant in ("exact", "window", "stencil") if jit.COMPILED else ("stencil",):
        ours = Ours(task, variant)
        np.testing.assert_allclose(ours.forward(), expected, atol=1e-3 * np.abs(expected).max())
        np.testing.assert_allclose(ours.total(), gradient, atol=1e-2 * np.abs(gradient).max())


def test_the_mesh_has_the_papers_size():
    assert len(make_task(1, 1.0, GRID).mesh.vertices) == pytest.approx(14_800, rel=0.01)


@pytest.mark.slow
def test_quick_run_writes_its_table_and_plot(tmp_path, capsys):
    rollout.main(["--quick", "--output", str(tmp_path)])
    with (tmp_path / "rollout.csv").open() as file:
        reader = csv.DictReader(file)
        rows = list(reader)
    assert tuple(reader.fieldnames) == rollout.COLUMNS
    assert len(rows) == 2 * len(rollout.contenders())
    for row in rows:
        assert float(row["forward_ms"]) > 0
        baseline = next(
            other for other in rows
            if (other["backend"], other["variant"], other["batch"], other["vertices"])
            == ("torch", "edges", row["batch"], row["vertices"])
        )  # fmt: skip
        ratio = float(baseline["forward_ms"]) / float(row["forward_ms"])
        assert float(row["forward_ratio"]) == pytest.approx(ratio, rel=1e-3)
        assert bool(row["total_ms"]) == bool(row["total_ratio"]) == (row["variant"] != "field")
    assert (tmp_path / "rollout.png").stat().st_size > 10_000
    assert "torch edges" in capsys.readouterr().out


def test_what_computes_something_else_is_not_timed():
    baseline = rollout.Contender.__new__(rollout.Contender)
    baseline.trajectory, baseline.gradient = np.ones((1, 200, 3)), np.ones((1, 3))
    other = rollout.Contender.__new__(rollout.Contender)
    other.name, other.gradient = ("warp", "tape", 1), None
    other.trajectory = baseline.trajectory * 1.0005
    other.require_same(baseline)
    other.trajectory = baseline.trajectory * 1.01
    with pytest.raises(RuntimeError, match=r"warp tape 1: its trajectory differs by 1\.0e-02"):
        other.require_same(baseline)


def test_a_contender_that_fails_is_named(monkeypatch, tmp_path):
    with pytest.raises(RuntimeError, match="numba unknown 1"):
        rollout.Contender(("numba", "unknown", 1), (1, 1.0, (0, 0)), tmp_path)


@pytest.mark.parametrize("absent", ["warp", "taichi"])
def test_what_is_not_installed_is_left_out(monkeypatch, absent):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == absent else found(name))
    assert absent not in {name[0] for name in rollout.contenders()}
    assert rollout.contenders()[0] == rollout.BASELINE
