"""An example for `palpate calibrate palpation`: a slab of known stiffness that was pressed, in a few seconds.

    python -m benchmarks.palpation.example --output OUT
    palpate calibrate palpation OUT/scene.yaml --output RESULTS

Writes scene.yaml, rest.obj and observed.csv: a slab of 9 × 9 × 3 cm with E = 10 kPa and ν = 0.42 under a press of
0.5 N, observed by a stereo sensor (0.3 mm of noise). The sensor's pose is off by some millimetres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from rich.console import Console

from benchmarks.palpation.synthetic import BODIES, POISSON, TOOL, YOUNG, observe, press
from palpate.common.command_line import say
from palpate.common.doors import run_door
from palpate.common.options import options
from palpate.common.output import require_own, write_own
from palpate.estimators.palpation.bench import Palpation
from palpate.results.store import OutputError, make_output, writing

FILES = ("scene.yaml", "rest.obj", "observed.csv")


def scene_files(surface: tuple[np.ndarray, np.ndarray], observed: Palpation, held_below: float, cells: int) -> tuple:
    """Content of FILES, in their order: fields of the scene, and two texts.

    Args:
        surface: at rest, vertices [V, 3] [m] and triangles [F, 3].
        observed: the only palpation.
        held_below: height below which the body is held [m].
        cells: number of the fit's cells along the longest side.
    """
    palpation = {name: getattr(observed, name).tolist() for name in ("force", "contact", "pose")}
    palpation |= {"points": FILES[2], "tool_radius": observed.tool_radius, "hole": observed.hole}
    scene = {"surface": FILES[1], "held_axis": "z", "held_below": held_below, "cells": cells, "palpations": [palpation]}
    rows = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in surface[0]]
    rows += [f"f {a} {b} {c}" for a, b, c in surface[1] + 1]
    points = [f"{x:.7g},{y:.7g},{z:.7g}" for x, y, z in observed.points]
    return scene, "\n".join([*rows, ""]), "\n".join(["x,y,z", *points, ""])


@dataclass(frozen=True)
class Example:
    """Output folder."""

    output: Path
    """folder of the example"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the example; returns the exit status."""
    output = options(Example, arguments, "benchmarks.palpation.example", __doc__).output
    console = Console(stderr=True)
    try:
        with writing(output):
            require_own(*(output / name for name in FILES))
        # Four cells along the slab, a scan of triangles of 3 mm, and edges of 0.6 radii where the tool presses.
        truth = press(BODIES["slab"], 0.5, (0.35, 0.5), 4, "corotational", 0.003, 0.6 * TOOL)
        observed = observe(*truth, "stereo", 73600, count=4000)
        scene, *texts = scene_files((truth[0].vertices, truth[0].triangles), observed, 0.0, 5)
        head = f"# Lengths in metres. The truth: E = {YOUNG:g} Pa, ν = {POISSON:g}.\n"
        make_output(output)
        with writing(output):
            for name, text in zip(FILES, [head + yaml.safe_dump(scene, sort_keys=False), *texts], strict=True):
                write_own(output / name, text)
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    say(console, f"written: {', '.join(f'{output}/{name}' for name in FILES)}; the truth is E = {YOUNG:g} Pa")
    return 0


if __name__ == "__main__":
    run_door(main)
