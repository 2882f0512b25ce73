"""Suites of grips: error and coverage of the relative force, skill, and whether contact is found (`direct`)."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.harness import Row
from benchmarks.recovery.scores import coverage, rms

COLUMNS = ("suite", "quantity", "n", "rmse", "coverage90", "value")
AVERAGES = {"skill": "skill, mean", "contact_right": "moving frames whose contact is right"}
"""Numbers of rows whose mean is in the table, and how it is called there."""


def grip_table(rows: Sequence[Row]) -> pd.DataFrame:
    """`grips.csv`: a row a suite and quantity, errors of the force over that of the last frame."""
    suites = dict.fromkeys(row["suite"] for row in rows)
    found = [{"suite": suite} | cells for suite in suites for cells in _quantities(rows, suite)]
    return pd.DataFrame(found, columns=COLUMNS)


def _quantities(rows: Sequence[Row], suite: str) -> Iterator[Row]:
    clips = [row for row in rows if row["suite"] == suite]

    def of(name: str) -> list[Any]:
        return [row[name] for row in clips if name in row]

    if of("curve"):
        off, sd = curve_errors(of("curve"))
        yield {"quantity": "relative force", "n": len(off), "rmse": rms(off), "coverage90": coverage(off, sd)}
    for name, text in AVERAGES.items():
        if of(name):
            yield {"quantity": text, "n": len(of(name)), "value": float(np.mean(of(name)))}
    determined = of("verdict").count("relative_force")
    yield {"quantity": "clips whose relative force is determined", "n": len(clips), "value": determined / len(clips)}


def curve_errors(curves: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Errors of forces over that of the last frame, and their standard deviations, where they are known, shape [n]."""
    # The last frame's ratio is 1 by definition.
    true, value, sd = np.concatenate([curve[:, :-1] for curve in curves], axis=1)
    known = np.isfinite(value)
    return (value - true)[known], sd[known]
