"""The benchmark of the finite elements compares like with like."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.benchmarks import fem
from palpate.physics.fem.laws import LAWS


def test_every_law_and_scikit_fem_get_a_row() -> None:
    found = list(fem.rows(2, 1))
    assert [row[1] for row in found] == [*LAWS, "linear, scikit-fem"]
    assert {row[0] for row in found} == {"40"}
    assert found[0][2] == "1"  # linear


def test_another_answer_is_not_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fem, "by_scikit_fem", lambda body, held, forces: np.ones_like(forces))
    with pytest.raises(RuntimeError, match="another displacement"):
        list(fem.rows(1, 1))
