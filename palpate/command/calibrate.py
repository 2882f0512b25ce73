"""From measured forces to material constants.

    palpate calibrate palpation SCENE.yaml|SEQUENCE.yaml --output OUT
    palpate calibrate curves FILE.csv … --output OUT [--indenter sphere --size MM] [--poisson NU] [--predict MM …]

palpation   Young's modulus and Poisson's ratio from a surface, and forces with the deformed surfaces that they leave
            (Frank 2010), or from clouds, poses and forces of a robot whose tool presses (sequence.yaml). Writes
            calibration.json, errors.csv, the distance of every point from the fitted surface, and errors.png, where
            these lie, next to those of a body half as stiff.
curves      a modulus [kPa] for every probe where the indenter is stated, a stiffness [N/mm] otherwise, from tables of
            probes (probe, contact_x …, depth_mm, fn_N), of a press (depth_mm, force_N) or of a pull (pull_mm,
            force_N); where the curve stiffens, by how much; and the force beyond its largest depth where that is told
            within 25 %. A relaxation from tables of a hold (t_s, force_N, displacement_mm). Writes curves.csv.

Not a medical device.
"""

from __future__ import annotations

import argparse
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from palpate.common.command_line import add_listed, described_parser, path_option, real_number, say
from palpate.common.files import as_json, read_beside
from palpate.common.output import replacing_own, require_own, write_own
from palpate.common.tables import to_csv
from palpate.data.source.layout import InputError
from palpate.estimators.estimate import NINETY
from palpate.estimators.palpation import Indenter, fit_indentation, fit_relaxation, read_hold, read_probes
from palpate.estimators.palpation.bench import across, half_as_stiff, surface_distance, surface_error
from palpate.estimators.palpation.curves import HOLD, PROBES, PULL, Probe, kind_of, read_pull
from palpate.estimators.palpation.material_fit import NOTHING, MaterialFit, fit_material
from palpate.estimators.palpation.scene import Scene, read_scene
from palpate.estimators.palpation.stiffening import fit_stiffening, told
from palpate.estimators.palpation.stiffening_check import STIFFENS, UNKNOWN
from palpate.physics.fem import NoEquilibrium
from palpate.results.plots import write_figure
from palpate.results.scene.files import scene_text
from palpate.results.scene.kinds import palpation_scene
from palpate.results.scene.scene import FORMATS
from palpate.results.store import OutputError, make_output, writing
from palpate.results.surface_plot import draw_surface_errors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PALPATION = ("calibration.json", "errors.csv", "errors.png")
BENT = 0.02
"""What a straight line leaves, over the range of forces, from which on a curve isn't one, if it leaves no mere noise:
that differs from row to row by more than by itself."""
CURVES = ("file", "curve", "quantity", "value", "low", "high", "unit", "verdict")


SIZE, POISSON = real_number("a positive number", 1e-6), real_number("from 0 to 0.5", 0.0)
TYPES = {"path": path_option, "size": SIZE, "poisson": POISSON}
CHOICES = {"scenes": tuple(FORMATS), "indenters": ("sphere", "flat", "cone")}
"""What calibrate.yaml calls types and choices."""


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    statuses = "0 done; 1 something could not be; 2 wrong usage; 130 interrupted"
    parser = described_parser("palpate calibrate", __doc__, statuses)
    doors = parser.add_subparsers(dest="what", required=True)
    for name, door in read_beside(__file__).items():
        add_listed(doors.add_parser(name, help=door["help"]), door["options"], TYPES, CHOICES)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Calibrate what the command line names; returns the exit status."""
    parser, console = build_parser(), Console(stderr=True)
    options: Any = parser.parse_args(arguments)
    curves, indenter = options.what == "curves", None
    if curves and (options.indenter is None) != (options.size is None):
        parser.error("--indenter and --size belong together; give both, or none where the indenter is not known.")
    if curves and options.indenter is not None:
        try:
            indenter = Indenter(options.indenter, options.size, options.poisson)
        except ValueError as error:
            parser.error(str(error))
    try:
        with writing(options.output):
            require_own(*(options.output / name for name in (("curves.csv",) if curves else PALPATION)))
        if curves:
            return _curves(options, indenter, console)
        return _palpation(options, console)
    except (InputError, OutputError) as error:
        say(console, str(error), "red")
        return 1


def _palpation(options: argparse.Namespace, console: Console) -> int:
    path, thickness, output = options.scene, options.sheet_thickness, options.output
    scene = read_scene(path)
    for note in scene.notes:
        say(console, f"surface: {note}", "yellow")
    make_output(output)  # before what takes minutes
    try:
        problem = scene.skin, scene.held, scene.palpations, scene.settings
        found = fit_material(*problem, report=lambda line: say(console, line))
    except (ValueError, NoEquilibrium) as error:
        raise InputError(f"{path}: {error}") from error
    nothing = found.verdict == NOTHING
    young, poisson = (None, None) if nothing else (found.young, found.poisson)
    record: dict[str, object] = {"law": scene.settings.law, "verdict": found.verdict}
    record |= {"young_pa": young, "poisson": poisson, "surface_error_rms_m": found.noise, "equilibria": found.solves}
    record |= {"stiffening": found.stiffens}
    if found.stiffens == STIFFENS and not nothing:
        record |= zip(("stiffening_b", "stiffening_b_low", "stiffening_b_high"), found.stiffening.tolist(), strict=True)
    record |= {"poses": found.poses, "source": f"{len(scene.palpations)} palpations of {path.name}"}
    if thickness is not None:
        record["thickness_m"] = thickness / 1000
    if not nothing:
        half = NINETY * found.young_sd
        record |= {
            "young_low_pa": found.young * np.exp(-half),
            "young_high_pa": found.young * np.exp(half),
            "poisson_sd": found.poisson_sd,
            "covariance_of_log_young_and_poisson": found.covariance,
        }
    _write(output, "calibration.json", as_json(record, indent=1) + "\n")
    _write(output, "errors.csv", _errors(scene, found))
    with writing(output), replacing_own(output / PALPATION[2]) as partial:
        write_figure(partial, _picture(scene, found))
    names = list(PALPATION)
    stiffens = any(rest.material.stiffening > 0 for rest in found.rests)
    if stiffens and options.export is not None:
        say(console, "no scene: other simulators have no law that stiffens as the body does.", "yellow")
    for number in range(len(found.rests) if options.export is not None and not (nothing or stiffens) else 0):
        names.append(f"scene_{number + 1}.{FORMATS[options.export]['ending']}")
        _write(output, names[-1], scene_text(palpation_scene(found, number), options.export))
    say(console, f"written: {', '.join(f'{output}/{name}' for name in names)}")
    if nothing:
        noise = f"points {1000 * found.noise:.2g} mm off the simulated surface (rms)"
        print(f"{NOTHING}: the surface moved too little for {noise}; press harder, or give more pictures.")
        return 0
    interval = f" (90 %: {record['young_low_pa']:.4g} to {record['young_high_pa']:.4g})"
    low, high = found.poisson - NINETY * found.poisson_sd, found.poisson + NINETY * found.poisson_sd
    doubt = f" (90 %: {low:.3f} to {high:.3f})" + ("" if found.verdict == "determined" else ", not determined")
    print(f"E = {found.young:.4g} Pa{interval}, ν = {found.poisson:.3f}{doubt}; {found.solves} equilibria")
    said = {STIFFENS: ", b = {:.3g} (90 %: {:.3g} to {:.3g})", UNKNOWN: ": press with forces further apart"}
    print(found.stiffens + said.get(found.stiffens, "").format(*found.stiffening))
    return 0


def _picture(scene: Scene, found: MaterialFit) -> Figure:
    """What the first palpation's simulation leaves, next to that of half as stiff a body where that bears the force."""
    each, pose, softer = scene.palpations[0], found.poses[0], None
    fitted = 1000 * surface_distance(found.skin, found.rests[0], each, pose)
    with suppress(NoEquilibrium):
        softer = 1000 * surface_distance(found.skin, half_as_stiff(found.rests[0]), each, pose)
    title = f"Palpation 1 of {len(scene.palpations)}, {np.linalg.norm(each.force):.3g} N: what its simulation leaves"
    return draw_surface_errors(1000 * across(each, pose), fitted, softer, 1000 * each.hole, title)


def _errors(scene: Scene, found: MaterialFit) -> str:
    rows = []
    for number, (rest, each, pose) in enumerate(zip(found.rests, scene.palpations, found.poses, strict=True), start=1):
        errors = 1000 * np.sqrt(surface_error(found.skin, rest, each, pose))
        rows += [{"palpation": number, "point": i, "error_mm": error} for i, error in enumerate(errors.tolist())]
    return to_csv(rows, ("palpation", "point", "error_mm"), ".4f")


def _curves(options: argparse.Namespace, indenter: Indenter | None, console: Console) -> int:
    rows, status, missed, output = [], 0, 0, options.output
    for path in options.files:
        try:
            if (kind := kind_of(path)) == HOLD:
                fit = fit_relaxation(read_hold(path), branches=1)
                if fit.solid is None:
                    raise InputError(f"{path}: the force falls to nothing or not at all; no standard linear solid.")
                rows.append((path.name, "hold", "relaxing share", 1 - fit.relaxed_share, None, None, None, None))
                rows.append((path.name, "hold", "relaxation time", fit.solid.time, None, None, "s", None))
                continue
            if kind == PULL and indenter is not None:
                raise InputError(f"{path} is of a pull, in which nothing indents; leave --indenter and --size out.")
            for probe in read_probes(path) if kind == PROBES else [read_pull(path)]:
                known = _curve(probe, indenter, kind == PULL, options.predict)
                rows += [(path.name, probe.name, *row) for row in known]
                missed += sum(row[0].startswith("force at") and row[1] is None for row in known)
        except (InputError, ValueError) as error:
            say(console, str(error), "red")
            status = 1
    if missed:
        why = "as the laws that fit a curve part beyond it (curves.csv has their intervals); measure further"
        say(console, f"forces not told within 25 %: {missed}, {why}, or --predict nearer.", "yellow")
    _write(output, "curves.csv", to_csv([dict(zip(CURVES, row, strict=True)) for row in rows], CURVES, ".6g"))
    say(console, f"written: {output}/curves.csv")
    return status


def _curve(probe: Probe, indenter: Indenter | None, pull: bool, predict: list[float] | None) -> list[tuple]:
    """Rows of curves.csv from its third column on."""
    found, law = fit_indentation(probe.depth, probe.force, indenter), fit_stiffening(probe.depth, probe.force)
    unknown = "stiffness" if pull else "stiffness, indenter unknown"
    name = unknown if indenter is None else f"Young's modulus, {indenter.shape}"
    stiffens = law.stiffens and indenter is None  # under an indenter a curve bends by its shape alone
    doubt = "stiffening, not determined" if stiffens else "not determined"
    off = probe.force - found.value * (probe.depth - found.begins)  # the line, where no indenter is known
    bent = indenter is None and off.std() > max(BENT * np.ptp(probe.force), np.diff(off).std())
    said = "stiffening" if stiffens else "not a straight line" if bent else None
    rows: list[tuple] = [(name, found.value, found.low, found.high, found.unit, said)]
    stiffness, growth = law.numbers
    numbers = [("stiffness at the least depth", stiffness, "N/mm"), ("growth of the stiffness, b", growth, "1/mm")]
    depths = law.begin + (law.end - law.begin) * np.array([1.25, 1.5, 2.0]) if predict is None else np.array(predict)
    forces = [(f"force at {at:.4g} mm", force, "N") for at, force in zip(depths, law.force(depths).T, strict=True)]
    for name, (value, low, high), unit in numbers * stiffens + forces:
        known = told(value, low, high)
        rows.append((name, value if known else None, low, high, unit, "determined" if known else doubt))
    return rows


def _write(output: Path, name: str, text: str) -> None:
    make_output(output)
    with writing(output):
        write_own(output / name, text)
