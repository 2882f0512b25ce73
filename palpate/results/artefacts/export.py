"""Deformation of a contact as `.vtu` files, one a frame, with a `.pvd` index, and the mesh at rest as `.ply`.

Numbers are text and integers have 32 bits: SOFA's MeshVTKLoader reads no others.
"""

import contextlib
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.estimator import fitted_press
from palpate.estimators.estimate import NoEstimate, PressResult
from palpate.estimators.online.particle_field import FieldResult
from palpate.estimators.records import InteractionEstimate
from palpate.estimators.result import ENDS, Quantity
from palpate.physics.mechanics import PARAMETERS, Mechanics
from palpate.physics.msd.simulation import simulate
from palpate.results.artefacts.base import Artefact


class Export(Artefact):
    """scene_N_K.vtu of every contact N and its frames K."""

    option = "export"

    def open(self) -> None:
        self._missing = 0

    def contact(self, run: InteractionEstimate) -> None:
        times = np.array([frame.time_s for frame in self.clip.estimates[run.onset :]]) - run.onset_time_s
        try:
            write_series(self.clip.partial, f"scene_{run.onset_frame}", deformation_of(run, times))
        except NoEstimate:
            self._missing += 1

    def warnings(self) -> Iterator[str]:
        if self._missing:
            why = "as not all that simulating them takes is known: see verdict in interactions.csv"
            yield f"{self._missing} of {self.clip.counts.total()} runs of contact were not exported, {why}"


@dataclass(frozen=True, eq=False)
class Deformation:
    """Mesh of N vertices that deforms over T frames, with what was estimated of it."""

    points: np.ndarray
    """Vertices at rest, shape [N, 3] [scene units]."""
    triangles: np.ndarray
    """Vertices of the surface's triangles, shape [F, 3]."""
    displacement: np.ndarray
    """Displacement from rest, shape [T, N, 3] [scene units]."""
    times: np.ndarray
    """Times since rest, shape [T] [s]."""
    parameters: Mapping[str, np.ndarray]
    """Quantities of the whole mesh by name; of an estimate its value and both ends of its 90 % interval."""
    fields: Mapping[str, np.ndarray]
    """Quantities of each vertex by name, shape [N] or [N, K]; of an estimate as in `parameters`."""
    tetrahedra: np.ndarray | None = None
    """Vertices of the tetrahedra, shape [E, 4]; None = a sheet."""


def deformation_of(run: InteractionEstimate, times: np.ndarray) -> Deformation:
    """Return the deformation of a contact, simulated by its estimate.

    Args:
        run: the contact.
        times: times of the contact's frames since its onset, shape [T] [s].

    Raises:
        NoEstimate: what the simulation needs is not determined.
    """
    found, contact = run.estimate, run.interaction
    if run.field is not None:
        return _field(run.field)
    if found is None or contact is None or run.mechanics is None or not {*PARAMETERS} <= {*found.determined}:
        raise NoEstimate("Stiffness, damping and force of a sheet of springs are not all determined.")
    return _press(found, contact, run.mechanics, times)


def _press(found: PressResult, contact: Interaction, mechanics: Mechanics, times: np.ndarray) -> Deformation:
    mesh, press = contact.mesh, fitted_press(contact, found, mechanics.time_step, mechanics.steps)
    moved = simulate(found.theta, mesh, press, mechanics, watch=np.arange(len(mesh.vertices)), dtype=np.float64)
    steps = np.rint(times / mechanics.time_step).astype(int)
    inside, numbers = (steps >= 0) & (steps <= len(moved)), found.numbers
    parameters = {name: np.array([getattr(numbers, name).end(side) for side in ENDS.values()]) for name in PARAMETERS}
    parameters |= {"force_direction": np.sign(found.theta[2]) * press.direction}
    moved = np.concatenate([np.zeros_like(moved[:1]), moved])[steps[inside]]
    return Deformation(mesh.vertices, mesh.triangles, moved, times[inside], parameters, {})


def _field(found: FieldResult) -> Deformation:
    if not found.last.explained:
        raise NoEstimate("The simulation of tissue under the instrument alone does not explain the motion.")
    last, session = found.last, found.driven.session
    rest, places = found.driven.surface.body.rest, np.stack(found.driven.past)
    moved = session.objective.stepped(session.fields, rest, places).positions[0, 1:] - rest
    fields: dict[str, np.ndarray] = {}
    for (name, one), values in zip(last.maps.items(), session.fields, strict=False):
        # VTK reads no infinite numbers.
        spread, name = Quantity(np.asarray(values), np.minimum(one.log_sd, 50.0)), name.removeprefix("distance_")
        fields |= {name: np.stack([spread.end(side) for side in ENDS.values()], 1), f"{name}_known": one.known}
    solid = last.tetrahedra if len(last.tetrahedra) else None
    return Deformation(rest, last.faces, moved, found.times[-len(moved) :], {}, fields, solid)


def write_series(folder: Path, name: str, found: Deformation) -> None:
    """Write `name.ply`, `name_K.vtu` for every frame K and their index `name.pvd`."""
    from meshio import Mesh  # takes a quarter of a second

    faces: dict[str, Any] = {"triangle": found.triangles.astype(np.int32)}
    Mesh(found.points, faces).write(folder / f"{name}.ply")
    solid, index = found.tetrahedra, folder / f"{name}.pvd"
    inner: dict[str, Any] = {} if solid is None else {"tetra": solid.astype(np.int32)}
    fields = {key: each.astype(np.int32 if each.dtype == bool else np.float64) for key, each in found.fields.items()}
    mesh = Mesh(found.points.astype(np.float64), faces | inner, {"displacement": np.zeros(found.points.shape)} | fields)
    with contextlib.redirect_stderr(io.StringIO()):  # meshio warns that text is large
        mesh.write(index, "vtu", binary=False)
    tree = ElementTree.parse(index)
    displacement, *_ = tree.iterfind(".//DataArray[@Name='displacement']")
    data = ElementTree.Element("FieldData")  # which meshio doesn't write
    next(tree.iter("UnstructuredGrid")).insert(0, data)
    for key, values in {**found.parameters, "TimeValue": np.zeros(1)}.items():
        shape = {"NumberOfComponents": str(len(values)), "NumberOfTuples": "1", "format": "ascii"}
        ElementTree.SubElement(data, "DataArray", {"type": "Float64", "Name": key} | shape).text = _text(values)
    files = [f"{name}_{frame:04d}.vtu" for frame in range(len(found.times))]
    for file, time, moved in zip(files, found.times, found.displacement, strict=True):
        displacement.text, data[-1].text = _text(moved), _text(time)
        tree.write(folder / file)
    sets = (f'<DataSet timestep="{time}" file="{file}"/>' for time, file in zip(found.times, files, strict=True))
    collection = '<VTKFile type="Collection" version="0.1">\n<Collection>\n{}\n</Collection>\n</VTKFile>\n'
    index.write_text(collection.format("\n".join(sets)), encoding="utf-8")


def _text(values: np.ndarray) -> str:
    return " ".join(map(str, values.ravel().tolist()))
