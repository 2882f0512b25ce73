"""The experiments of Frank 2010 (section VIII-A) on palpations with known truth.

    python -m evaluation.palpation.frank --output OUT [--body ball|slab] [--quick]

A ball and a slab of neo-Hookean tissue on a finer mesh are pressed and seen from one side by two sensors; E and ν are
fitted by the co-rotational law, from starts a factor of thirty off (by a numeric descent: `descents`). Writes
table.csv (file, measure, value) and the paper's figures: error_mask.png (4), six_forces.png (5) and error_surface.png
(the error over E and ν).
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from palpate.common.command_line import path_option, say
from palpate.common.output import replacing_own, require_own
from palpate.estimators.estimate import NINETY
from palpate.estimators.palpation import FitSettings, Palpation, Skin, fit_material
from palpate.estimators.palpation.bench import across, surface_distance, surface_error
from palpate.evaluation.file_table import FileTable
from palpate.evaluation.page import as_png
from palpate.evaluation.palpation.synthetic import BODIES, SENSORS, TOOL, observe, press
from palpate.physics.fem import Equilibrium, Material, NoEquilibrium, find_equilibrium
from palpate.physics.fem.refinement import around
from palpate.results.plots import draw_surface_errors
from palpate.results.store import OutputError, writing

FIGURES = ("error_mask.png", "six_forces.png", "error_surface.png")
YOUNG, POISSON = 1e4, 0.42
"""The truth [Pa]."""
PLACE = {"ball": (0.35, 0.5), "slab": (0.6, 0.5)}
"""Where is pressed, as `Body.contact` takes it: where `design` says that the fewest pictures are needed."""
PICTURES = {("slab", "time of flight"): 5}
"""Of every press, each with its own pose, as many as `design` says; else one."""
FORCES = (0.3, 0.4, 0.5)
"""With what, one step after the other as the paper's robot does [N]: laws part where a body is dented by more."""
SIX = (0.25, 0.3, 0.35, 0.4, 0.45, 0.5)
"""Forces of the paper's figure 5 [N]."""
CELLS, TRUE_CELLS = {"ball": 6, "slab": 7}, {"ball": 8, "slab": 9}
EDGE, TRUE_EDGE = {"ball": 0.7 * TOOL, "slab": 0.6 * TOOL}, {"ball": 0.5 * TOOL, "slab": 0.4 * TOOL}
"""Longest of an element where the tool presses [m]; of the truth's as well."""
SPACING, TRUE_SPACING = 1 / 56, 1 / 64
"""Of the scanned surface, over the body's size."""
STARTS = (30.0, 1 / 30)
SEED = 73500
"""Of the first press's noise; those after it follow."""


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m evaluation.palpation.frank",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="Exit status: 0 done; 1 the results could not be written; 2 wrong usage; 130 interrupted.",
    )
    parser.add_argument("--output", type=path_option, required=True, metavar="OUT", help="folder of the results")
    text = "that alone, without the figures where it is the slab (default: both)"
    parser.add_argument("--body", choices=tuple(BODIES), help=text)
    parser.add_argument("--quick", action="store_true", help="one body, one sensor, coarse: to see that it works")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run the experiments; returns the exit status."""
    parser, console = build_parser(), Console(stderr=True)
    options: Any = parser.parse_args(arguments)
    try:
        with writing(options.output):
            require_own(*(options.output / name for name in FIGURES))
        table = FileTable(options.output, console)
        for name in ("slab",) if options.quick else (options.body,) if options.body else BODIES:
            coarse = options.quick
            truths = [true_press(name, force, coarse) for force in FORCES[-1 if coarse else 0 :]]
            skin, held = _fitted_by(name, coarse)
            for sensor in ("stereo",) if coarse else SENSORS:
                truths_seen = truths * (1 if coarse else PICTURES.get((name, sensor), 1))
                seen = [observe(*truth, sensor, SEED + number) for number, truth in enumerate(truths_seen)]
                _starts(f"{name}, {sensor}", skin, held, seen, len(truths), table)
                say(console, f"{name}, {sensor}: fitted")
        if options.quick or options.body != "slab":
            name = "slab" if options.quick else "ball"
            _write(options.output, _paper(name, options.quick, table))
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    table.show()
    return 0


@cache
def true_press(name: str, force: float, coarse: bool) -> tuple[Skin, Equilibrium, np.ndarray, np.ndarray]:
    """The truth of a body under a force [N], as `press` gives it, on a coarse mesh if told so."""
    body = BODIES[name]
    if coarse:
        return press(body, YOUNG, POISSON, force, PLACE[name], 5)
    spacing, edge = TRUE_SPACING * body.size, TRUE_EDGE[name]
    return press(body, YOUNG, POISSON, force, PLACE[name], TRUE_CELLS[name], spacing=spacing, edge=edge)


def _fitted_by(name: str, coarse: bool) -> tuple[Skin, np.ndarray]:
    body = BODIES[name]
    if coarse:
        return body.skin(4, body.size / 24)
    return body.skin(CELLS[name], SPACING * body.size, around(body.contact(*PLACE[name])[0][None], TOOL, EDGE[name]))


def _starts(
    label: str, skin: Skin, held: np.ndarray, seen: Sequence[Palpation], presses: int, table: FileTable
) -> None:
    """Fits from either side of the truth, to pictures of so many presses."""
    for start in STARTS:
        fit = fit_material(skin, held, seen, FitSettings(young=YOUNG * start))
        measures = {
            "E / truth - 1": fit.young / YOUNG - 1,
            "E, standard deviation of its logarithm": fit.young_sd,
            "ν - truth": fit.poisson - POISSON,
            "ν, standard deviation": fit.poisson_sd,
            "verdict": fit.verdict,
            "equilibria a press": fit.solves / presses,
        }
        table.add(f"{label}, {presses} presses, {len(seen)} pictures, start E × {start:.3g}", measures)


def _paper(name: str, coarse: bool, table: FileTable) -> dict[str, bytes]:
    """The paper's figures."""
    skin, held = _fitted_by(name, coarse)
    found = []
    for number, force in enumerate(SIX[:2] if coarse else SIX):
        seen = observe(*true_press(name, force, coarse), "stereo", SEED + 10 + number)
        found.append(fit_material(skin, held, [seen], FitSettings(young=YOUNG / 30)))
    exact = found[-1]
    values = np.array([fit.young for fit in found])
    measures = {
        "six forces: E, standard deviation / mean": float(values.std(ddof=1) / values.mean()),
        "six forces: E, mean / truth - 1": float(values.mean() / YOUNG - 1),
    }
    table.add(f"{name}, stereo, one palpation", measures)
    errors = []
    for young in (exact.young, exact.young / 2):
        forces = skin.pressed(seen.contact, seen.tool_radius, seen.force)
        rest = find_equilibrium(skin.body, Material("corotational", young, exact.poisson), held, forces=forces)
        errors.append(1000 * surface_distance(skin, rest, seen, exact.poses[0]))
    youngs = YOUNG * np.geomspace(0.4, 2.5, 3 if coarse else 7)
    ratios = np.linspace(0.1, 0.47, 2 if coarse else 5)
    surface = _error_surface(skin, held, seen, exact.poses[0], youngs, ratios)
    title = f"{name}: a press of {np.linalg.norm(seen.force):g} N and what its simulation leaves"
    figures = [draw_surface_errors(1000 * across(seen, exact.poses[0]), *errors, 1000 * seen.hole, title)]
    figures += [_draw_six(SIX[: len(found)], values, [fit.young_sd for fit in found])]
    figures += [_draw_surface(youngs, ratios, surface, (exact.young, exact.poisson))]
    return dict(zip(FIGURES, map(as_png, figures), strict=True))


def _error_surface(
    skin: Skin, held: np.ndarray, seen: Palpation, pose: np.ndarray, youngs: np.ndarray, ratios: np.ndarray
) -> np.ndarray:
    """Root mean square surface error [mm], not a number where the body can't bear the force, shape [ν, E]."""
    forces = skin.pressed(seen.contact, seen.tool_radius, seen.force)
    found = np.full((len(ratios), len(youngs)), np.nan)
    for row, poisson in enumerate(ratios):
        start = None
        for column in range(len(youngs))[::-1]:  # stiff ones first: they are close to rest
            material = Material("corotational", float(youngs[column]), float(poisson))
            try:
                rest = find_equilibrium(skin.body, material, held, forces=forces, start=start)
            except NoEquilibrium:
                break  # nor can a softer one
            start = rest.displacement
            found[row, column] = 1000 * np.sqrt(np.nanmean(surface_error(skin, rest, seen, pose)))
    return found


def _draw_six(forces: Sequence[float], values: np.ndarray, sds: Sequence[float]) -> Figure:
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.add_subplot()
    axes.errorbar(forces, values / 1000, yerr=NINETY * np.array(sds) * values / 1000, fmt="o", capsize=3, label="90 %")
    axes.axhline(YOUNG / 1000, color="0.5", linestyle="--", label="truth")
    axes.axhline(values.mean() / 1000, color="C1", label="mean")
    axes.set(xlabel="force [N]", ylabel="Young's modulus [kPa]", ylim=(0, 2 * YOUNG / 1000))
    axes.legend()
    return figure


def _draw_surface(youngs: np.ndarray, ratios: np.ndarray, errors: np.ndarray, best: tuple[float, float]) -> Figure:
    figure = Figure(figsize=(6.5, 4.4), layout="constrained")
    axes = figure.add_subplot()
    drawn = axes.contourf(youngs / 1000, ratios, errors, levels=14, cmap="viridis")
    axes.plot(YOUNG / 1000, POISSON, "w*", markersize=14, label="truth")
    axes.plot(best[0] / 1000, best[1], "rx", markersize=10, label="fit")
    axes.set(xscale="log", xlabel="Young's modulus [kPa]", ylabel="Poisson's ratio")
    axes.set_xticks([4, 6, 10, 16, 25], ["4", "6", "10", "16", "25"])
    axes.minorticks_off()
    axes.legend(loc="lower right")
    figure.colorbar(drawn, label="surface error, rms [mm]")
    return figure


def _write(output: Path, figures: dict[str, bytes]) -> None:
    with writing(output):
        output.mkdir(parents=True, exist_ok=True)
        for name, content in figures.items():
            with replacing_own(output / name) as partial:
                partial.write_bytes(content)


if __name__ == "__main__":
    run_door(main)
