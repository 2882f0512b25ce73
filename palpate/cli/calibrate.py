"""Fit of material constants to measured forces.

    palpate calibrate palpation scene.yaml --output calibrated

Fits Young's modulus and Poisson's ratio to a surface at rest and to forces with the deformed surfaces that they leave
(Frank 2010). Writes calibration.json, and errors.csv, the distance of every point from the fitted surface.

Not a medical device.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console

from palpate.common.command_line import say
from palpate.common.files import as_json
from palpate.common.options import option
from palpate.common.options import options as read_options
from palpate.common.output import require_own, write_own
from palpate.common.tables import to_csv
from palpate.data.source.layout import InputError
from palpate.estimators.palpation.bench import surface_error
from palpate.estimators.palpation.material_fit import NOTHING, MaterialFit, fit_material
from palpate.estimators.palpation.scene import Scene, read_scene
from palpate.physics.fem import NoEquilibrium
from palpate.physics.identifiability import NINETY
from palpate.results.store import OutputError, make_output, writing


@dataclass(frozen=True)
class CalibrateOptions:
    """The scene and the results."""

    what: Literal["palpation"] = option(positional=True)
    """surfaces under forces"""
    scene: Path = option(positional=True, metavar="SCENE.yaml")
    """see docs/forces.md"""
    output: Path = option(metavar="OUT")
    """folder of the results"""


def main(arguments: list[str] | None = None) -> int:
    """Calibrate what the command line names; returns the exit status."""
    console = Console(stderr=True)
    options: CalibrateOptions = read_options(CalibrateOptions, arguments, "", __doc__)
    try:
        with writing(options.output):
            require_own(options.output / "calibration.json", options.output / "errors.csv")
        return _palpation(options, console)
    except (InputError, OutputError) as error:
        say(console, str(error), "red")
        return 1


def _palpation(options: CalibrateOptions, console: Console) -> int:
    path, output = options.scene, options.output
    scene = read_scene(path)
    make_output(output)  # before what takes minutes
    try:
        found = fit_material(scene.skin, scene.held, scene.palpations, report=lambda line: say(console, line))
    except (ValueError, NoEquilibrium) as error:
        raise InputError(f"{path}: {error}") from error
    nothing = found.verdict == NOTHING
    young, poisson = (None, None) if nothing else (found.young, found.poisson)
    record: dict[str, object] = {"verdict": found.verdict}
    record |= {"young_pa": young, "poisson": poisson, "surface_error_rms_m": found.noise, "equilibria": found.solves}
    record |= {"poses": found.poses, "source": f"{len(scene.palpations)} palpations of {path.name}"}
    softest, stiffest = found.young * np.exp(np.array([-1, 1]) * NINETY * found.young_sd)
    if not nothing:
        record |= {"young_low_pa": softest, "young_high_pa": stiffest, "poisson_sd": found.poisson_sd}
        record["covariance_of_log_young_and_poisson"] = found.covariance
    make_output(output)
    with writing(output):
        write_own(output / "calibration.json", as_json(record, indent=1) + "\n")
        write_own(output / "errors.csv", _errors(scene, found))
    say(console, f"written: {output}/calibration.json, {output}/errors.csv")
    if nothing:
        noise = f"points {1000 * found.noise:.2g} mm off the simulated surface (rms)"
        print(f"{NOTHING}: the surface moved too little for {noise}; press harder, or give more pictures.")
        return 0
    interval = f" (90 %: {softest:.4g} to {stiffest:.4g})"
    low, high = found.poisson - NINETY * found.poisson_sd, found.poisson + NINETY * found.poisson_sd
    doubt = f" (90 %: {low:.3f} to {high:.3f})" + ("" if found.verdict == "determined" else ", not determined")
    print(f"E = {found.young:.4g} Pa{interval}, ν = {found.poisson:.3f}{doubt}; {found.solves} equilibria")
    return 0


def _errors(scene: Scene, found: MaterialFit) -> str:
    rows = []
    for number, (rest, each, pose) in enumerate(zip(found.rests, scene.palpations, found.poses, strict=True), start=1):
        errors = 1000 * np.sqrt(surface_error(scene.skin, rest, each, pose))
        rows += [{"palpation": number, "point": i, "error_mm": error} for i, error in enumerate(errors.tolist())]
    return to_csv(rows, ("palpation", "point", "error_mm"), ".4f")
