"""Young's modulus as a palpation left it, and what moduli there are; apart, so that a plan need load nothing else."""

import csv
import io
import math
from pathlib import Path

import numpy as np

from palpate.common.files import read_file
from palpate.common.settings import fits
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError, read_mapping
from palpate.estimators.estimate import NINETY

YOUNG = 1.0, 1e12
"""What there is of Young's moduli [Pa]."""
MOST_BYTES = 2**24
"""Of a table of curves."""


def palpated_young(path: Path) -> tuple[float, float]:
    """E [Pa] and the standard deviation of its logarithm from what palpate calibrate wrote.

    Raises:
        InputError: the file tells neither.
    """
    if path.suffix.lower() == ".csv":
        return _of_curves(path)
    values = read_mapping(path, "a palpation's calibration.json")
    if values.get("young_pa", 0) is None:
        raise InputError(f"{printable(path)} says that nothing is determined; press harder and give that file.")
    names = ("young_pa", "young_low_pa", "young_high_pa")
    if not all(fits(values.get(name), float) and values[name] > 0 for name in names):
        raise InputError(
            f"{printable(path)} holds no E with an interval ({', '.join(names)}); give calibration.json of "
            "palpate calibrate palpation."
        )
    young, low, high = (float(values[name]) for name in names)
    return young, abs(math.log(high / low)) / (2 * NINETY)


def _of_curves(path: Path) -> tuple[float, float]:
    """Mean of log E over probes of one piece of tissue, and how well that is known."""
    give = "give curves.csv of palpate calibrate curves --indenter … --size …"
    try:
        text = io.StringIO(read_file(path, MOST_BYTES).decode("utf-8-sig"), newline="")
        rows = [row for row in csv.DictReader(text) if row["unit"] == "kPa"]
        found = np.array([[float(row[name]) for name in ("value", "low", "high")] for row in rows]).reshape(-1, 3)
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise InputError(f"{printable(path)} is no table of palpate calibrate; {give}.") from error
    if not len(found) or not (np.isfinite(found) & (found > 0)).all():
        raise InputError(f"{printable(path)} holds no modulus in kPa, or one that can't be; {give}.")
    logs = np.log(1000 * found)
    own = (logs[:, 2] - logs[:, 1]) / (2 * NINETY)
    # Between places tissue differs by more than a curve's own error, and so may the place in the picture.
    apart = float(logs[:, 0].std(ddof=1)) if len(logs) > 1 else 0.0
    return float(np.exp(logs[:, 0].mean())), math.hypot(apart, float(np.sqrt(np.mean(own**2))))
