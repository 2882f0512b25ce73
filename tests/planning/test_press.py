"""Simulated presses keep their energy, and tables come back from the cache."""

from pathlib import Path

import numpy as np
import pytest

from palpate.common.output import ForeignFile
from palpate.planning import cost_table
from palpate.planning.cost_table import open_table
from palpate.planning.press import blocked_out, simulate_press
from palpate.planning.scene import SoftObject
from tests.planning.cases import quick_press

KIND = SoftObject((0.02, 0.01, 0.02), 3000.0, 0.4, ("top", "bottom"), longest=0.004, cells=(2, 1, 2))


def test_small_presses_are_springs_and_larger_energy_is_conserved() -> None:
    found = simulate_press(KIND, 0.004, np.array([0.0, -0.005]), np.pi / 2)
    assert found.lengths[-1] >= KIND.longest
    # Trapezoids of the force over the way.
    whole = np.sum(np.diff(found.lengths) * (found.force[1:] + found.force[:-1]) / 2)
    assert found.work[-1] == pytest.approx(whole)
    body = blocked_out(KIND, 0.004)[0].body
    assert body.volumes.sum() == pytest.approx(4e-6)
    assert found.work_at(np.array([1.0]))[0] == found.work[-1]


def test_a_damaged_table_is_told_before_anything_is_simulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost_table, "simulate_press", quick_press)
    open_table(KIND, 0.004, tmp_path)
    (kept,) = tmp_path.glob("presses-*.npz")
    whole = kept.read_bytes()
    kept.write_bytes(whole[: len(whole) // 2])
    monkeypatch.setattr(cost_table, "simulate_press", lambda *_: pytest.fail("simulated"))
    with pytest.raises(ForeignFile, match=r"presses-.*\.npz is not as this program wrote it; move it away"):
        open_table(KIND, 0.004, tmp_path)
    assert kept.read_bytes() == whole[: len(whole) // 2]
