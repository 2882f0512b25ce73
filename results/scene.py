"""A press as a scene to simulate further: written for USD, SOFA and VTK as scene.yaml has it, and read again.

Every file says all that `simulate` needs, and the ends of the 90 % intervals. A SOFA scene is made of SOFA's own
components besides, and runs there with the same steps: explicit damping of a mass Δt/kick, `kick` being that of
`physics.msd.reference.Integrator`, is the implicit (or exact) damping of the mass m.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from palpate.common.files import read_file
from palpate.estimators.direct.estimator import fitted_press
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.records import InteractionEstimate
from palpate.physics.load import Press
from palpate.physics.mechanics import PARAMETERS, SCHEMES, Mechanics
from palpate.physics.mesh import Mesh
from palpate.physics.msd.reference import free_vertices, integrator

_TEXTS = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
PARTS: dict[str, tuple[str, int, str, str]] = {name: tuple(part) for name, part in _TEXTS["parts"].items()}
"""What every file holds: group, numbers a row, type and unit of each."""
FORMATS: dict[str, dict[str, Any]] = _TEXTS["formats"]
"""How each format holds it."""
_OF_ENDING = {f".{kind['ending']}": kind for kind in FORMATS.values()}


@dataclass(frozen=True, eq=False)
class Scene:
    """A press on a sheet of springs; `simulate(scene.theta, scene.mesh, scene.press, scene.mechanics)` moves it."""

    mesh: Mesh
    """Tissue at rest."""
    press: Press
    """The load, from its beginning."""
    mechanics: Mechanics
    """Constants of the simulator."""
    theta: np.ndarray
    """k_s, k_d and signed F, shape [3] [scene units]."""
    interval: np.ndarray
    """Lower and upper end of each one's 90 % interval, shape [3, 2]."""
    by_light: bool
    """Whether the light told them, so that lengths and forces are relative to the tissue's distance."""

    @classmethod
    def of(cls, run: InteractionEstimate) -> Scene:
        """That of a run of contact.

        Raises:
            NoEstimate: k_s, k_d and F of a sheet of springs are not all determined.
        """
        found, contact, mechanics = run.estimate, run.interaction, run.mechanics
        if found is None or contact is None or mechanics is None or not {*PARAMETERS} <= {*found.determined}:
            raise NoEstimate("k_s, k_d and F of a sheet of springs are not all determined.")
        numbers = found.numbers()
        ends = np.array([[numbers[f"{name}_{end}"] for end in ("low", "high")] for name in PARAMETERS])
        press = fitted_press(contact, found, mechanics.time_step, mechanics.steps)
        theta = np.asarray(found.theta, np.float64)
        return cls(contact.mesh, press, mechanics, theta, np.sort(np.sign(theta)[:, None] * ends), found.by_light)


def write_scene(path: Path, scene: Scene) -> None:
    """Write a scene in the format that the file's ending names.

    Raises:
        OSError: the file can't be written.
    """
    mesh, press, mechanics, kind = scene.mesh, scene.press, scene.mechanics, _OF_ENDING[path.suffix]
    held, pushes = ~free_vertices(mesh, press), scene.theta[2] * np.outer(press.weights, press.direction)
    load = np.zeros(mesh.vertices.shape)
    np.add.at(load, press.vertices, pushes)
    values: dict[str, Any] = {"points": mesh.vertices, "load": load, "held": held, "by_light": scene.by_light}
    values |= {name: getattr(mesh, name) for name in ("triangles", "springs", "pixels", "grid_shape")}
    values |= {f"load_{name}": getattr(press, name) for name in ("vertices", "weights", "direction", "factor")}
    values |= {"mass": mechanics.mass, "time_step": mechanics.time_step, "scheme": SCHEMES.index(mechanics.scheme)}
    values |= dict(zip(PARAMETERS, np.column_stack([scene.theta, scene.interval]), strict=True))

    def text(numbers: object) -> str:
        return kind["comma"].join(np.asarray(numbers).ravel().astype(str))

    texts, lines = {}, defaultdict(list)
    for name, (group, width, dtype, unit) in PARTS.items():
        numbers = np.asarray(values[name], dtype)
        texts[name] = text(numbers)
        words = {"name": name, "values": texts[name], "unit": unit, "width": width, "rows": numbers.size // width}
        lines[group].append(kind.get(group, "").format(**words, kind=kind["kinds"].get(dtype)))
    texts |= {group: "\n".join(of_group) for group, of_group in lines.items()}
    for name in ("spring", "triangle"):
        rows, width = values[f"{name}s"].shape
        texts |= {f"{name}_count": rows, f"{name}_ends": text(width * np.arange(1, rows + 1))}
    points = mesh.vertices.astype(str)
    texts["tuples"] = ", ".join(f"({', '.join(point)})" for point in points)
    texts |= {"vertex_count": len(points), "threes": text(np.full(len(mesh.triangles), 3))}
    # Lengths of what the file says, so that nothing pulls at rest.
    lengths = np.linalg.norm(np.diff(points.astype(np.float64)[mesh.springs], axis=1)[:, 0], axis=1)
    springs = zip(mesh.springs.tolist(), lengths.tolist(), strict=True)
    texts["elastic"] = " ".join(f"{first} {second} {scene.theta[0]} 0 {length}" for (first, second), length in springs)
    damped_mass = mechanics.time_step / integrator(scene.theta[1], mechanics).kick
    texts |= {"damping_alone": scene.theta[1], "damped_mass": damped_mass}
    # Without any, SOFA holds the first vertex.
    texts["fixed"] = f'<FixedProjectiveConstraint indices="{text(np.flatnonzero(held))}"/>' if held.any() else ""
    # Between keys SOFA goes straight; a step takes the force of its beginning.
    keys = np.flatnonzero(np.diff(press.factor, 2, prepend=np.nan, append=np.nan) != 0)
    texts["loads"] = "".join(
        f'<LinearForceField points="{vertex}" times="{text(mechanics.time_step * keys)}" '
        f'forces="{text(np.outer(press.factor[keys], push))}"/>'
        for vertex, push in zip(press.vertices, pushes, strict=True)
    )
    path.write_text(kind["file"].format(**texts), encoding="utf-8")


def read_scene(path: Path) -> Scene:
    """A scene that `write_scene` wrote; vertices that are pressed count as not held.

    Raises:
        OSError: the file can't be read.
        ValueError: another program wrote it.
    """
    try:
        kind, parts = _OF_ENDING[path.suffix], {}
        found = re.findall(kind["found"], read_file(path).decode())
        texts = {next(filter(None, names)): text for *names, text in reversed(found)}
        for name, (_, width, dtype, _) in PARTS.items():
            numbers = re.sub("[(),]", " ", texts[kind["names"].get(name, name)]).split()
            parts[name] = np.array(numbers, dtype).reshape(-1, width)
        sheet = (parts[name] for name in ("points", "triangles", "springs"))
        mesh = Mesh(*sheet, parts["held"].ravel() > 0, parts["pixels"], tuple(parts["grid_shape"][0].tolist()))
        factor, direction = parts["load_factor"].ravel(), parts["load_direction"].ravel()
        press = Press(parts["load_vertices"].ravel().astype(np.int64), parts["load_weights"].ravel(), direction, factor)
        scheme, loaded = SCHEMES[parts["scheme"].item()], int(np.count_nonzero(factor))
        mechanics = Mechanics(parts["mass"].item(), parts["time_step"].item(), len(factor), loaded, scheme)
    except (KeyError, IndexError, ValueError) as error:
        raise ValueError(
            f"{path}: is no scene that palpate wrote ({error}); give one of `palpate infer --export`."
        ) from error
    spread = np.concatenate([parts[name] for name in PARAMETERS])
    return Scene(mesh, press, mechanics, spread[:, 0], spread[:, 1:], bool(parts["by_light"].item()))
