"""Curves that follow a law give its constant back."""

import numpy as np
import pytest

from palpate.estimators.palpation import Indenter, fit_indentation

DEPTH = np.linspace(0, 3, 13)
INDENTERS = [Indenter("sphere", 4.0, 0.45), Indenter("flat", 2.0), Indenter("cone", 30.0, 0.3)]


@pytest.mark.parametrize("indenter", INDENTERS, ids=lambda indenter: indenter.shape)
def test_the_modulus_and_where_the_tissue_begins(indenter: Indenter) -> None:
    constant, power = indenter.law
    found = fit_indentation(DEPTH, constant * 0.02 * np.maximum(DEPTH - 0.4, 0) ** power, indenter)
    assert found.value == pytest.approx(20, rel=1e-4)
    assert found.begins == pytest.approx(0.4, abs=1e-4)
    assert found.unit == "kPa"


def test_the_laws_are_those_of_the_books() -> None:
    """F = 4/3 E* √R d^1.5; 2 E* a d; 2/π E* tan α d², E* = E/(1 - ν²)."""
    assert Indenter("sphere", 9.0, 0.5).law == pytest.approx((4 / 3 * 3 / 0.75, 1.5))
    assert Indenter("flat", 3.0, 0.0).law == pytest.approx((6.0, 1.0))
    assert Indenter("cone", 45.0, 0.0).law == pytest.approx((2 / np.pi, 2.0))


def test_an_unknown_indenter_gives_a_stiffness_that_says_so() -> None:
    found = fit_indentation(DEPTH, 0.3 * DEPTH - 0.06)
    assert (found.value, found.unit) == (pytest.approx(0.3), "N/mm")
    assert found.begins == pytest.approx(0.2)


@pytest.mark.parametrize("indenter", [None, INDENTERS[0]])
def test_intervals_hold_as_often_as_they_say(indenter: Indenter | None) -> None:
    chance, inside = np.random.default_rng(1), 0
    constant, power = (1.0, 1.0) if indenter is None else indenter.law
    for _ in range(200):
        force = constant * 0.02 * np.maximum(DEPTH - 0.1, 0) ** power if indenter else 0.02 * DEPTH
        found = fit_indentation(DEPTH, force + chance.normal(0, 0.005, len(DEPTH)), indenter)
        inside += found.low <= (20 if indenter else 0.02) <= found.high
    assert 0.83 < inside / 200 < 0.97


def test_bad_indenters_and_curves_are_said() -> None:
    for wrong, says in ((("ball", 1.0), "no indenter"), (("cone", 90.0), "size is"), (("flat", 1.0, 0.6), "Poisson")):
        with pytest.raises(ValueError, match=says):
            Indenter(*wrong)
    with pytest.raises(ValueError, match="says nothing"):
        fit_indentation(np.ones(9), np.ones(9))
