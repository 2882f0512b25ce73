"""Young's modulus and Poisson's ratio from palpations of bodies with known truth, as Frank 2010 does (section VIII-A).

frank     a ball and a slab of neo-Hookean tissue on a finer mesh are pressed and observed from one side by two sensors;
          E and ν are fitted by the co-rotational law, from starts a factor of thirty off. Also the paper's figures,
          in figures/: error_mask.png (4), six_forces.png (5) and error_surface.png (the error over E and ν)
descents  how many solves a numeric descent after the paper's algorithm 1 takes where Gauss–Newton takes a few
design    how well such palpations can tell E and ν at best, before anything is fitted: the Cramér–Rao bound
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from matplotlib.figure import Figure

from palpate.estimators.estimate import NINETY
from palpate.estimators.palpation import FitSettings, Palpation, Skin, fit_material
from palpate.estimators.palpation.bench import Bench, Progress, across, surface_distance, surface_error
from palpate.estimators.palpation.descent import descend
from palpate.estimators.palpation.material_fit import information
from palpate.evaluation.harness import Measurements, Row, in_base64
from palpate.evaluation.palpation.synthetic import BODIES, SENSORS, TOOL, observe, press
from palpate.physics.fem import Equilibrium, Material, NoEquilibrium, find_equilibrium
from palpate.physics.fem.refinement import around
from palpate.results.plots import draw_surface_errors

FIGURES = ("error_mask.png", "six_forces.png", "error_surface.png")
YOUNG, POISSON = 1e4, 0.42
"""The truth [Pa]."""
PLACE = {"ball": (0.35, 0.5), "slab": (0.6, 0.5)}
"""Where is pressed, as `Body.contact` takes it: where `design` says that the fewest pictures are needed."""
PICTURES = {("slab", "time of flight"): 5}
"""Of every press, each with its own pose, as many as `design` says; else one."""
FORCES = (0.3, 0.4, 0.5)
"""Forces of the presses, one step after the other as the paper's robot does [N]: laws part where a body is dented by
more."""
SIX = (0.25, 0.3, 0.35, 0.4, 0.45, 0.5)
"""Forces of the paper's figure 5 [N]."""
CELLS, TRUE_CELLS = {"ball": 6, "slab": 7}, {"ball": 8, "slab": 9}
EDGE, TRUE_EDGE = {"ball": 0.7 * TOOL, "slab": 0.6 * TOOL}, {"ball": 0.5 * TOOL, "slab": 0.4 * TOOL}
"""Longest edge of an element where the tool presses [m]; of the truth's as well."""
SPACING, TRUE_SPACING = 1 / 56, 1 / 64
"""Of the scanned surface, over the body's size."""
STARTS = (30.0, 1 / 30)
SEED = 73500
"""Of the first press's noise; those after it follow."""

PLAIN_CELLS, PLAIN_SPACING = 7, 1 / 24
"""Of the mesh of `descents`, without shorter elements where the tool presses, and of the surface over the body's size:
the descent takes a hundred solves."""
POINTS = 5000
"""Observed points there: with every simulation of the descent, ICP lays all of them onto the surface."""
NEAR = 0.05
"""How close E is to come, and to stay, to where its method ends."""
MAX_LARGER = 1e-4
"""Share by which the root mean square error may be larger at the descent's end: ICP's rest, with room."""
MAX_SOLVES = 150
"""Equilibria of the descent; one that has not arrived by then has failed."""
DESCENT_SEED = 82300
"""Of the sensor's noise there."""

PLACES, ANGLE = (0.1, 0.35, 0.6), 0.5
"""Places of the presses that `design` compares, as `Body.contact` takes them."""
WANTED_SD = 0.02
"""Of log E: 5 % are two and a half of it."""
DESIGN_CELLS, DESIGN_SPACING = 6, 1 / 40
"""Of the mesh of `design`, and of its surface over the body's size."""

Truth = tuple[Skin, Equilibrium, np.ndarray, np.ndarray]
"""As `press` gives it."""
BodyName = Literal["ball", "slab"]


@dataclass(frozen=True)
class Frank(Measurements):
    """The paper's experiments."""

    body: BodyName | None = None
    """that alone, without the figures where it is the slab (default: both)"""
    quick: bool = False
    """one body, one sensor, coarse: to see that it works"""

    writes: ClassVar[Sequence[str]] = ("table.csv", *(f"figures/{name}" for name in FIGURES))

    @property
    def wanted(self) -> Mapping[str, Callable[[], Row]]:
        """Fits from every start, then the figures."""
        found: dict[str, Callable[[], Row]] = {}
        presses = 1 if self.quick else len(FORCES)
        for body in ("slab",) if self.quick else (self.body,) if self.body else BODIES:
            for sensor, start in itertools.product(("stereo",) if self.quick else SENSORS, STARTS):
                pictures = presses * (1 if self.quick else PICTURES.get((body, sensor), 1))
                name = f"{body}, {sensor}, {presses} presses, {pictures} pictures, start E × {start:.3g}"
                found[name] = functools.partial(fit_from, body, sensor, start, pictures, self.quick)
        if self.quick or self.body != "slab":
            name = "slab" if self.quick else "ball"
            found[f"{name}, stereo, one palpation"] = functools.partial(paper_figures, name, self.quick)
        return found

    def record(self) -> Mapping[str, Any]:
        """Meshes."""
        return {"quick": self.quick}


@functools.cache
def true_press(name: str, force: float, coarse: bool) -> Truth:
    """The truth of a body under a force [N], on a coarse mesh if that is asked for."""
    body = BODIES[name]
    if coarse:
        return press(body, YOUNG, POISSON, force, PLACE[name], 5)
    spacing, edge = TRUE_SPACING * body.size, TRUE_EDGE[name]
    return press(body, YOUNG, POISSON, force, PLACE[name], TRUE_CELLS[name], spacing=spacing, edge=edge)


@functools.cache
def fitted_mesh(name: str, coarse: bool) -> tuple[Skin, np.ndarray]:
    """Surface and mesh of the fits of a body, and what of it is held."""
    body = BODIES[name]
    if coarse:
        return body.skin(4, body.size / 24)
    return body.skin(CELLS[name], SPACING * body.size, around(body.contact(*PLACE[name])[0][None], TOOL, EDGE[name]))


def fit_from(body: str, sensor: str, start: float, pictures: int, coarse: bool) -> Row:
    """Measures of a fit that begins at so many times the true E."""
    forces = FORCES[-1:] if coarse else FORCES
    truths = itertools.islice(itertools.cycle([true_press(body, force, coarse) for force in forces]), pictures)
    palpations = [observe(*truth, sensor, SEED + number) for number, truth in enumerate(truths)]
    fit = fit_material(*fitted_mesh(body, coarse), palpations, FitSettings(young=YOUNG * start))
    return {
        "E / truth - 1": fit.young / YOUNG - 1,
        "E, standard deviation of its logarithm": fit.young_sd,
        "ν - truth": fit.poisson - POISSON,
        "ν, standard deviation": fit.poisson_sd,
        "verdict": fit.verdict,
        "equilibria a press": fit.solves / len(forces),
    }


def paper_figures(name: str, coarse: bool) -> Row:
    """Figures of one palpation of a body, and how far E differs between the six forces."""
    skin, held = fitted_mesh(name, coarse)
    fits = []
    for number, force in enumerate(SIX[:2] if coarse else SIX):
        seen = observe(*true_press(name, force, coarse), "stereo", SEED + 10 + number)
        fits.append(fit_material(skin, held, [seen], FitSettings(young=YOUNG / 30)))
    last, pose = fits[-1], fits[-1].poses[0]
    values = np.array([fit.young for fit in fits])
    errors = []
    for young in (last.young, last.young / 2):
        forces = skin.pressed(seen.contact, seen.tool_radius, seen.force)
        rest = find_equilibrium(skin.body, Material("corotational", young, last.poisson), held, forces=forces)
        errors.append(1000 * surface_distance(skin, rest, seen, pose))
    youngs, ratios = YOUNG * np.geomspace(0.4, 2.5, 3 if coarse else 7), np.linspace(0.1, 0.47, 2 if coarse else 5)
    surface = error_surface(skin, held, seen, pose, youngs, ratios)
    title = f"{name}: a press of {np.linalg.norm(seen.force):g} N and what its simulation leaves"
    figures = (
        draw_surface_errors(1000 * across(seen, pose), *errors, 1000 * seen.hole, title),
        _draw_six(SIX[: len(fits)], values, [fit.young_sd for fit in fits]),
        _draw_surface(youngs, ratios, surface, (last.young, last.poisson)),
    )
    return {
        "six forces: E, standard deviation / mean": float(values.std(ddof=1) / values.mean()),
        "six forces: E, mean / truth - 1": float(values.mean() / YOUNG - 1),
        "figures": dict(zip(FIGURES, map(in_base64, figures), strict=True)),
    }


def error_surface(
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


@dataclass(frozen=True)
class Descents(Measurements):
    """How many solves a numeric descent after the paper's algorithm 1 takes where Gauss–Newton takes a few.

    One palpation of a ball and of a slab is fitted by both from starts a factor of thirty off: the descent walks from
    there, Gauss–Newton begins with a solve by the linear law, which counts. Where the body bears the force only turned
    inside out, the descent begins four times stiffer, as often as that takes; what it tried before doesn't count.
    Equilibria and linear systems are counted until E is near where that method ends on that mesh and stays there, and
    until that end. They end apart, as they measure distances otherwise; but a descent whose error is larger at its end
    than where Gauss–Newton ends has stopped short, and never arrives.
    """

    body: BodyName | None = None
    """that alone (default: both)"""

    @property
    def wanted(self) -> Mapping[str, Callable[[], Row]]:
        """Every start of a body."""
        pairs = itertools.product((self.body,) if self.body else BODIES, STARTS)
        return {f"{body}, start E × {start:.3g}": functools.partial(compare, body, start) for body, start in pairs}


def compare(name: str, start: float) -> Row:
    """What both methods take on a body from so many times the true E."""
    body = BODIES[name]
    seen = observe(*true_press(name, FORCES[-1], False), "stereo", DESCENT_SEED, POINTS)
    undivided = around(body.contact(*PLACE[name])[0][None], TOOL, body.size)
    skin, held = body.skin(PLAIN_CELLS, PLAIN_SPACING * body.size, undivided)
    exact = fit_material(skin, held, [seen], FitSettings(young=YOUNG * start))
    numeric = descend(skin, held, [seen], FitSettings(young=YOUNG * start), most=MAX_SOLVES)
    begun = numeric.path[0]
    path = [
        dataclasses.replace(each, solves=each.solves - begun.solves, systems=each.systems - begun.systems)
        for each in numeric.path
    ]
    found: Row = {"descent: E that it could begin at / truth": begun.young / YOUNG}
    for method, fit in (("Gauss–Newton", exact), ("descent", numeric)):
        found[f"{method}: E / truth - 1"] = fit.young / YOUNG - 1
        found[f"{method}: ν - truth"] = fit.poisson - POISSON
    there = FitSettings(young=exact.young, poisson=exact.poisson)
    larger = numeric.noise / descend(skin, held, [seen], there, most=1).noise - 1
    found["descent: error at its end over that where Gauss–Newton ends, less 1"] = larger
    arrived = larger < MAX_LARGER
    found |= _counted(f"E within {NEAR:.0%}", arrival(exact.path), arrival(path), arrived)
    return found | _counted("the end", exact.path[-1], path[-1], arrived)


def arrival(path: Sequence[Progress]) -> Progress:
    """Since when E has stayed near its last value."""
    end = path[-1].young
    return path[
        max((number for number, each in enumerate(path, start=1) if abs(each.young / end - 1) > NEAR), default=0)
    ]


def _counted(until: str, exact: Progress, numeric: Progress, arrived: bool) -> Row:
    """Solves of both methods, and their ratios unless the descent never arrives."""
    found: Row = {}
    for unit, word in (("solves", "equilibria"), ("systems", "linear systems")):
        one, other = getattr(exact, unit), getattr(numeric, unit)
        found[f"Gauss–Newton: {word} until {until}"] = one
        found[f"descent: {word} until {until}"] = other if arrived else f"never, after {other}"
        if arrived:
            found[f"{word} until {until}, descent / Gauss–Newton"] = other / one
    return found


@dataclass(frozen=True)
class Design(Measurements):
    """How well palpations of a scene can tell E and ν at best, before anything is fitted: the Cramér–Rao bound.

    By the fit's own law at the truth, on a coarse mesh: for places of a press and the two sensors' noise, the standard
    deviation of log E and ν with the sensor's pose at every picture unknown, and how many pictures of each press bring
    that of log E down to 0.02. `frank` presses where the fewest are needed.
    """

    @property
    def wanted(self) -> Mapping[str, Callable[[], Row]]:
        """Bodies, places and sensors."""
        return {
            f"{body}, {along:g}, {sensor}": functools.partial(bound, body, along, sensor)
            for body, along, sensor in itertools.product(BODIES, PLACES, SENSORS)
        }


def bound(name: str, along: float, sensor: str) -> Row:
    """Standard deviations of log E and ν from one picture of every press at a place, and how many are needed."""
    body = BODIES[name]
    skin, held = body.skin(DESIGN_CELLS, DESIGN_SPACING * body.size)
    contact, normal = body.contact(along, ANGLE)
    total = np.zeros((2, 2))
    for force in FORCES:
        forces = skin.pressed(contact, TOOL, -force * normal)
        rest = find_equilibrium(skin.body, Material("corotational", YOUNG, POISSON), held, forces=forces)
        seen = observe(skin, rest, -force * normal, contact, sensor, 0)
        total += information(Bench(skin, held, [seen], "corotational"), rest, SENSORS[sensor])
    young, poisson = np.sqrt(np.diag(np.linalg.inv(total)))
    return {
        "log E, standard deviation by one picture a press": young,
        "ν, standard deviation by one picture a press": poisson,
        "pictures needed": math.ceil((young / WANTED_SD) ** 2),
    }
