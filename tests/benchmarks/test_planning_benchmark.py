"""The planner's benchmark says what it found of costs that are known."""

from __future__ import annotations

from pathlib import Path

import pytest

from palpate.benchmarks import planning
from palpate.planning import cost_table
from tests.planning.cases import quick_press


def test_costs_that_are_alike_everywhere_are_met(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Work is proportional to the length, wherever and whichever way: the table is exact."""
    for module in (cost_table, planning):
        monkeypatch.setattr(module, "simulate_press", quick_press)
    planning.main(["--segments", "3", "--cache", str(tmp_path)])
    said = capsys.readouterr().out
    assert "46 presses simulated" in said
    assert "α = 0.9: query" in said
    assert "deformation 0.00 mJ" in said  # between the curtains
    assert "3 held out: off by 0.0% (median), 0.0% (95th)" in said
    assert "simulating a press:" in said
    planning.main(["--segments", "1", "--cache", str(tmp_path)])
    assert "table: 0 presses simulated" in capsys.readouterr().out
