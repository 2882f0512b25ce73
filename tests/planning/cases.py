"""A press that needs no simulation."""

import numpy as np

from palpate.planning.press import PressCurve
from palpate.planning.scene import SoftObject


def quick_press(kind: SoftObject, radius: float, place: np.ndarray, angle: float) -> PressCurve:
    """Stand-in for `planning.press.simulate_press`, the same everywhere."""
    lengths = np.array([0, kind.longest])
    return PressCurve(lengths, lengths, 5 * lengths)
