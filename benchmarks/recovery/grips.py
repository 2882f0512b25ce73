"""Suites of grips: how well foundation and force are known, where the tissue is stiff, and whether there is contact.

The very session that users run is asked (estimator `direct`).
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.harness import Row
from benchmarks.recovery.scores import coverage, rms

COLUMNS = ("suite", "quantity", "n", "rmse", "coverage90", "value")


AVERAGES = {
    "skill": "skill, mean",
    "contact_right": "moving frames whose contact is right",
    "rank": "rank correlation of the stiffness field, mean",
    "rank_most": "that of regions separated exactly, in any order within each",
    "held_between": "points of the stiffness field within the 90 % intervals",
}
"""Numbers of rows whose mean is in the table, and how it is called there."""


def grip_table(rows: Sequence[Row]) -> pd.DataFrame:
    """`grips.csv`: a row a suite and quantity, errors of logarithms but for the force's curve."""
    suites = dict.fromkeys(row["suite"] for row in rows)
    found = [{"suite": suite} | cells for suite in suites for cells in _quantities(rows, suite)]
    return pd.DataFrame(found, columns=COLUMNS)


def _quantities(rows: Sequence[Row], suite: str) -> Iterator[Row]:
    clips = [row for row in rows if row["suite"] == suite]

    def of(name: str) -> list[Any]:
        return [row[name] for row in clips if name in row]

    for name in ("foundation", "force"):
        if of(name):
            true, log, sd = np.array(of(name)).T
            cells = {"rmse": rms(log - true), "coverage90": coverage(log - true, sd)}
            yield {"quantity": f"{name} over stiffness", "n": len(true), **cells}
    if of("curve"):
        off, sd = curve_errors(of("curve"))
        yield {"quantity": "relative force", "n": len(off), "rmse": rms(off), "coverage90": coverage(off, sd)}
    for name, text in AVERAGES.items():
        if of(name):
            yield {"quantity": text, "n": len(of(name)), "value": float(np.mean(of(name)))}
    fields = [row for row in clips if row.get("knots", 0) > 0]
    if fields:
        held, count = (np.array([row[name] for row in fields]) for name in ("held", "knots"))
        share = float(held @ count / count.sum())
        yield {"quantity": "knots of the stiffness field within the 90 % intervals", "n": count.sum(), "value": share}
    determined = of("verdict").count("foundation")
    yield {"quantity": "clips whose foundation is determined", "n": len(clips), "value": determined / len(clips)}


def curve_errors(curves: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Errors of forces over that of the last frame, and their standard deviations, where they are known, shape [n]."""
    # The last frame's ratio is 1 by definition.
    true, value, sd = np.concatenate([curve[:, :-1] for curve in curves], axis=1)
    known = np.isfinite(value)
    return (value - true)[known], sd[known]
