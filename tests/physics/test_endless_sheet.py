"""An endless sheet's answer to one force, against the foundation's balance and a dense solve of a finite sheet."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.estimators.grip.lattice import lattice_springs
from palpate.physics.endless_sheet import response
from palpate.physics.sheet import equilibrium


@pytest.mark.parametrize("anchor", [0.01, 0.3])
def test_the_foundation_holds_all_of_the_force(anchor: float) -> None:
    found = response(anchor, 128)
    assert anchor * found.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(found, found.T, atol=1e-12)
    np.testing.assert_allclose(found[1:], found[:0:-1], atol=1e-12)  # alike on both sides


def test_far_from_its_ends_a_finite_sheet_answers_alike() -> None:
    row, column = np.mgrid[:61, :61]
    points = np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    springs, gripped = lattice_springs(points, 1), (points == 30).all(axis=1)
    anchor = 0.3
    finite = equilibrium(springs, np.ones(len(springs)), np.full(len(points), anchor), gripped, np.ones((1, 1)))
    endless = response(anchor, 256)
    held = finite.displacement.reshape(61, 61)
    np.testing.assert_allclose(held[30, 30:50], endless[0, :20] / endless[0, 0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(np.diag(held)[30:50], np.diag(endless)[:20] / endless[0, 0], rtol=0, atol=1e-6)
    assert finite.reaction.item() == pytest.approx(1 / endless[0, 0])


def test_without_a_foundation_no_node_has_a_place() -> None:
    with pytest.raises(ValueError, match=r"^anchor is 0"):
        response(0.0, 8)
