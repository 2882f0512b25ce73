"""Whether bodies that stiffen, and such as don't, are distinguished by presses of three forces.

    python -m tests.estimators.palpation.drawn_stiffening --seed 3 [--body slab|ball|arm]

Slabs of 8 cm, E = 10 kPa, ν = 0.42, are drawn on other meshes and by another law than the fit's, which is co-rotational
on four cells; or balls of 10 cm, fitted as a scene of four cells whose elements are shorter under the tool of 15 mm; or
sequences of an arm that presses a slab of 9 cm with such a tool, E = 8 kPa. Every row: the truth, the verdict, b with
its 90 % interval, and by how much E is off; then how many verdicts and intervals are right.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import dataclasses
import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from palpate.common.options import options, require_within
from palpate.estimators.estimate import NINETY
from palpate.estimators.palpation import FitSettings, Palpation, Skin, fit_material
from palpate.estimators.palpation.scene import PRESSED, read_scene
from palpate.estimators.palpation.stiffening_check import STIFFENS
from palpate.evaluation.palpation.synthetic import BODIES, TOOL, observe, press
from palpate.physics.fem.meshing import around
from tests.palpated import write_palpation

BODY = dataclasses.replace(BODIES["slab"], size=0.08)
FORCES = {"slab": (0.3, 1.0, 2.5), "ball": (0.2, 0.5, 1.0), "arm": (0.5, 0.9, 1.5)}
"""Of the three presses; a sequence's below 0.3 of the largest don't count [N]."""
YOUNG = {"slab": 1e4, "ball": 1e4, "arm": 8e3}
SLABS = (
    *(("corotational", 4, b) for b in (0.0, 30.0, 100.0)),
    *(("neo_hookean", cells, 0.0) for cells in (4, 5, 6, 8)),
    ("corotational", 8, 100.0),
    *(("neo_hookean", cells, b) for cells, b in ((5, 30.0), (8, 30.0), (8, 100.0))),
)
"""Law, cells along the longest side, and b."""
OTHERS = (
    ("corotational", 6, 0.0),
    ("neo_hookean", 6, 0.0),
    *((law, 6, b) for law in ("corotational", "neo_hookean") for b in (30.0, 100.0)),
)
EDGE = 0.007
"""Of a ball's elements under the tool [m]."""


def problem(
    body: str, law: str, cells: int, b: float, seed: int
) -> tuple[Skin, np.ndarray, list[Palpation], FitSettings]:
    """What `fit_material` takes, of a drawn body."""
    if body == "arm":
        with tempfile.TemporaryDirectory() as folder:
            presses = [(force, (0.2, 1.0)) for force in FORCES[body]]
            path = write_palpation(
                Path(folder), presses, YOUNG[body], 0.42, seed=seed, cells=cells, law=law, stiffening=b
            )
            scene = read_scene(path)
        return scene.skin, scene.held, scene.palpations, scene.settings
    shape, edge = (BODY, None) if body == "slab" else (BODIES["ball"], EDGE)
    bodies = [
        press(shape, YOUNG[body], 0.42, force, (0.1, 0.5), cells, law=law, edge=edge, stiffening=b)
        for force in FORCES[body]
    ]
    seen = [observe(*each, "stereo", seed + i, count=3000) for i, each in enumerate(bodies)]
    if body == "slab":
        return *BODY.skin(4, BODY.size / 20), seen, FitSettings()
    crowded = around(seen[0].contact[None], TOOL, PRESSED * TOOL)
    return *shape.skin(4, shape.size / 26, crowded), seen, FitSettings()


@dataclass(frozen=True)
class Options:
    """Of the command."""

    seed: int = 3
    """Of the sensor's noise in the first press; each further one takes the next."""
    body: Literal["slab", "ball", "arm"] = "slab"
    """What is pressed."""

    def __post_init__(self) -> None:
        require_within(self, seed=(0, 2**31))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row of each body; returns the exit status."""
    chosen: Options = options(Options, arguments, "tests.estimators.palpation.drawn_stiffening", __doc__)
    called: dict[bool, list[bool]] = {False: [], True: []}
    holding = []
    for law, cells, b in SLABS if chosen.body == "slab" else OTHERS:
        drawn = problem(chosen.body, law, cells, b, chosen.seed)
        begun = time.perf_counter()
        found = fit_material(*drawn)
        middle, low, high = found.stiffening
        said = f"{found.stiffens}, b {middle:.0f} ({low:.0f} to {high:.0f})"
        off, half = math.log(found.young / YOUNG[chosen.body]), NINETY * found.young_sd
        called[b > 0].append(found.stiffens == STIFFENS)
        holding.append(abs(off) < half)
        said += f", E off by {100 * math.expm1(off):+.1f} % (interval ±{100 * half:.1f} %)"
        said += f", {len(drawn[0].body.rest)} and {len(found.skin.body.rest)} nodes"
        print(f"{law}, {cells} cells, b {b:g}: {said}, {time.perf_counter() - begun:.0f} s", flush=True)
    print(f"of {len(called[True])} that stiffen {sum(called[True])} are called so, ", end="")
    print(f"of {len(called[False])} others {sum(called[False])}; {sum(holding)} of {len(holding)} intervals of E hold")
    return 0


if __name__ == "__main__":
    run_door(main)
