"""The compiled stencil at the edge of single precision, and how often it is compiled."""

import numpy as np

from palpate.physics import Mechanics
from palpate.physics.msd.grid_kernel import specialised
from tests.physics.sheets import pressed, sheet, whole_field


def test_nothing_denormal_is_left_ahead_of_the_wave():
    # On a flat sheet a normal load spreads by squares of squares: without flushing, most of it would be denormal.
    flat = sheet(40, 40)
    flat.vertices[:, 2] = 0.5
    load = pressed(flat, 20 * 40 + 20, 50, 60, np.array([0.0, 0.0, 1.0]))
    field = whole_field((0.5, 0.1, -0.1), flat, load, Mechanics())
    size = np.abs(field[field != 0])
    assert size.min() > np.finfo(np.float32).tiny
    assert (field[-1] == 0).mean() < 0.9


def test_code_is_compiled_once_for_a_row_length():
    assert specialised(80, True) is specialised(80, True)
    assert specialised(80, True) is not specialised(80, False)
