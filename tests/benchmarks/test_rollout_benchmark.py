"""The rollout's benchmark refuses to time what computes something else, and shows what it measured."""

from __future__ import annotations

import math
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest

from benchmarks import rollout
from benchmarks.rollout import BASELINE, GRID, NUMBA, STENCIL, Row, Turn, make_task, measure, take_turn
from physics import jit

SMALL = (2, 1, (24, 32))


def test_baseline_and_our_backends_agree():
    expected = take_turn(BASELINE, 1, SMALL)
    for name in (STENCIL, *NUMBA) if jit.COMPILED else (STENCIL,):
        turn = take_turn(name, 1, SMALL)
        turn.require_same(expected, name)
        assert math.isnan(turn.total) == (turn.gradient is None) == (name == "numba field")


@pytest.mark.parametrize("what", ["trajectory", "gradient"])
def test_what_computes_something_else_is_not_timed(what):
    expected = Turn(1.0, 2.0, np.ones((1, 200, 3)), np.ones((1, 3)))
    expected._replace(**{what: getattr(expected, what) * 1.0005}).require_same(expected, STENCIL)
    for wrong in (1.02, math.nan):
        with pytest.raises(RuntimeError, match=f"torch stencil: its {what} differs by (2.0e-02|nan)"):
            expected._replace(**{what: getattr(expected, what) * wrong}).require_same(expected, STENCIL)


def test_the_mesh_has_the_papers_size():
    assert len(make_task(1, 1, GRID).mesh.vertices) == pytest.approx(14_800, rel=0.01)


@pytest.mark.slow
@pytest.mark.skipif(not jit.COMPILED, reason="numba isn't installed")
@pytest.mark.parametrize(("setting", "names"), [(SMALL, (*NUMBA, STENCIL)), ((1, 6, (24, 32)), NUMBA)])
def test_ratios_are_to_the_baseline_of_the_same_run(setting, names):
    rows = measure(setting, (2,))
    assert [(row.name, row.threads) for row in rows] == [(BASELINE, 1), *((name, 2) for name in names)]
    for row in rows:
        assert (row.batch, row.vertices) == (setting[0], len(make_task(*setting).mesh.vertices) // setting[0])
        assert row.forward_ratio == rows[0].forward / row.forward
        if row.name == "numba field":
            assert math.isnan(row.total_ratio)
        else:
            assert row.total_ratio == rows[0].total / row.total
        assert row.first_call > 0


def test_a_setting_short_of_memory_is_named_and_the_rest_is_shown(monkeypatch, tmp_path, capsys):
    def pretend(setting, threads):
        if setting[0] == 16:
            raise BrokenProcessPool
        shared = (setting[0], 14_817 * setting[1])
        baseline = Row(BASELINE, 1, *shared, 800.0, 2000.0, 2.8, 1309.0)
        return [baseline, Row("numba field", 1, *shared, 20.0, math.nan, 4.0, math.nan, 40.0, math.nan)]

    monkeypatch.setattr(rollout, "measure", pretend)
    monkeypatch.setattr(rollout, "PICTURE", tmp_path / "new" / "rollout.png")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setattr("sys.argv", ["benchmarks.rollout"])
    rollout.main()
    printed = capsys.readouterr().out
    assert "batch 16, 1 times the vertices: left out; a process was killed" in printed
    assert "torch edges" in printed
    line = next(line for line in printed.splitlines() if "237,072" in line and "numba field" in line)
    assert [cell.strip() for cell in line.split("│")[5:-1]] == ["20.0", "40.0", "–", "–", "–", "4.0"]
    assert (tmp_path / "new" / "rollout.png").stat().st_size > 10_000
