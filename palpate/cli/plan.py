"""The cheapest way of an instrument's tip past tissue that gives way (Frank 2010, section VII).

    palpate plan configs/scenes/two_curtains.yaml --output plan --alpha 0.5

Presses on every kind of tissue are simulated once and kept in the cache (default OUT/presses); another scene with the
same tissue finds them there. Writes plan.json and plan.png: the way, what it costs and what the shortest way would have
cost.

A scene with a mesh is planned in space, past a body of any shape and through a port: its road map is kept in the cache
for other starts, goals, moduli and limits. Writes plan.json, and path.csv: times, poses and expected forces. Not a
medical device.
"""

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from rich.console import Console

from palpate.common.command_line import progress_bars, say
from palpate.common.files import as_json
from palpate.common.options import option
from palpate.common.options import options as read_options
from palpate.common.output import replacing_own, require_own, write_own
from palpate.common.tables import to_csv
from palpate.data.source.layout import InputError
from palpate.planning.cost_table import open_tables
from palpate.planning.pictures import draw_plan
from palpate.planning.roadmap import EdgeCosts, find_plan
from palpate.planning.scene import PlanScene, SpaceScene, read_plan_scene
from palpate.planning.space_map import open_costs, plan_in_space
from palpate.planning.waypoints import COLUMNS, waypoints
from palpate.results.store import OutputError, make_output, writing


@dataclass(frozen=True)
class PlanOptions:
    """The scene and the results."""

    scene: Path = option(positional=True, metavar="SCENE.yaml")
    """scene, such as configs/scenes/two_curtains.yaml"""
    output: Path = option(metavar="OUT")
    """folder of the results"""
    alpha: Annotated[float, 0, 1] | None = option(None, metavar="A")
    """weight of deformation against way: 0 = the shortest way, 1 = the gentlest"""
    cache: Path | None = option(None, metavar="DIR")
    """folder of simulated presses and road maps (default: presses in OUT)"""


def main(arguments: list[str] | None = None) -> int:
    """Plan what the command line names; returns the exit status."""
    console = Console(stderr=True)
    options: PlanOptions = read_options(PlanOptions, arguments, "", __doc__)
    try:
        scene = read_plan_scene(options.scene, options.alpha)
        cache = options.cache or options.output / "presses"
        youngs = [each.young for each in ([scene] if isinstance(scene, SpaceScene) else scene.objects.values())]
        softest = 50.0  # tissue is stiffer [Pa]
        if (young := min(youngs, default=softest)) < softest:
            say(console, f"{options.scene}: young is {young:g} Pa, softer than tissue; give Pa, not kPa", "yellow")
        name = "path.csv" if isinstance(scene, SpaceScene) else "plan.png"
        record, second = options.output / "plan.json", options.output / name
        with writing(options.output):
            require_own(record, second)
        make_output(options.output)  # before what takes minutes
        if isinstance(scene, SpaceScene):
            _plan_in_space(scene, record, second, cache, console)
        else:
            _plan(scene, record, second, cache, console)
        say(console, f"written: {record}, {second}")
        return 0
    except (InputError, OutputError) as error:
        say(console, str(error), "red")
    except ValueError as error:
        say(console, f"{options.scene}: {error}", "red")
    return 1


def _plan(scene: PlanScene, record: Path, picture: Path, cache: Path, console: Console) -> None:
    simulated = dict.fromkeys(scene.objects, 0)
    with progress_bars(console) as progress, writing(cache):
        bars = {name: progress.add_task(f"presses on {name}", total=None) for name in scene.objects}

        def report(name: str, done: int, of: int) -> None:
            simulated[name] = done
            progress.update(bars[name], completed=done, total=of)

        tables = open_tables(scene, cache, report)
    for name, count in simulated.items():
        say(console, f"{name}: {count} presses simulated" if count else f"{name}: presses found in the cache")
    begun = time.perf_counter()
    costs = EdgeCosts(scene, tables)
    plan = find_plan(costs)
    seconds = time.perf_counter() - begun
    direct = costs.plan(find_plan(EdgeCosts(dataclasses.replace(scene, alpha=0.0), tables)).places)
    ways = {"planned": plan, "shortest": direct}
    numbers = {name: dataclasses.asdict(way) | {"places": np.round(way.places, 6)} for name, way in ways.items()}
    found: dict[str, Any] = {"alpha": scene.alpha, "plan": numbers["planned"], "shortest": numbers["shortest"]}
    found["query_s"] = round(seconds, 4)
    found["units"] = "places m, deformation mJ, way mm, cost α·deformation + (1 - α)·way"
    with writing(record.parent):
        write_own(record, as_json(found, indent=1) + "\n")
        with replacing_own(picture) as partial:
            draw_plan(scene, ways).savefig(partial, dpi=110)
    for name, way in ways.items():
        print(f"{name}: cost {way.cost:.2f} (deformation {way.deformation:.2f} mJ, way {way.way:.1f} mm)")


def _plan_in_space(scene: SpaceScene, record: Path, path: Path, cache: Path, console: Console) -> None:
    with writing(cache):
        costs, known = open_costs(scene, cache)
    say(console, "road map found in the cache" if known else "road map made")
    begun = time.perf_counter()
    plan = plan_in_space(costs)
    seconds = time.perf_counter() - begun
    rows, (low, high) = waypoints(costs, plan), costs.interval(plan)
    found = dataclasses.asdict(plan) | {"cost_low": low, "cost_high": high, "largest_force": rows[:, 8].max()}
    # As JSON an infinite cost, over the limit, is null.
    found["straight_cost"] = costs.plan(np.stack([costs.start, costs.goal])).cost
    found |= {"alpha": scene.alpha, "young_pa": scene.young, "query_s": round(seconds, 4)}
    found["units"] = "places m, deformation mJ, way mm, cost α·deformation + (1 - α)·way, forces N, intervals 90 %"
    with writing(record.parent):
        write_own(record, as_json(found, indent=1) + "\n")
        write_own(path, to_csv([dict(zip(COLUMNS, row, strict=True)) for row in rows.tolist()], form=".6g"))
    print(f"cost {plan.cost:.2f} ({low:.2f} to {high:.2f}), largest force {found['largest_force']:.2f} N")
