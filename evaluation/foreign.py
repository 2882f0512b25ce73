"""The finite elements on other people's data: a clamped silicone beam that is let go, with a mass at its tip.

    python -m evaluation.foreign --data DIR --output OUT

Runs on every `beam_*.csv` under DIR and writes table.csv (file, measure, value): Young's modulus from some runs, and
the motion of others; what the measures mean is in docs/reports/fem.md.

The first mode's frequency and decay of every run are measured; those of runs up to `FITTED` fit a standard linear
solid, whose complex modulus is E (1 + γ iωτ/(1 + iωτ)) (Findley 1976, section 5.3), on a finite-element model of it.
Other masses are then predicted.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import io
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import diags_array
from scipy.sparse.linalg import eigsh

from palpate.common.files import read_file
from palpate.common.settings import LARGEST
from palpate.data.source.layout import InputError
from palpate.data.source.table import MOST_BYTES, reason
from palpate.evaluation.harness import FileMeasurements, Row, run
from palpate.physics.fem import Material, Relaxation, box, make_solid
from palpate.physics.fem.laws import respond

LENGTHS = (0.1, 0.03, 0.03)
"""[m]."""
DENSITY, POISSON = 1070.0, 0.499
MESHES = ((12, 3, 3), (16, 4, 4))
"""Cells of two meshes of quadratic elements (linear ones lock at this ν), which differ in size alone: rates fall as its
square and are extrapolated to none."""
FITTED = 0.06
"""Largest mass at the tip of a run that is fitted [kg]: heavier ones are predicted."""
PUBLISHED = 264e3
"""Young's modulus that was published with the data [Pa]."""
TIP, VERTICAL = 3, 0
"""Markers on the tip, which come first, and the coordinate along which it moves."""
KNOWN = (253e3, 0.245, 0.0303)
"""E, γ and τ [s] that `fit_solid` finds on the four runs with up to 52 g; it predicts where these aren't there."""


@dataclass(frozen=True)
class Ringing:
    """First mode of a run."""

    mass: float
    """At the tip [kg]."""
    frequency: float
    """[Hz]."""
    decay: float
    """Of the amplitude [1/s]."""
    residual: float
    """Root mean square of what the fitted oscillation leaves, over its first amplitude."""


def tip_mass(path: Path) -> float:
    """Mass that a run's file name gives [kg]; raises InputError where it gives none."""
    found = re.search(r"beam_(?:.*_)?(?:(gravity)|load[_-]?(\d+(?:\.\d+)?))", path.name, re.IGNORECASE)
    if found is None:
        raise InputError(f"{path.name}: the name gives no load; call it beam_gravity… or beam_load52… with its grams.")
    return 0.0 if found[1] else float(found[2]) / 1000


def read_ringing(path: Path) -> Ringing:
    """Measure a run: a damped oscillation about a rest that creeps, from the first turning point on.

    Args:
        path: table with a column of times [s], then three coordinates a marker [m], tip first.

    Raises:
        InputError: another table, or nothing that rings.
    """
    mass = tip_mass(path)
    try:
        with warnings.catch_warnings(action="error", category=UserWarning):  # a table without rows
            text = io.StringIO(read_file(path, MOST_BYTES).decode("utf-8-sig"))
            table = np.loadtxt(text, delimiter=",", skiprows=1, ndmin=2)
    except (OSError, ValueError, UserWarning) as error:
        raise InputError(
            f"{path.name} is no table of numbers ({reason(error)}); give times and markers by columns."
        ) from error
    if table.shape[1] < 1 + 3 * TIP or len(table) < 50 or not (np.abs(table) <= LARGEST).all():
        raise InputError(f"{path.name} has shape {table.shape}; give times and three markers at least, 50 rows.")
    if not (np.diff(table[:, 0]) > 0).all():
        raise InputError(f"{path.name} holds a time that is not after the one before; sort its rows by time.")
    times, height = table[:, 0], table[:, 1 + VERTICAL : 1 + 3 * TIP : 3].mean(axis=1)
    fall = height - np.median(height[-50:])
    begun = np.flatnonzero(np.abs(fall) < np.abs(fall[0]) / 2)
    if not len(begun) or np.abs(fall[0]) < 1e-3:
        raise InputError(f"{path.name} shows no beam that is let go: its tip ends where it began.")
    first = begun[0] + int(np.argmin(fall[begun[0] : begun[0] + 30] * np.sign(fall[0])))
    time, fall = times[first:] - times[first], fall[first:]
    # Where the spectrum peaks, for a start.
    spectrum = np.abs(np.fft.rfft(fall - fall.mean(), 4096))
    start = float(np.fft.rfftfreq(4096, float(np.median(np.diff(times))))[np.argmax(spectrum[8:]) + 8])

    def model(values: np.ndarray) -> np.ndarray:
        cosine, sine, decay, frequency, rest, creep, slowness = values
        turn = 2 * np.pi * frequency * time
        ringing = np.exp(-decay * time) * (cosine * np.cos(turn) + sine * np.sin(turn))
        return ringing + rest + creep * np.exp(-time / slowness)

    size = float(np.abs(fall[0]))
    scales = [size, size, 1.0, 1.0, size, size, 1.0]
    low, high = [-np.inf, -np.inf, 0.0, 0.1, -np.inf, -np.inf, 0.2], [np.inf, np.inf, 50, 40, np.inf, np.inf, 20.0]
    guess = [fall[0], 0.0, 2.0, float(np.clip(start, 0.2, 39.0)), 0.0, 0.0, 1.0]
    found = least_squares(lambda values: model(values) - fall, guess, x_scale=scales, bounds=(low, high))
    residual = float(np.sqrt(np.mean(found.fun**2))) / size
    return Ringing(mass, float(found.x[3]), float(found.x[2]), residual)


def measure_ringing(path: Path) -> Row:
    """A run's ringing as a row; raises InputError as `read_ringing` does."""
    return {"ringing": asdict(read_ringing(path))}


def modal_rates(masses: Sequence[float]) -> np.ndarray:
    """Square of the first mode's angular frequency over Young's modulus, one for every mass at the tip [1/(Pa s²)],
    extrapolated from two meshes to elements of no size (Richardson 1911).
    """
    coarse, fine = (mesh_rates(masses, cells) for cells in MESHES)
    shrunk = (MESHES[0][0] / MESHES[1][0]) ** 2
    return fine - (coarse - fine) * shrunk / (1 - shrunk)


def mesh_rates(masses: Sequence[float], cells: tuple[int, int, int]) -> np.ndarray:
    """The same on one mesh, which is too stiff."""
    nodes, tetrahedra = box(LENGTHS, cells)
    body = make_solid(nodes, tetrahedra, order=2)
    mu, lam = Material("linear", 1.0, POISSON).lame
    tangent = respond("linear", body.deformation(np.zeros_like(body.rest)), mu, lam, tangent=True).tangent
    assert tangent is not None
    free = np.repeat(body.rest[:, 0] > 1e-9, 3)
    stiffness = body.stiffness(tangent)[free][:, free].tocsc()
    end = np.repeat(np.isclose(body.rest[:, 0], LENGTHS[0]), 3)[free]
    beam = DENSITY * body.mass[free][:, free]
    found = []
    for mass in masses:
        inertia = (beam + diags_array(np.where(end, 3 * mass / end.sum(), 0.0))).tocsc()
        found.append(float(eigsh(stiffness, k=1, M=inertia, sigma=0, return_eigenvectors=False)[0]))
    return np.array(found)


def ringing_of(solid: tuple[float, Relaxation], rate: float) -> tuple[float, float]:
    """Frequency [Hz] and decay [1/s] of a mode of a standard linear solid: s² + rate·E(s) = 0, its oscillating root.

    Args:
        solid: relaxed Young's modulus [Pa], and its relaxation.
        rate: of `modal_rates`.
    """
    young, relaxation = solid
    tau = relaxation.time
    # (s² + rate E)(1 + sτ) + rate E γ sτ = 0
    roots = np.roots([tau, 1, rate * young * tau * (1 + relaxation.ratio), rate * young])
    root = roots[np.argmax(roots.imag)]
    return float(root.imag) / (2 * np.pi), float(-root.real)


def fit_solid(runs: Sequence[Ringing], rates: Mapping[float, float]) -> tuple[float, Relaxation]:
    """Relaxed Young's modulus [Pa] and relaxation that explain frequencies and decays, each by its ratio.

    Args:
        runs: of two masses at least.
        rates: `modal_rates` of these masses.
    """
    masses = [run.mass for run in runs]
    measured = np.log([[run.frequency, run.decay] for run in runs])

    def off(values: np.ndarray) -> np.ndarray:
        young, ratio, time = np.exp(values)
        solid = float(young), Relaxation(float(ratio), float(time))
        pairs = [ringing_of(solid, rates[mass]) for mass in masses]
        # Decays scatter ten times as much as frequencies do.
        return ((np.log(pairs) - measured) * [10.0, 1.0]).ravel()

    found = np.exp(least_squares(off, np.log([2e5, 0.3, 0.03])).x)
    return float(found[0]), Relaxation(float(found[1]), float(found[2]))


def judge_beams(runs: Mapping[str, Ringing]) -> dict[str, dict[str, object]]:
    """Measures of every run: what is measured, and of those that are not fitted what is predicted.

    Args:
        runs: by the file's name.
    """
    masses = sorted({run.mass for run in runs.values()})
    rates = {mass: float(rate) for mass, rate in zip(masses, modal_rates(masses), strict=True)}
    fitted = [run for run in runs.values() if run.mass <= FITTED]
    enough = len({run.mass for run in fitted}) > 1
    young, relaxation = fit_solid(fitted, rates) if enough else (KNOWN[0], Relaxation(*KNOWN[1:]))
    found: dict[str, dict[str, object]] = {}
    own: dict[str, float] = {}
    for name, each in runs.items():
        rate = rates[each.mass]
        own[name] = (2 * np.pi * each.frequency) ** 2 / rate
        measures: dict[str, object] = {
            "tip mass (kg)": each.mass,
            "frequency (Hz)": each.frequency,
            "decay (1/s)": each.decay,
            "residual / amplitude": each.residual,
            "E of this run, dynamic (Pa)": own[name],
            "E of this run / published - 1": own[name] / PUBLISHED - 1,
        }
        if each.mass > FITTED:
            frequency, decay = ringing_of((young, relaxation), rate)
            measures |= {
                "predicted frequency (Hz)": frequency,
                "predicted decay (1/s)": decay,
                "frequency error": frequency / each.frequency - 1,
                "decay error": decay / each.decay - 1,
                "predicted from": "gravity and load52 here" if enough else "the fit that comes along",
            }
        found[name] = measures
    if enough:
        stiffness = [value for name, value in own.items() if runs[name].mass <= FITTED]
        dynamic = float(np.exp(np.mean(np.log(stiffness))))
        found["beam, fitted together"] = {
            "E (Pa)": dynamic,
            "E / published - 1": dynamic / PUBLISHED - 1,
            "E, relaxed (Pa)": young,
            "relaxing share": relaxation.ratio,
            "relaxation time (s)": relaxation.time,
        }
    return found


@dataclass(frozen=True)
class Foreign(FileMeasurements):
    """Other people's data."""

    named: ClassVar = "beam_*.csv"

    def measure(self, path: Path) -> Callable[[Path], Row] | None:
        """The ringing of runs of beams."""
        return measure_ringing if path.name.startswith("beam_") and path.suffix == ".csv" else None

    def tabled(self, rows: Sequence[Row]) -> list[Row]:
        """In place of beams as they were measured, what their runs say together."""
        runs = {row["file"]: Ringing(**row["ringing"]) for row in rows if "ringing" in row}
        judged = judge_beams(runs) if runs else {}
        failed = [row for row in rows if "status" in row]
        return [*failed, *({"file": name, **measures} for name, measures in judged.items())]


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge what lies under a folder; returns the exit status."""
    return run(Foreign, arguments, "evaluation.foreign", __doc__)


if __name__ == "__main__":
    run_door(main)
