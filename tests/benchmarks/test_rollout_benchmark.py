"""The rollout's benchmark refuses to time what computes something else, and shows what it measured."""

import math

import numpy as np
import pytest

from palpate.benchmarks import rollout
from palpate.benchmarks.rollout import BASELINE, NUMBA, Turn, make_task, measure, require_same, take_turn

SMALL = 0.01
"""Of the paper's vertices."""


def test_baseline_and_our_backends_agree():
    task = make_task(2, SMALL)
    expected = take_turn(BASELINE, 1, task)
    for name in NUMBA:
        require_same(name, take_turn(name, 1, task), expected)


@pytest.mark.parametrize("what", ["trajectory", "gradient"])
def test_what_computes_something_else_is_not_timed(what):
    expected = Turn(np.ones((1, 200, 3)), np.ones((1, 3)), 1.0, 2.0)
    require_same(NUMBA[0], expected._replace(**{what: getattr(expected, what) * 1.0005}), expected)
    for wrong in (1.02, math.nan):
        with pytest.raises(RuntimeError, match=f"numba exact: its {what} differs by (2.0e-02|nan)"):
            require_same(NUMBA[0], expected._replace(**{what: getattr(expected, what) * wrong}), expected)


def test_the_mesh_has_the_papers_size():
    assert len(make_task(1, 1).meshes[0].vertices) == pytest.approx(14_800, rel=0.01)


def test_ratios_are_to_the_baseline_of_the_same_run(monkeypatch, capsys):
    """The whole program on small meshes."""
    monkeypatch.setattr(rollout, "SETTINGS", {(1, SMALL): (1,), (2, SMALL): (2,)})
    monkeypatch.setattr(rollout, "ROUNDS", 1)
    found = []
    monkeypatch.setattr(rollout, "measure", lambda *setting: found.append(measure(*setting)) or found[-1])
    monkeypatch.setattr("sys.argv", ["palpate.benchmarks.rollout"])
    rollout.main()
    names = [[row["contender"] for row in rows] for rows in found]
    assert names == [[BASELINE, *NUMBA]] * 2
    for rows in found:
        for row in rows:
            assert row["forward ×"] == rows[0]["forward [ms]"] / row["forward [ms]"]
    printed = capsys.readouterr().out.splitlines()
    assert any(line.startswith(f"| {NUMBA[1]} | 2 | 2 | ") for line in printed)
