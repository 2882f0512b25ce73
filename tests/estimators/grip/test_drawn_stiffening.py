"""The judge of sheets that stiffen draws what its law says, and counts what is said of it."""

import math

import numpy as np
import pytest
from scipy.special import k0, k1

from palpate.data.synthetic.grip import GRIP_RADIUS
from tests.estimators.grip import drawn_stiffening
from tests.estimators.grip.drawn_stiffening import CELL, line_of

ANCHOR, PULL = 0.05, 6.0


def test_a_line_that_does_not_stiffen_is_the_closed_form() -> None:
    moved, force = line_of(PULL, ANCHOR, 0.0)
    fall, places = math.sqrt(ANCHOR / 3), GRIP_RADIUS + CELL * (np.arange(200) + 0.5)
    edge = k0(fall * GRIP_RADIUS)
    np.testing.assert_allclose(moved[:200], PULL * k0(fall * places) / edge, rtol=1e-3)
    sheared = 2 * math.pi * GRIP_RADIUS * 3 * fall * k1(fall * GRIP_RADIUS) / edge
    assert force == pytest.approx(PULL * (sheared + math.pi * GRIP_RADIUS**2 * ANCHOR), rel=2e-3)


@pytest.mark.parametrize("b", [2.0, 10.0, 30.0])
def test_a_line_that_stiffens_is_held_by_its_foundation_and_follows_the_law(b: float) -> None:
    moved, force = line_of(PULL, ANCHOR, b)
    middles = GRIP_RADIUS + CELL * (np.arange(len(moved)) + 0.5)
    ring = 2 * math.pi * ANCHOR * middles * moved * CELL
    assert force == pytest.approx(ring.sum() + math.pi * GRIP_RADIUS**2 * ANCHOR * PULL, rel=1e-3)
    # Beyond any place the foundation holds what springs carry across it.
    slope = (moved[39] - moved[40]) / CELL
    carried = 2 * math.pi * (middles[39] + CELL / 2) * 3 * math.expm1(b * slope) / b
    assert carried == pytest.approx(ring[40:].sum(), rel=1e-3)
    linear, less = line_of(PULL, ANCHOR, 0.0)
    assert force > 1.1 * less
    assert (moved[:200] > linear[:200]).all()


@pytest.mark.slow
def test_the_command_judges_a_sheet_that_stiffens_and_one_that_does_not(capsys: pytest.CaptureFixture[str]) -> None:
    assert drawn_stiffening.main(["--seed", "601", "--clips", "1", "--only", "b 0,b 10"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2:] == [
        "b 0: 0 of 1 say that stiffening isn't determined",
        "b 10: 1 of 1 say that stiffening isn't determined",
    ]
    assert "foundation_over_stiffness off by -0%, sd 0.0083, held" in lines[0]
    assert "no sheet" in lines[1]
