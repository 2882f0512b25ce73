"""The benchmark of the online estimator times steps with snapshots."""

from __future__ import annotations

import pytest

from palpate.benchmarks import online


def test_costs_are_those_of_steps_with_snapshots(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sheet and a block, and a sheet of another size; CPU time is the longer thread's at least, twice it at most."""
    monkeypatch.setattr(online, "POINTS", 300)
    monkeypatch.setattr(online, "JUDGED", 150)
    found = [dict(zip(online.COLUMNS, row, strict=True)) for row in online.rows(["tracks"], [40], 6)]
    assert [row["body"] for row in found] == ["sheet", "block", "sheet"]
    assert [row["over wall"] != "" for row in found] == [True, True, False]
    for row in found:
        assert (
            0 < float(row["longer thread [ms]"]) <= float(row["CPU [ms]"]) <= 2 * float(row["longer thread [ms]"]) + 1
        )
