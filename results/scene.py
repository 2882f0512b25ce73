"""A press as a scene to simulate further: written for VTK, SOFA and USD, and read again.

Every file says all that `simulate` needs, and the ends of the 90 % intervals. VTK and USD hold the PARTS by name. A
SOFA scene is made of SOFA's own components, and runs there with the same steps: explicit damping of a mass Δt/kick,
`kick` being that of `physics.msd.reference.Integrator`, is the implicit (or exact) damping of the mass m. What SOFA has
no field for stands in attributes that begin with an underscore, which its loader skips.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from palpate.common.files import read_file
from palpate.estimators.direct.estimator import fitted_press
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.records import InteractionEstimate
from palpate.physics.load import Press
from palpate.physics.mechanics import PARAMETERS, SCHEMES, Mechanics
from palpate.physics.mesh import Mesh
from palpate.physics.msd.reference import free_vertices, integrator
from palpate.results.columns import UNITS

FORMATS = {"usd": "usda", "sofa": "scn", "vtk": "vtp"}
"""Formats with the endings of their files."""
Parts = dict[str, np.ndarray]
"""What a file holds, by the names of PARTS."""


class Part(NamedTuple):
    """One array of a file."""

    place: str
    """Element of a VTK file."""
    width: int
    """Numbers a row."""
    type: str
    """Of the numbers, as numpy calls it."""
    unit: str
    """Unit, or what the numbers are."""


SPREAD = "; value, then both ends of the 90 % interval"
PARTS = {
    "points": Part("Points", 3, "float32", "scene units: depth divided by the clip's scale; x right, y down, z away"),
    "springs": Part("Lines", 2, "int32", "vertices"),
    "triangles": Part("Polys", 3, "int32", "vertices"),
    "held": Part("PointData", 1, "int32", "1: does not move"),
    "pixels": Part("PointData", 2, "int32", "row and column of the depth grid"),
    "load": Part("PointData", 3, "float64", f"{UNITS['force']}; where the load's factor is 1"),
    "grid_shape": Part("FieldData", 2, "int32", "rows and columns of the depth grid"),
    "load_vertices": Part("FieldData", 1, "int32", "vertices, the contact first"),
    "load_weights": Part("FieldData", 1, "float64", "share of the force on each"),
    "load_direction": Part("FieldData", 3, "float64", "unit vector along which a positive force acts"),
    "load_factor": Part("FieldData", 1, "float64", "share of the force in each time step"),
    **{name: Part("FieldData", 3, "float64", UNITS[name] + SPREAD) for name in PARAMETERS},
    "mass": Part("FieldData", 1, "float64", "of every vertex, by convention"),
    "time_step": Part("FieldData", 1, "float64", "s"),
    "scheme": Part("FieldData", 1, "int32", " or ".join(f"{at}: {name}" for at, name in enumerate(SCHEMES))),
}
"""All that VTK and USD files hold."""


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
        return cls(contact.mesh, press, mechanics, found.theta, np.sort(np.sign(found.theta)[:, None] * ends))


def write_scene(path: Path, scene: Scene) -> None:
    """Write a scene in the format that the file's ending names, one of FORMATS.

    Raises:
        OSError: the file can't be written.
    """
    mesh, press, mechanics = scene.mesh, scene.press, scene.mechanics
    load = np.zeros(mesh.vertices.shape)
    np.add.at(load, press.vertices, scene.theta[2] * np.outer(press.weights, press.direction))
    parts = {
        "points": mesh.vertices,
        "springs": mesh.springs,
        "triangles": mesh.triangles,
        "held": ~free_vertices(mesh, press),
        "pixels": mesh.pixels,
        "load": load,
        "grid_shape": mesh.grid_shape,
        "load_vertices": press.vertices,
        "load_weights": press.weights,
        "load_direction": press.direction,
        "load_factor": press.factor,
        **dict(zip(PARAMETERS, np.column_stack([scene.theta, scene.interval]), strict=True)),
        "mass": mechanics.mass,
        "time_step": mechanics.time_step,
        "scheme": SCHEMES.index(mechanics.scheme),
    }
    rows = {name: np.asarray(parts[name], part.type).reshape(-1, part.width) for name, part in PARTS.items()}
    path.write_text(_KINDS[path.suffix][0](rows), encoding="utf-8")


def read_scene(path: Path) -> Scene:
    """A scene that `write_scene` wrote; vertices that were pressed count as not held.

    Raises:
        ValueError: the file can't be read, or another program wrote it.
    """
    try:
        parts = _KINDS[path.suffix][1](read_file(path).decode())
        sheet = (parts[name] for name in ("points", "triangles", "springs"))
        mesh = Mesh(*sheet, parts["held"].ravel() > 0, parts["pixels"], tuple(parts["grid_shape"][0].tolist()))
        vertices, factor = parts["load_vertices"].ravel().astype(np.int64), parts["load_factor"].ravel()
        press = Press(vertices, parts["load_weights"].ravel(), parts["load_direction"].ravel(), factor)
        mass, time_step = parts["mass"].item(), parts["time_step"].item()
        scheme = SCHEMES[parts["scheme"].item()]
        mechanics = Mechanics(mass, time_step, len(factor), int(np.count_nonzero(factor)), scheme)
        spread = np.concatenate([parts[name] for name in PARAMETERS])
    except (KeyError, IndexError, AttributeError, TypeError, ValueError, ElementTree.ParseError) as error:
        raise ValueError(
            f"{path}: is no scene that palpate wrote ({type(error).__name__}: {error}); give one of `palpate infer "
            "--export`."
        ) from error
    return Scene(mesh, press, mechanics, spread[:, 0], spread[:, 1:])


def _text(values: object) -> str:
    """Numbers in a row, each with as many digits as tell it from all others."""
    return " ".join(np.asarray(values).ravel().astype(str))


def _numbers(text: str | None, name: str) -> np.ndarray:
    if text is None:
        raise KeyError(name)
    return np.array(text.split(), PARTS[name].type).reshape(-1, PARTS[name].width)


def _xml(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True)


def _to_vtk(parts: Parts) -> str:
    root = ElementTree.Element("VTKFile", type="PolyData", version="1.0", byte_order="LittleEndian")
    sheet = ElementTree.SubElement(root, "PolyData")
    field = ElementTree.SubElement(sheet, "FieldData")
    counted = {"Points": "points", "Lines": "springs", "Polys": "triangles"}
    counts = {f"NumberOf{kind}": str(len(parts[name])) for kind, name in counted.items()}
    piece = ElementTree.SubElement(sheet, "Piece", counts, NumberOfVerts="0", NumberOfStrips="0")
    places = {name: ElementTree.SubElement(piece, name) for name in ("PointData", *counted)} | {"FieldData": field}
    for name, (place, width, kind, unit) in PARTS.items():
        cells = place in ("Lines", "Polys")
        about = {"Name": "connectivity" if cells else name, "type": kind.capitalize(), "format": "ascii"}
        about |= {} if cells else {"NumberOfComponents": str(width)}
        about |= {"NumberOfTuples": str(len(parts[name]))} if place == "FieldData" else {}
        array = ElementTree.SubElement(places[place], "DataArray", about)
        array.text = _text(parts[name])
        ElementTree.SubElement(array, "InformationKey", name="UNITS_LABEL", location="vtkDataArray").text = unit
        if cells:
            ends = ElementTree.SubElement(places[place], "DataArray", about | {"Name": "offsets"})
            ends.text = _text(width * np.arange(1, len(parts[name]) + 1))
    return _xml(root)


def _from_vtk(text: str) -> Parts:
    root, cells = ElementTree.fromstring(text), {"springs": "Lines", "triangles": "Polys"}
    named = {
        name: f"{cells[name]}/*[@Name='connectivity']" if name in cells else f"*[@Name='{name}']" for name in PARTS
    }
    return {name: _numbers(root.findtext(f".//{path}"), name) for name, path in named.items()}


def _to_sofa(parts: Parts) -> str:
    stiffness, damping, _ = (parts[name][0, 0] for name in PARAMETERS)
    time_step, points, factor = parts["time_step"].item(), parts["points"].astype(np.float64), parts["load_factor"]
    mechanics = Mechanics(parts["mass"].item(), time_step, scheme=SCHEMES[parts["scheme"].item()])
    root = ElementTree.Element("Node", name="root", dt=str(time_step), gravity="0 0 0")
    plugins = "Mass MechanicalLoad ODESolver.Forward SceneUtility SolidMechanics.Spring StateContainer"
    for plugin in f"Constraint.Projective {plugins} Topology.Container.Dynamic".split():
        ElementTree.SubElement(root, "RequiredPlugin", name=f"Sofa.Component.{plugin}")
    ElementTree.SubElement(root, "DefaultAnimationLoop")
    hidden = {f"_{name}": _text(parts[name]) for name in _HIDDEN}
    hidden |= {f"_{name}_unit": part.unit for name, part in PARTS.items()}
    ElementTree.SubElement(root, "InfoComponent", hidden, name="palpate")
    tissue = ElementTree.SubElement(root, "Node", name="tissue")

    def add(kind: str, **values: object) -> None:
        texts = {name: value if isinstance(value, str) else _text(value) for name, value in values.items()}
        ElementTree.SubElement(tissue, kind, texts)

    add("EulerExplicitSolver", symplectic="1")
    add("TriangleSetTopologyContainer", name="sheet", position=points, triangles=parts["triangles"])
    add("MechanicalObject", template="Vec3d", position="@sheet.position")
    add("UniformMass", vertexMass=time_step / integrator(damping, mechanics).kick)
    lengths = np.linalg.norm(np.diff(points[parts["springs"]], axis=1)[:, 0], axis=1)
    springs = zip(parts["springs"].tolist(), lengths.tolist(), strict=True)
    add("SpringForceField", spring=" ".join(f"{a} {b} {stiffness} 0 {length}" for (a, b), length in springs))
    add("UniformVelocityDampingForceField", dampingCoefficient=damping)
    if parts["held"].any():  # of none, SOFA holds the first one
        add("FixedProjectiveConstraint", indices=np.flatnonzero(parts["held"]))
    # Between keys SOFA goes straight; a step takes the force of its beginning.
    keys = np.flatnonzero(np.diff(factor[:, 0], 2, prepend=np.nan, append=np.nan) != 0)
    for vertex, weight in zip(parts["load_vertices"], parts["load_weights"], strict=True):
        force = parts["force"][0, 0] * weight * parts["load_direction"]
        add("LinearForceField", points=vertex, times=time_step * keys, forces=factor[keys] * force)
    return _xml(root)


_HIDDEN = (*PARAMETERS, "pixels", "grid_shape", "mass", "scheme", "load_direction")
"""Parts for which SOFA has no field, or with numbers for which it has none."""


def _from_sofa(text: str) -> Parts:
    root = ElementTree.fromstring(text)
    found = {element.tag: element.attrib for element in root.iter()}
    parts = {name: _numbers(found["InfoComponent"][f"_{name}"], name) for name in _HIDDEN}
    sheet = found["TriangleSetTopologyContainer"]
    parts |= {"points": _numbers(sheet["position"], "points"), "triangles": _numbers(sheet["triangles"], "triangles")}
    springs = np.array(found["SpringForceField"]["spring"].split(), np.float64).reshape(-1, 5)
    parts["springs"] = springs[:, :2].astype(np.int32)
    parts["stiffness"][0, 0] = springs[0, 2]
    parts["damping"][0, 0] = float(found["UniformVelocityDampingForceField"]["dampingCoefficient"])
    parts["held"] = np.zeros(len(parts["points"]), np.int32)
    parts["held"][np.array(found.get("FixedProjectiveConstraint", {"indices": ""})["indices"].split(), int)] = 1
    loads = [element.attrib for element in root.iter("LinearForceField")]
    forces = np.array([load["forces"].split() for load in loads], np.float64).reshape(len(loads), -1, 3)
    along = forces @ parts["load_direction"][0] / parts["force"][0, 0]
    times, time_step = np.array(loads[0]["times"].split(), np.float64), float(root.attrib["dt"])
    steps = np.arange(round(times[-1] / time_step) + 1)
    parts["load_vertices"] = np.array([load["points"] for load in loads], np.int32)
    parts["load_weights"] = along.sum(axis=1) / along.sum()
    parts["load_factor"] = np.interp(steps, times / time_step, along.sum(axis=0))
    return parts | {"time_step": np.array(time_step)}


_USD_NAMES = {"points": "points", "triangles": "faceVertexIndices"}
"""Parts that USD itself has a name for."""


def _to_usd(parts: Parts) -> str:
    points, lines = parts["points"], []
    for name, (place, width, kind, unit) in PARTS.items():
        about = f'customData = {{ string unit = "{unit}" }}'
        own = f"palpate:{name}"
        if place == "PointData":
            own, about = f"primvars:{own}", f'{about}; interpolation = "vertex"; elementSize = {width}'
        typed = "point3f" if name == "points" else "int" if kind == "int32" else "double"
        values = _tuples(parts[name]) if name == "points" else _text(parts[name]).replace(" ", ", ")
        lines.append(f"    {typed}[] {_USD_NAMES.get(name, own)} = [{values}] ({about})")
    # No metersPerUnit: nobody knows how long a scene unit is.
    return f"""#usda 1.0
(
    defaultPrim = "Tissue"
)

def Mesh "Tissue"
{{
    int[] faceVertexCounts = [{", ".join(["3"] * len(parts["triangles"]))}]
    uniform token subdivisionScheme = "none"
    float3[] extent = [{_tuples(np.array([points.min(axis=0), points.max(axis=0)]))}]
{chr(10).join(lines)}
}}
"""


def _tuples(points: np.ndarray) -> str:
    return ", ".join(f"({', '.join(point)})" for point in points.astype(str))


def _from_usd(text: str) -> Parts:
    found = re.findall(r"^ *\w+\[\] ([\w:]+) = \[([^\]]*)\]", text, re.MULTILINE)
    texts = {name.rpartition(":")[2]: re.sub("[(),]", " ", values) for name, values in found}
    return {name: _numbers(texts[_USD_NAMES.get(name, name)], name) for name in PARTS}


_KINDS: dict[str, tuple[Callable[[Parts], str], Callable[[str], Parts]]] = {
    ".usda": (_to_usd, _from_usd),
    ".scn": (_to_sofa, _from_sofa),
    ".vtp": (_to_vtk, _from_vtk),
}
"""What writes and reads a file, by its ending."""
