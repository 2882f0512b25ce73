"""The bound that the palpations' scene is chosen by."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from palpate.evaluation.palpation import design
from palpate.evaluation.palpation.synthetic import BODIES, SENSORS


@pytest.mark.slow
def test_a_press_off_the_middle_tells_more_of_a_slab_and_noise_takes_it_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(design, "CELLS", 4)
    monkeypatch.setattr(design, "FORCES", (0.5,))
    body = dataclasses.replace(BODIES["slab"], size=0.08)
    middle, aside = (design.bound(body, (along, design.ANGLE), "stereo") for along in (0.1, 0.6))
    assert aside[0] < 0.8 * middle[0]
    noisy = design.bound(body, (0.6, design.ANGLE), "time of flight")
    # As many times wider as there is more noise, and by what is left out beside edges, which grows with it.
    ratio = noisy / aside * SENSORS["stereo"] / SENSORS["time of flight"]
    assert np.all((ratio > 1) & (ratio < 1.4))
