"""Young's modulus and Poisson's ratio from palpations of bodies with known truth, as Frank 2010 does (section VIII-A).

    python -m benchmarks.palpation --output OUT [--body ball|slab]

A ball and a slab of neo-Hookean tissue on a finer mesh are pressed and observed from one side by two sensors; E and ν
are fitted by the co-rotational law, from starts a factor of thirty off; then E from each of the paper's six forces.
Writes table.csv (file, measure, value), and prints it; the same command continues an interrupted run.
"""

import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.harness import Measurements, Row, run
from benchmarks.palpation.synthetic import BODIES, POISSON, SENSORS, TOOL, YOUNG, observe, press
from palpate.common.doors import run_door
from palpate.estimators.palpation.material_fit import FitSettings, fit_material
from palpate.estimators.palpation.skin import Skin
from palpate.physics.fem import Equilibrium
from palpate.physics.fem.meshing import around

PLACES = {"ball": (0.35, 0.5), "slab": (0.6, 0.5)}
"""Arguments of `Body.contact` with which the Cramér–Rao bound requires the fewest pictures."""
FORCES = (0.3, 0.4, 0.5)
"""Forces of the presses in steps like the paper's robot's [N]. Laws differ where a body is dented by more."""
SIX = (0.25, 0.3, 0.35, 0.4, 0.45, 0.5)
"""Forces of the paper's figure 5 [N]."""
STARTS = (30.0, 1 / 30)
"""Young's modulus over its truth at the start of a fit."""
SEED = 73500
"""Seed of the first press's noise; the next presses have the next seeds."""

Truth = tuple[Skin, Equilibrium, np.ndarray, np.ndarray]
"""Skin, equilibrium, force and contact, as `press` returns them."""


@dataclass(frozen=True)
class Frank(Measurements):
    """The paper's experiments."""

    body: Literal["ball", "slab"] | None = None
    """one body; the slab without the six forces (default: both)"""

    @property
    def wanted(self) -> Mapping[str, Callable[[], Row]]:
        """Fits from every start, then the six forces."""
        found: dict[str, Callable[[], Row]] = {}
        for body in (self.body,) if self.body else BODIES:
            for sensor, start in itertools.product(SENSORS, STARTS):
                # Pictures of every press as the bound requires, each with its own pose.
                pictures = len(FORCES) * (5 if (body, sensor) == ("slab", "time of flight") else 1)
                name = f"{body}, {sensor}, {len(FORCES)} presses, {pictures} pictures, start E × {start:.3g}"
                found[name] = functools.partial(fit_from, body, sensor, start, pictures)
        if self.body != "slab":
            found["ball, stereo, one palpation"] = functools.partial(fit_six, "ball")
        return found


@functools.cache
def true_press(name: str, force: float) -> Truth:
    """The truth of a body under a force [N]."""
    body, (cells, edge) = BODIES[name], {"ball": (8, 0.5), "slab": (9, 0.4)}[name]
    return press(body, force, PLACES[name], cells, spacing=body.size / 64, edge=edge * TOOL)


@functools.cache
def fitted_mesh(name: str) -> tuple[Skin, np.ndarray]:
    """Surface on the mesh of the fits of a body, and the mask of its held components."""
    body, (cells, edge) = BODIES[name], {"ball": (6, 0.7), "slab": (7, 0.6)}[name]
    return body.skin(cells, body.size / 56, around(body.contact(*PLACES[name])[0][None], TOOL, edge * TOOL))


def fit_from(body: str, sensor: str, start: float, pictures: int) -> Row:
    """Measures of a fit that begins at `start` times the true E."""
    truths = itertools.islice(itertools.cycle([true_press(body, force) for force in FORCES]), pictures)
    palpations = [observe(*truth, sensor, SEED + number) for number, truth in enumerate(truths)]
    fit = fit_material(*fitted_mesh(body), palpations, FitSettings(young=YOUNG * start))
    return {
        "E / truth - 1": fit.young / YOUNG - 1,
        "E, standard deviation of its logarithm": fit.young_sd,
        "ν - truth": fit.poisson - POISSON,
        "ν, standard deviation": fit.poisson_sd,
        "verdict": fit.verdict,
        "equilibria a press": fit.solves / len(FORCES),
    }


def fit_six(name: str) -> Row:
    """Spread of E over the six forces, one palpation each."""
    fits = []
    for number, force in enumerate(SIX):
        observed = observe(*true_press(name, force), "stereo", SEED + 10 + number)
        fits.append(fit_material(*fitted_mesh(name), [observed], FitSettings(young=YOUNG / 30)))
    values = np.array([fit.young for fit in fits])
    return {
        "six forces: E, standard deviation / mean": float(values.std(ddof=1) / values.mean()),
        "six forces: E, mean / truth - 1": float(values.mean() / YOUNG - 1),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiments; returns the exit status."""
    return run(Frank, arguments, "benchmarks.palpation", __doc__)


if __name__ == "__main__":
    run_door(main)
