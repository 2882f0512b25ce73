"""How well palpations of a scene can tell E and ν at best, before anything is fitted: the Cramér–Rao bound.

    python -m evaluation.palpation.design

By the fit's own law at the truth, on a coarse mesh: for places of a press and the two sensors' noise, the standard
deviation of log E and ν with the sensor's pose at every picture unknown, and how many pictures of each of the presses
of `frank.FORCES` bring that of log E down to `WANTED`. `frank` presses where the fewest are needed.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import math

import numpy as np

from palpate.estimators.palpation.bench import Bench
from palpate.estimators.palpation.material_fit import information
from palpate.evaluation.palpation.frank import FORCES, POISSON, YOUNG
from palpate.evaluation.palpation.synthetic import BODIES, SENSORS, TOOL, Body, observe
from palpate.physics.fem import Material, find_equilibrium

PLACES, ANGLE = (0.1, 0.35, 0.6), 0.5
"""As `Body.contact` takes them."""
WANTED = 0.02
"""Of log E: 5 % are two and a half of it."""
CELLS, SPACING = 6, 1 / 40
"""Of the body's size."""


def bound(body: Body, place: tuple[float, float], sensor: str) -> np.ndarray:
    """Of log E and ν from one picture of every press, shape [2]."""
    skin, held = body.skin(CELLS, SPACING * body.size)
    contact, normal = body.contact(*place)
    told = np.zeros((2, 2))
    for force in FORCES:
        forces = skin.pressed(contact, TOOL, -force * normal)
        rest = find_equilibrium(skin.body, Material("corotational", YOUNG, POISSON), held, forces=forces)
        seen = observe(skin, rest, -force * normal, contact, sensor, 0)
        told += information(Bench(skin, held, [seen], "corotational"), rest, SENSORS[sensor])
    return np.sqrt(np.diag(np.linalg.inv(told)))


def main(arguments: list[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m evaluation.palpation.design",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="Exit status: 0 done; 2 wrong usage; 130 interrupted.",
    )
    parser.parse_args(arguments)
    print("body, place, sensor: standard deviation of log E and ν by one picture a press; pictures needed")
    for name, body in BODIES.items():
        for along in PLACES:
            for sensor in SENSORS:
                young, poisson = bound(body, (along, ANGLE), sensor)
                print(f"{name}, {along:g}, {sensor}: {young:.4f}, {poisson:.4f}; {math.ceil((young / WANTED) ** 2)}")
    return 0


if __name__ == "__main__":
    run_door(main)
