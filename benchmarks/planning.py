"""The planner's cached costs against presses simulated for the purpose, and a query against simulating its lines.

    python -m benchmarks.planning [--segments 12] [--cache DIR]

On the scene of two curtains (configs/scenes/two_curtains.yaml): presses at places, directions and lengths between those
of the table, their cost by the table over that simulated; the time of a query, and what it would take to simulate every
line through tissue that the query asked for.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np

from palpate.benchmarks.shared import machine
from palpate.common.command_line import path_option, whole_number
from palpate.planning import find_plan, open_table, read_plan_scene, simulate_press
from palpate.planning.roadmap import EdgeCosts

SCENE = Path(__file__).parents[1] / "configs" / "scenes" / "two_curtains.yaml"


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.planning", description=__doc__)
    parser.add_argument("--segments", type=whole_number(1), default=12, help="that are simulated (default 12)")
    cache = Path("runs/plan/presses")
    parser.add_argument("--cache", type=path_option, default=cache, metavar="DIR", help="of the table's presses")
    options: Any = parser.parse_args(arguments)
    scene = read_plan_scene(SCENE)
    kind = scene.kinds["curtain"]
    begun = time.process_time()
    table, simulated = open_table(kind, scene.tip_radius, options.cache)
    print(machine())
    print(f"table: {simulated} presses simulated, {time.process_time() - begun:.1f} s of the processor", flush=True)
    for alpha in (scene.alpha, 0.0):
        costs = EdgeCosts(dataclasses.replace(scene, alpha=alpha), {"curtain": table})
        clock, begun = time.perf_counter(), time.process_time()
        plan = find_plan(costs)
        query = time.process_time() - begun
        direct = costs.plan(np.array([scene.start, scene.goal]))
        print(
            f"α = {alpha:g}: query {query:.3f} s of the processor, {time.perf_counter() - clock:.3f} s on the clock, "
            f"{costs.crossings} presses asked for; cost {plan.cost:.2f} (deformation {plan.deformation:.2f} mJ, "
            f"way {plan.way:.2f} mm), straight {direct.cost:.2f} (deformation {direct.deformation:.2f} mJ)",
            flush=True,
        )
        if alpha == scene.alpha:
            asked, seconds = costs.crossings, query
    chance = np.random.default_rng(5)
    off: list[float] = []
    begun = time.process_time()
    for _ in range(options.segments):
        place = np.array([chance.uniform(-0.5, 0.5) * kind.size[0], -kind.size[1] / 2])
        angle, length = np.pi / 2 + chance.uniform(-1, 1), chance.uniform(0.25, 1) * kind.longest
        true = simulate_press(kind, scene.tip_radius, place, angle).work_at(np.array([length]))[0]
        said = table.cost(place[None], np.array([angle]), np.array([length]))[0]
        off.append(abs(float(said / true) - 1))
    each = (time.process_time() - begun) / options.segments
    print(f"{options.segments} held out: off by {np.median(off):.1%} (median), {np.quantile(off, 0.95):.1%} (95th)")
    print(f"simulating a press: {each:.2f} s; all that were asked for: {each * asked / seconds:.0f} times the query")


if __name__ == "__main__":
    run_door(main)
