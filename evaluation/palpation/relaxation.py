"""The second half of a hold, from the ramp and the first half."""

from __future__ import annotations

import numpy as np

from palpate.estimators.estimate import NINETY
from palpate.estimators.palpation import Hold, fit_relaxation


def judge_relaxation(hold: Hold) -> dict[str, object]:
    """Measures of an indentation: how far off the forecast of the hold's second half is, over the largest force.

    Raises:
        ValueError: the first half of the hold has too few samples.
    """
    held = hold.times[hold.held]
    middle = (held[0] + held[-1]) / 2
    after = hold.held & (hold.times > middle)
    peak = float(hold.force.max())
    found: dict[str, object] = {"peak force (N)": peak, "hold (s)": float(held[-1] - held[0])}
    for name, branches in (("", None), ("one standard linear solid: ", 1)):
        fit = fit_relaxation(hold, float(middle), branches=branches)
        missed = fit.force(hold.times, hold.depth)[after] - hold.force[after]
        found |= {
            f"{name}second half off, rms / peak": float(np.sqrt(np.mean(np.square(missed)))) / peak,
            f"{name}second half off, largest / peak": float(np.abs(missed).max()) / peak,
            f"{name}coverage of 90 % intervals": float(np.mean(np.abs(missed) <= NINETY * fit.forecast_sd)),
        }
    whole = fit_relaxation(hold)
    return found | {"force that remains in the end / at once": whole.relaxed_share}
