"""How long `palpate plan` takes on a body of 327,680 triangles: at first, and again with its road map kept.

    python -m tests.planning.large_mesh

The body is a waved superellipsoid, 12 cm long and as thin as a fold, in an OBJ file. Each time is of a process of its
own, which imports all it needs; one that only prints its help goes before, so that Python's compiled files exist.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
import yaml

from palpate.common.options import options, require_within

ROOT = Path(__file__).parents[2]
HALF = np.array([0.06, 0.014, 0.03])
"""Of the body, along each axis [m]."""
POWER = 3.0
"""Of the superellipsoid."""
WAVES, TURNS = 0.004, 8.0
"""How far the fold swings to either side [m], and the angle it turns through from the middle to an end."""


@dataclass(frozen=True)
class Options:
    """Of the command."""

    subdivisions: int = 7
    """Of an icosahedron; each makes four triangles of one."""

    def __post_init__(self) -> None:
        require_within(self, subdivisions=(3, 8))


def write_scene(folder: Path, subdivisions: int) -> tuple[Path, trimesh.Trimesh]:
    """Write the body and the scene that names it, from one end of the fold to the other; the scene's file, the body."""
    ball = trimesh.creation.icosphere(subdivisions)
    places = ball.vertices / (np.abs(ball.vertices) ** POWER).sum(axis=1, keepdims=True) ** (1 / POWER)
    waves = WAVES * np.sin(TURNS * places[:, 0])
    places *= HALF
    places[:, 1] += waves
    body = trimesh.Trimesh(places, ball.faces, process=False)
    body.export(folder / "fold.obj")
    values = {"mesh": "fold.obj", "start": [-0.07, 0.0, 0.02], "goal": [0.07, 0.0, 0.02], "port": [0.0, 0.0, 0.15]}
    scene = folder / "scene.yaml"
    scene.write_text(yaml.safe_dump(values | {"young": 5000.0, "limit_N": 1.0, "alpha": 0.8}))
    return scene, body


def timed(*arguments: str) -> tuple[float, float]:
    """Time that passes while `palpate plan` runs, and its processors' time, of user and system [s].

    Raises:
        subprocess.CalledProcessError: it failed.
    """
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "palpate", "plan", *arguments]
    subprocess.run(command, check=True, cwd=ROOT, env=kept, stdout=subprocess.DEVNULL)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure; returns the exit status."""
    chosen = options(Options, arguments, "tests.planning.large_mesh", __doc__)
    with tempfile.TemporaryDirectory() as name:
        scene, body = write_scene(Path(name), chosen.subdivisions)
        print(f"{len(body.faces):,} triangles, {100 * np.ptp(body.vertices[:, 0]):.0f} cm", flush=True)
        timed("--help")
        for which in ("first", "again"):
            wall, busy = timed(str(scene), "--output", f"{name}/out")
            query = json.loads((Path(name) / "out" / "plan.json").read_text())["query_s"]
            print(f"{which}: {wall:.1f} s, processors {busy:.1f} s, the path alone {query:.2f} s", flush=True)
    return 0


if __name__ == "__main__":
    run_door(main)
