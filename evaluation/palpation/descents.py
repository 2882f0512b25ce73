"""How many solves a numeric descent after Frank 2010 (algorithm 1) takes where Gauss–Newton takes a few.

    python -m evaluation.palpation.descents --output OUT [--body ball|slab]

One palpation of a ball and of a slab, with a truth as that of `frank`, is fitted by both from starts a factor of thirty
off: the descent walks from there, Gauss–Newton begins with a solve by the linear law, which counts. Where the body
bears the force only turned inside out, the descent begins four times stiffer, as often as that takes; what it tried
before doesn't count. Equilibria and linear systems are told until E is near where that method ends on that mesh and
stays there, and until that end. They end apart, as they measure distances otherwise; but a descent whose error is
larger at its end than where Gauss–Newton ends has stopped short, and never arrives. Writes table.csv (file, measure,
value).
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import dataclasses
from collections.abc import Sequence
from typing import Any

from rich.console import Console

from palpate.common.command_line import path_option, say
from palpate.estimators.palpation import FitSettings, fit_material
from palpate.estimators.palpation.bench import Progress
from palpate.estimators.palpation.descent import descend
from palpate.evaluation.file_table import FileTable
from palpate.evaluation.palpation.frank import FORCES, PLACE, POISSON, STARTS, YOUNG, true_press
from palpate.evaluation.palpation.synthetic import BODIES, TOOL, observe
from palpate.physics.fem.refinement import around
from palpate.results.store import OutputError

CELLS, SPACING = 7, 1 / 24
"""Of the mesh, without shorter elements where the tool presses, and of the surface over the body's size: the descent
takes a hundred solves."""
POINTS = 5000
"""That are seen: with every simulation of the descent, ICP lays all of them onto the surface."""
NEAR = 0.05
"""How close E is to come, and to stay, to where its method ends."""
LARGER = 1e-4
"""Share by which the root mean square error may be larger at the descent's end: ICP's rest, with room."""
MOST = 150
"""Equilibria of the descent; one that has not arrived by then has failed."""
SEED = 82300
"""Of the sensor's noise."""


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m evaluation.palpation.descents",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="Exit status: 0 done; 1 the results could not be written; 2 wrong usage; 130 interrupted.",
    )
    parser.add_argument("--output", type=path_option, required=True, metavar="OUT", help="folder of the table")
    parser.add_argument("--body", choices=tuple(BODIES), help="that alone (default: both)")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Compare the two; returns the exit status."""
    parser, console = build_parser(), Console(stderr=True)
    options: Any = parser.parse_args(arguments)
    try:
        table = FileTable(options.output, console)
        for name in (options.body,) if options.body else BODIES:
            compare(name, table)
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    table.show()
    return 0


def compare(name: str, table: FileTable) -> None:
    """Add what both methods take on a body from every start."""
    body, seen = BODIES[name], observe(*true_press(name, FORCES[-1], False), "stereo", SEED, POINTS)
    undivided = around(body.contact(*PLACE[name])[0][None], TOOL, body.size)
    skin, held = body.skin(CELLS, SPACING * body.size, undivided)
    for start in STARTS:
        exact = fit_material(skin, held, [seen], FitSettings(young=YOUNG * start))
        numeric = descend(skin, held, [seen], FitSettings(young=YOUNG * start), most=MOST)
        begun = numeric.path[0]
        path = [
            dataclasses.replace(each, solves=each.solves - begun.solves, systems=each.systems - begun.systems)
            for each in numeric.path
        ]
        found: dict[str, object] = {"descent: E that it could begin at / truth": begun.young / YOUNG}
        for method, fit in (("Gauss–Newton", exact), ("descent", numeric)):
            found[f"{method}: E / truth - 1"] = fit.young / YOUNG - 1
            found[f"{method}: ν - truth"] = fit.poisson - POISSON
        there = FitSettings(young=exact.young, poisson=exact.poisson)
        larger = numeric.noise / descend(skin, held, [seen], there, most=1).noise - 1
        found["descent: error at its end over that where Gauss–Newton ends, less 1"] = larger
        arrived = larger < LARGER
        found |= _counted(f"E within {NEAR:.0%}", arrival(exact.path), arrival(path), arrived)
        found |= _counted("the end", exact.path[-1], path[-1], arrived)
        table.add(f"{name}, start E × {start:.3g}", found)


def arrival(path: Sequence[Progress]) -> Progress:
    """Since when E has stayed near its last value."""
    end = path[-1].young
    return path[
        max((number for number, each in enumerate(path, start=1) if abs(each.young / end - 1) > NEAR), default=0)
    ]


def _counted(until: str, exact: Progress, numeric: Progress, arrived: bool) -> dict[str, object]:
    """Solves of both methods, and their ratios unless the descent never arrives."""
    found: dict[str, object] = {}
    for unit, word in (("solves", "equilibria"), ("systems", "linear systems")):
        one, other = getattr(exact, unit), getattr(numeric, unit)
        found[f"Gauss–Newton: {word} until {until}"] = one
        found[f"descent: {word} until {until}"] = other if arrived else f"never, after {other}"
        if arrived:
            found[f"{word} until {until}, descent / Gauss–Newton"] = other / one
    return found


if __name__ == "__main__":
    run_door(main)
