"""Whether bodies that stiffen, and such as don't, are distinguished by presses of three forces.

    python -m tests.estimators.palpation.drawn_stiffening --seed 3

Slabs of 8 cm, E = 10 kPa, ν = 0.42, are drawn on other meshes and by another law than the fit's, which is co-rotational
on four cells. Every row: the truth, the verdict, b with its 90 % interval, and by how much E is off; then how many
verdicts and intervals are right.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import dataclasses
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

from palpate.common.options import options, require_within
from palpate.estimators.estimate import NINETY
from palpate.estimators.palpation import fit_material
from palpate.estimators.palpation.material_fit import STIFFENS
from palpate.evaluation.palpation.synthetic import BODIES, observe, press

BODY = dataclasses.replace(BODIES["slab"], size=0.08)
FORCES = 0.3, 1.0, 2.5
TRUTHS = (
    *(("corotational", 4, b) for b in (0.0, 30.0, 100.0)),
    *(("neo_hookean", cells, 0.0) for cells in (4, 5, 6, 8)),
    ("corotational", 8, 100.0),
    *(("neo_hookean", cells, b) for cells, b in ((5, 30.0), (8, 30.0), (8, 100.0))),
)
"""Law, cells along the longest side, and b."""


@dataclass(frozen=True)
class Options:
    """Of the command."""

    seed: int = 3
    """Of the sensor's noise in the first press; each further one takes the next."""

    def __post_init__(self) -> None:
        require_within(self, seed=(0, 2**31))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row of each body; returns the exit status."""
    chosen: Options = options(Options, arguments, "tests.estimators.palpation.drawn_stiffening", __doc__)
    skin, held = BODY.skin(4, BODY.size / 20)
    called: dict[bool, list[bool]] = {False: [], True: []}
    holding = []
    for law, cells, b in TRUTHS:
        bodies = [press(BODY, 1e4, 0.42, force, (0.1, 0.5), cells, law=law, stiffening=b) for force in FORCES]
        seen = [observe(*body, "stereo", chosen.seed + i, count=3000) for i, body in enumerate(bodies)]
        begun = time.perf_counter()
        found = fit_material(skin, held, seen)
        middle, low, high = found.stiffening
        said = f"{found.stiffens}, b {middle:.0f} ({low:.0f} to {high:.0f})"
        off, half = math.log(found.young / 1e4), NINETY * found.young_sd
        called[b > 0].append(found.stiffens == STIFFENS)
        holding.append(abs(off) < half)
        said += f", E off by {100 * math.expm1(off):+.1f} % (interval ±{100 * half:.1f} %)"
        print(f"{law}, {cells} cells, b {b:g}: {said}, {time.perf_counter() - begun:.0f} s", flush=True)
    print(f"of {len(called[True])} that stiffen {sum(called[True])} are called so, ", end="")
    print(f"of {len(called[False])} others {sum(called[False])}; {sum(holding)} of {len(holding)} intervals of E hold")
    return 0


if __name__ == "__main__":
    run_door(main)
