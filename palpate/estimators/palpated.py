"""Young's modulus as a palpation left it; a module of its own, so that a plan loads nothing else."""

import math
from pathlib import Path

from palpate.common.settings import fits
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError, read_mapping
from palpate.physics.identifiability import NINETY


def palpated_young(path: Path) -> tuple[float, float]:
    """Read Young's modulus [Pa] and the standard deviation of its logarithm from calibration.json of `palpate
    calibrate`.

    Raises:
        InputError: the file tells neither.
    """
    values = read_mapping(path, "a palpation's calibration.json")
    if values.get("young_pa", 0) is None:
        raise InputError(f"{printable(path)} says that nothing is determined; press harder and give that file.")
    names = ("young_pa", "young_low_pa", "young_high_pa")
    if not all(fits(values.get(name), float) and values[name] > 0 for name in names):
        raise InputError(f"{printable(path)} holds no E with an interval; give calibration.json of palpate calibrate.")
    young, low, high = (float(values[name]) for name in names)
    return young, abs(math.log(high / low)) / (2 * NINETY)
