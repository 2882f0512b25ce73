"""A foreign simulation of a pulled liver: the force from its surface's points, and Young's modulus from the force."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile

import numpy as np

from palpate.common.files import read_file
from palpate.data.source.layout import InputError
from palpate.data.source.table import reason
from palpate.estimators.estimate import NINETY
from palpate.evaluation.foreign.surface_fit import SurfaceFit, fit_surface
from palpate.physics.fem import Material, NoEquilibrium, Solid, make_solid

MATERIALS = {"linear": Material("linear", 20e3, 0.45), "neohookean": Material("neo_hookean", 4500.0, 0.49)}
"""By the beginning of a file's name. The second is what the data say of themselves; the first is the one at which all
nodes of the three sequences at hand are in balance (ν to 1e-4, E to 4e-4)."""
MESH, HELD = "liver.msh", "dirichlet-vertices.npy"
MOST_BYTES = 2**30
"""Of a file, packed or not."""
NEEDED = ("positions", "true_forces", "force_vertices", "pc")
ANNOUNCED = 6e-4
"""Noise that the data announce [m]; the points at hand lie on the surface to 1e-7 m, so it is added to some frames."""
FORCELESS = 1e-3
"""A frame whose true force is below has none [N]: nothing is relative to it."""
NOISY_EVERY = 10
"""Of how many frames one is fitted again with that noise."""
ROUNDING = {"linear": 5e-6, "neo_hookean": 8e-7}
"""Standard deviation of the true solutions from exact ones, as they show in a fit's force over the force: on points
without noise this is all that is left, and it is the same in neighbouring frames."""


@dataclass(frozen=True, eq=False)
class Pull:
    """A sequence; T frames, N nodes."""

    body: Solid
    """At rest."""
    material: Material
    """Of which it is."""
    held: np.ndarray
    """Which components are prescribed, shape [N, 3], bool."""
    pulled: np.ndarray
    """Nodes on which the tool pulls, shape [G]."""
    motion: np.ndarray
    """Displacement of what is held, zero elsewhere, shape [T, N, 3] [m]."""
    points: list[np.ndarray]
    """Of the surface, one [P, 3] a frame [m]."""
    force: np.ndarray
    """True total force, shape [T, 3] [N]."""


def read_gmsh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [N, 3] and tetrahedra [E, 4] of a text file of Gmsh's format 2.

    Raises:
        InputError: another format, or no tetrahedra.
    """
    try:
        lines = read_file(path, MOST_BYTES).decode("ascii").splitlines()
        parts = {}
        for name in ("Nodes", "Elements"):
            begin = lines.index(f"${name}") + 2
            parts[name] = [line.split() for line in lines[begin : begin + int(lines[begin - 1])]]
        nodes = np.array([row[1:4] for row in parts["Nodes"]], np.float64)
        order = {int(row[0]): index for index, row in enumerate(parts["Nodes"])}
        cells = [[order[int(node)] for node in row[-4:]] for row in parts["Elements"] if row[1] == "4"]
    except (OSError, ValueError, IndexError, KeyError) as error:
        why = reason(error) if isinstance(error, (OSError, UnicodeError)) else "its sections are not as announced"
        raise InputError(f"{path.name} is no text mesh of Gmsh's format 2 ({why}); export it as that.") from error
    if not cells:
        raise InputError(f"{path.name} holds no tetrahedra; mesh the volume.")
    return nodes, np.array(cells)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an NPZ file that unpacks to no more than MOST_BYTES, by name."""
    content = io.BytesIO(read_file(path, MOST_BYTES))
    with ZipFile(content) as file:
        if sum(entry.file_size for entry in file.infolist()) > MOST_BYTES:
            raise ValueError(f"it unpacks to more than {MOST_BYTES / 2**20:.0f} MB")
    content.seek(0)
    with np.load(content, allow_pickle=False) as stored:
        return dict(stored)


def read_pull(path: Path) -> Pull:
    """A sequence, with the mesh and the held vertices in the same folder.

    Raises:
        InputError: a file that is missing or doesn't fit.
    """
    law = next((name for name in MATERIALS if path.name.startswith(name)), None)
    if law is None:
        raise InputError(f"{path.name}: the name tells no law; begin it with {' or '.join(MATERIALS)}.")
    for name in (MESH, HELD):
        if not (path.parent / name).is_file():
            raise InputError(f"{path.name} has no {name} beside it; put it there.")
    try:
        data = _arrays(path)
        vertices = np.load(io.BytesIO(read_file(path.parent / HELD, MOST_BYTES)), allow_pickle=False)
    except Exception as error:  # by where a file is damaged, readers of zip files, headers or arrays give up
        raise InputError(f"{path.name} or {HELD} can't be read ({reason(error)}); copy it anew.") from error
    missing = [name for name in NEEDED if name not in data]
    if missing:
        raise InputError(f"{path.name} lacks {', '.join(missing)}; it is no sequence of the liver.")
    nodes, tetrahedra = read_gmsh(path.parent / MESH)
    for name, values in {**{name: data[name] for name in NEEDED}, HELD: vertices}.items():
        if values.dtype.kind not in "iuf" or not (values.ndim and values.size) or not np.isfinite(values).all():
            raise InputError(f"{path.name}: {name} holds something else than finite numbers; copy it anew.")
    # Where the tool holds; `force_vertices` is a margin around it, without force.
    pulled = data.get("tool_vertices", data["force_vertices"])
    for name, values in {"tool_vertices": pulled, HELD: vertices}.items():
        if values.ndim != 1 or values.dtype.kind not in "iuf" or not np.isin(values, np.arange(len(nodes))).all():
            raise InputError(f"{path.name}: {name} are no numbers of the {len(nodes)} nodes of {MESH}; copy it anew.")
    if data["pc"].ndim != 2 or data["pc"].shape[1] != 4:
        raise InputError(f"{path.name}: pc has shape {data['pc'].shape}; give a frame's number and a place a row.")
    frames = len(data["positions"])
    if data["positions"].shape != (frames, *nodes.shape) or data["true_forces"].shape != (frames, 3):
        raise InputError(f"{path.name}: {data['positions'].shape} places don't fit {len(nodes)} nodes of {MESH}.")
    held = np.zeros(nodes.shape, bool)
    held[vertices.astype(np.int64)] = True
    points = [data["pc"][data["pc"][:, 0] == frame, 1:].astype(np.float64) for frame in range(frames)]
    motion = np.where(held, data["positions"].astype(np.float64) - nodes, 0.0)
    return Pull(
        make_solid(nodes, tetrahedra),
        MATERIALS[law],
        held,
        pulled.astype(np.int64),
        motion,
        points,
        data["true_forces"],
    )


@dataclass(frozen=True)
class Answer:
    """One frame's answers compared with the truth."""

    size: float
    """Of the true force [N]."""
    force_off: float
    """Distance of the fitted force from it, over its size."""
    force_held: bool
    """Whether the 90 % interval of its size holds that."""
    young: float
    """Young's modulus from the force [Pa]."""
    young_held: bool
    """Whether its 90 % interval holds the true one."""
    width: float
    """Half the interval of the size, over the size."""
    noise: float
    """That the fit finds in the points [m]."""


def answer(fit: SurfaceFit, material: Material, force: np.ndarray) -> Answer:
    """What a fit says: the force if the material is known, and Young's modulus if the force is, which is not zero."""
    true = float(np.linalg.norm(force))
    floor = ROUNDING[material.law]
    (size, wide), (along, narrow) = fit.magnitude, fit.along(force)
    wide, narrow = float(np.hypot(wide, floor * size)), float(np.hypot(narrow, floor * along))
    # What is observed depends on F/E alone: E is to the assumed one as the known force to the fitted.
    young = float(np.mean(material.young)) * true / along
    return Answer(
        true,
        float(np.linalg.norm(fit.force - force)) / true,
        abs(size - true) <= NINETY * wide,
        young,
        abs(np.log(along / true)) <= NINETY * narrow / along,
        NINETY * wide / size,
        fit.noise,
    )


def judge_pull(path: Path, frames: int | None = None) -> dict[str, object]:
    """Measures of a sequence; frames without force are counted, and only the force that is found there is given.

    Args:
        path: its file.
        frames: how many of its first; None = all.

    Raises:
        InputError: a file that can't be read.
    """
    pull = read_pull(path)
    generator = np.random.default_rng(17)
    clean: list[Answer] = []
    noisy: list[Answer] = []
    idle: list[float] = []
    fit, lost = None, 0
    for index, points in enumerate(pull.points[:frames]):
        try:
            fit = fit_surface(pull.body, pull.material, pull.held, pull.motion[index], pull.pulled, points, fit)
        except NoEquilibrium:
            fit, lost = None, lost + 1
            continue
        if np.linalg.norm(pull.force[index]) < FORCELESS:
            idle.append(float(np.linalg.norm(fit.force)))
            continue
        clean.append(answer(fit, pull.material, pull.force[index]))
        if index % NOISY_EVERY == 0 and fit.noise < ANNOUNCED / 10:
            blurred = points + ANNOUNCED * generator.normal(size=points.shape)
            again = fit_surface(pull.body, pull.material, pull.held, pull.motion[index], pull.pulled, blurred, fit)
            noisy.append(answer(again, pull.material, pull.force[index]))
    measures: dict[str, object] = {"law": pull.material.law, "frames": len(clean), "frames without a fit": lost}
    measures["frames without force"] = len(idle)
    if idle:
        measures["force found in frames without, largest (N)"] = max(idle)
    measures |= _measures(clean, pull.material, "")
    if noisy:
        measures |= _measures(noisy, pull.material, f" with {1e3 * ANNOUNCED:g} mm of noise added")
    return measures


def _measures(answers: list[Answer], material: Material, suffix: str) -> dict[str, object]:
    if not answers:
        return {}
    strong = [one for one in answers if one.size > 1] or answers
    young, true = float(np.median([one.young for one in answers])), float(np.mean(material.young))
    found = {
        "force error, median where above 1 N": float(np.median([one.force_off for one in strong])),
        "force error, largest": max(one.force_off for one in answers),
        "force: share of frames in the 90 % interval": float(np.mean([one.force_held for one in answers])),
        "force: half the interval / force, median": float(np.median([one.width for one in answers])),
        "E (Pa), median": young,
        "E error, median": young / true - 1,
        "E: share of frames in the 90 % interval": float(np.mean([one.young_held for one in answers])),
        "noise found (m), median": float(np.median([one.noise for one in answers])),
    }
    return {name + suffix: value for name, value in found.items()}
