"""Simulated presses keep their energy, and tables come back from the cache."""

from pathlib import Path

import numpy as np
import pytest

from palpate.common.output import ForeignFile
from palpate.planning import cost_table, open_table, simulate_press
from palpate.planning.press import PressCurve, blocked_out
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


def test_a_mirrored_press_does_the_same_work() -> None:
    one, two = (simulate_press(KIND, 0.004, np.array([0.004, y]), angle) for y, angle in ((-0.005, 1.2), (0.005, -1.2)))
    np.testing.assert_allclose(one.work, two.work, rtol=0.08)  # five tetrahedra a cell are not symmetrical


def test_a_table_is_simulated_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def quick(kind: SoftObject, radius: float, place: np.ndarray, angle: float) -> PressCurve:
        lengths = np.array([0, kind.longest])
        return PressCurve(lengths, lengths, lengths * (1 + place[0]), blocked_out(kind, radius)[0], np.zeros((1, 3)))

    monkeypatch.setattr(cost_table, "simulate_press", quick)
    first, simulated = open_table(KIND, 0.004, tmp_path)
    again, none = open_table(KIND, 0.004, tmp_path)
    assert (simulated, none) == (len(cost_table.grid_of(KIND)[0]), 0)
    np.testing.assert_array_equal(first.work, again.work)
    assert open_table(KIND, 0.005, tmp_path)[1] > 0
    cost = first.cost(first.places[:1], first.angles[:1], np.array([KIND.longest]))
    assert cost == pytest.approx(first.work[0, -1], rel=0.01)


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
