"""The cheapest way of an instrument's tip through a plane with tissue that gives way (Frank 2010, section VII).

    python plan.py SCENE.yaml --output OUT [--alpha A] [--cache DIR]

Presses on every kind of tissue are simulated once and kept in the cache (default OUT/presses); another scene with the
same tissue finds them there. Writes plan.json and plan.png: the way, what it costs and what the shortest way would have
cost, the tissue pushed aside and the forces. Not a medical device.
"""

from __future__ import annotations

from physics.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from data.command_line import path_option, progress_bars, real_number, say
from data.source.layout import InputError
from physics.fem import NoEquilibrium
from physics.files import as_json
from physics.ownership import replacing_own, require_own
from planning import Blocked, find_plan, open_table, read_plan_scene, simulate_press
from planning.pictures import draw_plan
from planning.roadmap import EdgeCosts, Plan
from planning.scene import PlanScene
from results.store import OutputError, writing

NAMES = ("plan.json", "plan.png")


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python plan.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="Exit status: 0 a way was found; 1 there is none, or something could not be; 2 wrong usage; "
        "130 interrupted.",
    )
    parser.add_argument("scene", type=path_option, metavar="SCENE.yaml", help="as configs/scenes/two_curtains.yaml")
    parser.add_argument("--output", type=path_option, required=True, metavar="OUT", help="folder of the results")
    share = real_number("a number from 0 on", 0.0)
    parser.add_argument("--alpha", type=share, metavar="A", help="0 = the shortest way, 1 = the gentlest")
    parser.add_argument("--cache", type=path_option, metavar="DIR", help="of simulated presses")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Plan what the command line names; returns the exit status."""
    parser, console = build_parser(), Console(stderr=True)
    options: Any = parser.parse_args(arguments)
    if options.alpha is not None and options.alpha > 1:
        parser.error(f"--alpha is {options.alpha:g}; give 0 to 1.")
    try:
        with writing(options.output):
            require_own(*(options.output / name for name in NAMES))
        scene = read_plan_scene(options.scene)
        if options.alpha is not None:
            scene = dataclasses.replace(scene, alpha=options.alpha)
        return _plan(scene, options.output, options.cache or options.output / "presses", console)
    except (InputError, OutputError) as error:
        say(console, str(error), "red")
    except (Blocked, NoEquilibrium, ValueError) as error:
        say(console, f"{options.scene}: {error}", "red")
    return 1


def _plan(scene: PlanScene, output: Path, cache: Path, console: Console) -> int:
    for folder in (output, cache):  # before what takes minutes
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
    tables = {}
    for name, kind in scene.kinds.items():
        with progress_bars(console) as progress, writing(cache):
            bar = progress.add_task(f"presses on {name}", total=None)
            tables[name], simulated = open_table(
                kind, scene.tip_radius, cache, lambda done, of, bar=bar: progress.update(bar, completed=done, total=of)
            )
        say(console, f"{name}: {simulated} presses simulated" if simulated else f"{name}: presses found in the cache")
    begun = time.perf_counter()
    costs = EdgeCosts(scene, tables)
    plan = find_plan(costs)
    seconds = time.perf_counter() - begun
    direct = find_plan(EdgeCosts(dataclasses.replace(scene, alpha=0.0), tables))
    direct = costs.plan(direct.places)
    presses = []
    for found in costs.presses(plan.places[:-1], plan.places[1:]):
        kind = scene.kinds[found.kind]
        for place, angle in zip(found.places, found.angles, strict=True):
            curve = simulate_press(kind, scene.tip_radius, place, float(angle))
            presses.append((found.kind, curve, found.piece, kind.height))
    record = {
        "alpha": scene.alpha,
        "plan": _told(plan),
        "shortest": _told(direct),
        "query_s": round(seconds, 4),
        "lines_through_tissue": costs.crossings,
        "largest_force_n": max((float(curve.force[-1]) for _, curve, _, _ in presses), default=0.0),
        "units": "places m, deformation mJ, way mm, cost α·deformation + (1 - α)·way",
    }
    with writing(output):
        with replacing_own(output / NAMES[0]) as partial:
            partial.write_text(as_json(record, indent=1) + "\n", encoding="utf-8")
        with replacing_own(output / NAMES[1]) as partial:
            draw_plan(scene, plan, direct, presses).savefig(partial, dpi=110)
    print(f"planned: cost {plan.cost:.2f} (deformation {plan.deformation:.2f} mJ, way {plan.way:.1f} mm)")
    print(f"shortest: cost {direct.cost:.2f} (deformation {direct.deformation:.2f} mJ, way {direct.way:.1f} mm)")
    say(console, f"written: {output}/{NAMES[0]}, {output}/{NAMES[1]}")
    return 0


def _told(plan: Plan) -> dict[str, object]:
    numbers = {"cost": plan.cost, "deformation": plan.deformation, "way": plan.way}
    return {"places": np.round(plan.places, 6).tolist()} | {name: float(value) for name, value in numbers.items()}


if __name__ == "__main__":
    run_door(main)
