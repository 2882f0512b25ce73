"""Scenes: each kind's motion comes back from every format; by SOFA's rules it does, too; other files are refused."""

import dataclasses
import functools
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest

from palpate.estimators.direct.estimator import fitted_press
from palpate.estimators.direct.slab_motion import DENSITY, SlabMotion
from palpate.estimators.estimate import NINETY, Estimate, NoEstimate
from palpate.estimators.online.session import Method
from palpate.estimators.online.surface import make_surface
from palpate.estimators.palpation import FitSettings, fit_material
from palpate.estimators.records import InteractionEstimate
from palpate.physics.fem.slab import slab_beneath
from palpate.physics.fem.solid import qualities
from palpate.physics.load import PressShape
from palpate.physics.mechanics import PARAMETERS, Mechanics
from palpate.results.scene.files import read_scene, scene_text
from palpate.results.scene.kinds import palpation_scene, scene_of, simulated
from palpate.results.scene.scene import FORMATS, Scene
from tests.estimators.direct import slabs
from tests.estimators.estimates import CONTACT, COVARIANCE, GOOD, MECHANICS, NONE, THETA
from tests.estimators.online.test_driven import CAMERA, GEOMETRY, driven, first_frame
from tests.estimators.palpation.test_material_fit import BODY, observed
from tests.physics.sheets import whole_field
from tests.results.fields import GRIP, PULL

RUN = dataclasses.replace(GOOD, mechanics=MECHANICS)
SHAPE = PressShape(radius=2.0, offset=(0.3, -0.2), rise=0.02, fall=0.03, lean=(0.2, -0.1))
SIMULATED = [name for name in FORMATS if name != "ply"]


class Known(NamedTuple):
    """A scene, and what the estimator itself moves, at the scene's vertices `at`, in its steps `when`."""

    scene: Scene
    motion: np.ndarray
    at: np.ndarray | slice = slice(None)
    when: np.ndarray | slice = slice(None)

    def off(self, scene: Scene) -> float:
        """How far a scene's motion is off, over the largest."""
        found = simulated(scene)[self.when][:, self.at]
        return float(np.abs(found - self.motion).max() / np.abs(self.motion).max())


def shaped(mechanics: Mechanics = MECHANICS) -> InteractionEstimate:
    """A run whose press was fitted with its patch, direction, course and delays."""
    found = dataclasses.replace(GOOD.estimate, shape=SHAPE, delays=(0.004, -0.003), by_light=True)
    return dataclasses.replace(RUN, estimate=found, mechanics=mechanics)


PRESSES = {"step": RUN, "patch": shaped(), "euler": shaped(Mechanics(steps=120))}


def press(run: InteractionEstimate) -> Known:
    load = fitted_press(CONTACT, run.estimate, run.mechanics.time_step, run.mechanics.steps)
    return Known(scene_of(run), whole_field(THETA, CONTACT.mesh, load, run.mechanics, dtype=np.float64))


@functools.cache
def known(name: str) -> Known:
    return press(PRESSES[name]) if name in PRESSES else globals()[f"_{name}"]()


def _slab() -> Known:
    """At nodes of the surface on its pixels, when frames show them."""
    contact, under = slabs.contact_of(), (slabs.MESH, slabs.VERTEX, slabs.NORMAL, slabs.THICKNESS, (6, 6, 2))
    coarse, fine = (slab_beneath(*under, order=order) for order in (1, 2))
    theta, corners = np.array(slabs.THETA) * (1, 1, 0.3), coarse.top[1:-1, 1:-1]
    columns, rows = np.meshgrid(coarse.columns[1:-1], coarse.rows[1:-1], indexing="ij")
    pixels = np.stack([rows.ravel(), columns.ravel()], axis=1)
    motion = SlabMotion(contact, coarse, pixels, slabs.TIMES, fine=fine, place=(17.4, 15.8))
    found = Estimate(theta, COVARIANCE, misfit=1.0, largest_misfit=1.5, slab=motion)
    run = dataclasses.replace(NONE, interaction=contact, estimate=found)
    when = np.rint(slabs.TIMES / motion.step).astype(int) - 1
    return Known(scene_of(run), motion.at(np.log(np.abs(theta)))[0], corners.ravel(), when)


def _palpation() -> Known:
    found = fit_material(*BODY.skin(4, BODY.size / 20), [observed(1.0)], FitSettings())
    return Known(palpation_scene(found, 0), found.rests[0].displacement[None])


def _field(thickness: float | None = None, name: str = "PBD") -> Known:
    surface = make_surface(first_frame(), CAMERA, GEOMETRY, 150, thickness)
    tissue = driven(surface, np.linspace(0.1, 1, 10), method=Method(name))
    fields, rest, places = tissue.session.fields, surface.body.rest, np.stack(tissue.past)
    last = dataclasses.replace(
        PULL.last, distance_log_sd=np.full(len(rest), 0.2), shape_log_sd=np.full(len(rest), np.inf),
        known=np.ones(len(rest), bool), shape_known=np.zeros(len(rest), bool),
    )  # fmt: skip
    run = dataclasses.replace(NONE, field=dataclasses.replace(PULL, last=last, driven=tissue))
    moved = tissue.session.objective.stepped(fields, rest, places).positions[0, 1:] - rest
    if name == "PBD":  # whose state is the simulation's, under one field from the beginning on
        np.testing.assert_allclose(moved[-1], tissue.session.positions - rest, atol=1e-12)
    return Known(scene_of(run), moved)


def _volume() -> Known:
    return _field(0.15)


def _learnt() -> Known:
    """With stiffness that differs from place to place."""
    return _field(0.15, "PBD-RM-ON")


CASES = [*PRESSES, "slab", "palpation", "field", "volume", "learnt"]


@pytest.mark.parametrize("name", CASES)
def test_the_motion_comes_back_within_a_hundredth(name: str, tmp_path: Path) -> None:
    """From every format that tells all, also where the estimator does not step as the scene's simulator does."""
    given = known(name)
    for format_ in SIMULATED:
        path = tmp_path / f"scene_7.{FORMATS[format_]['ending']}"
        path.write_text(scene_text(given.scene, format_), encoding="utf-8")
        found = read_scene(path)
        assert given.off(found) < (0.01 if name == "palpation" else 1e-5)
        for part, values in given.scene.parts.items():
            np.testing.assert_array_equal(found.parts[part], values)


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("patch", "stiffness"),
        ("slab", "damping"),
        ("palpation", "stiffness"),
        ("learnt", "stiffness"),
    ],
)
def test_other_numbers_move_otherwise(name: str, part: str) -> None:
    scene = known(name).scene
    other = dataclasses.replace(scene, parts=scene.parts | {part: scene.parts[part] / 4})
    assert known(name).off(other) > 0.01


def test_what_is_estimated_has_its_interval() -> None:
    """Ends of 90 %, of what is determined; the rest is said by conventions and flags."""
    half = np.exp(NINETY * np.sqrt(np.diag(COVARIANCE))[:, None] * [[-1, 1], [-1, 1], [1, -1]])
    for name, theta in (("step", THETA), ("slab", np.array(slabs.THETA) * (1, 1 / DENSITY, 0.3))):
        spread = np.concatenate([known(name).scene.parts[each] for each in PARAMETERS])
        np.testing.assert_allclose(spread, theta[:, None] * np.hstack([np.ones((3, 1)), half]), rtol=1e-12)
    learnt, palpation = (known(name).scene.parts for name in ("learnt", "palpation"))
    np.testing.assert_allclose(learnt["stiffness"][:, 2], learnt["stiffness"][:, 0] * np.exp(0.2 * NINETY), rtol=1e-12)
    assert np.ptp(learnt["stiffness"][:, 0]) > 0
    np.testing.assert_array_equal(learnt["known"], np.tile([1, 0], (len(learnt["known"]), 1)))
    assert palpation["stiffness"][0, 1] < 1e4 < palpation["stiffness"][0, 2]
    assert palpation["poisson"][0, 1] < 0.42 < palpation["poisson"][0, 2]


def sofa(name: str) -> ElementTree.Element:
    return ElementTree.fromstring(scene_text(known(name).scene, "sofa").split("\n", 1)[1])


def numbers(root: ElementTree.Element, tag: str, name: str) -> np.ndarray:
    return np.array([element.get(name, "").split() for element in root.iter(tag)], float)


@pytest.mark.parametrize("name", ["euler", "patch"])
def test_sofa_s_own_components_move_a_press_alike(name: str) -> None:
    """Explicit symplectic Euler, as `EulerExplicitSolver` and the force fields of SOFA's sources have it."""
    root, mechanics = sofa(name), PRESSES[name].mechanics
    first, second, stiffness, damping, length = numbers(root, "SpringForceField", "spring").reshape(-1, 5).T
    ends, step = np.array([first, second], int), float(root.get("dt", ""))
    place = rest = numbers(root, "TriangleSetTopologyContainer", "position").reshape(-1, 3)
    (keys, *_), pushed = (numbers(root, "LinearForceField", each) for each in ("times", "points"))
    forces = numbers(root, "LinearForceField", "forces").reshape(len(pushed), len(keys), 3)
    speed, path = np.zeros_like(place), []
    for index in range(mechanics.steps):
        apart = place[ends[1]] - place[ends[0]]
        now = np.linalg.norm(apart, axis=1)
        pull = (stiffness * (now - length) / now)[:, None] * apart
        force = -numbers(root, "UniformVelocityDampingForceField", "dampingCoefficient") * speed
        np.add.at(force, ends, np.array([pull, -pull]))
        for vertex, push in zip(pushed[:, 0].astype(int), forces, strict=True):
            force[vertex] += [np.interp(index * step, keys, axis) for axis in push.T]
        force[numbers(root, "FixedProjectiveConstraint", "indices").astype(int)] = 0.0
        speed = speed + step * force / numbers(root, "UniformMass", "vertexMass")
        place = place + step * speed
        path.append(place - rest - (step / 2 * speed if mechanics.scheme == "dkd" else 0.0))
    assert not damping.any()
    expected = known(name).motion
    np.testing.assert_allclose(np.array(path), expected, rtol=0, atol=1e-5 * np.abs(expected).max())


COMPONENTS = {
    "CGLinearSolver": "iterations tolerance threshold",
    "ConstantForceField": "indices forces",
    "EulerExplicitSolver": "symplectic",
    "FixedProjectiveConstraint": "indices",
    "LinearForceField": "points times forces",
    "LinearMovementProjectiveConstraint": "indices keyTimes movements",
    "MechanicalObject": "template position",
    "MeshMatrixMass": "massDensity",
    "NewmarkImplicitSolver": "rayleighMass rayleighStiffness gamma beta",
    "RestShapeSpringsForceField": "stiffness",
    "SpringForceField": "spring",
    "StaticSolver": "",
    "TetrahedronFEMForceField": "method youngModulus poissonRatio",
    "TetrahedronSetGeometryAlgorithms": "template",
    "TetrahedronSetTopologyContainer": "name position tetrahedra",
    "TriangleSetTopologyContainer": "name position triangles",
    "UniformMass": "vertexMass",
    "UniformVelocityDampingForceField": "dampingCoefficient",
}
"""Of SOFA 24.06 and later, with those of their attributes that scenes give, by its documentation."""


@pytest.mark.parametrize("name", ["patch", "slab", "palpation", "field", "volume"])
def test_sofa_knows_every_component_and_attribute(name: str) -> None:
    root, parts = sofa(name), known(name).scene.parts
    for component in root.findall("Node/*"):
        assert sorted(component.attrib) == sorted(COMPONENTS[component.tag].split())
        for values in component.attrib.values():
            assert "nan" not in values
    if "elements" in parts:
        found = numbers(root, "TetrahedronSetTopologyContainer", "tetrahedra").reshape(-1, 4).astype(int)
        assert qualities(parts["points"], found).min() > 0
        assert numbers(root, "TetrahedronFEMForceField", "youngModulus") == parts["stiffness"][0, 0]


@pytest.mark.parametrize("name", ["patch", "slab", "palpation", "field", "volume"])
def test_usd_and_vtk_themselves_read_the_scene(name: str, tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    vtk = pytest.importorskip("vtk", reason="vtk is not installed")
    parts, files = known(name).scene.parts, {each: tmp_path / f"a.{FORMATS[each]['ending']}" for each in FORMATS}
    for format_, path in files.items():
        path.write_text(scene_text(known(name).scene, format_), encoding="utf-8")
    stage = usd.Stage.Open(str(files["usd"]))
    prim = stage.GetDefaultPrim()
    np.testing.assert_array_equal(prim.GetAttribute("points").Get(), parts["points"])
    assert stage.HasAuthoredMetadata("metersPerUnit") == (name == "palpation")
    assert prim.GetTypeName() == (
        "TetMesh" if {"elements", "tetrahedra"} & {n for n in parts if len(parts[n])} else "Mesh"
    )
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(files["vtk"]))
    reader.Update()
    assert reader.GetOutput().GetNumberOfPoints() == len(parts["points"])


@pytest.mark.parametrize("name", ["patch", "volume"])
def test_ply_has_stiffness_and_its_interval_at_every_vertex(name: str) -> None:
    lines, parts = scene_text(known(name).scene, "ply").splitlines(), known(name).scene.parts
    header = lines[: lines.index("end_header")]
    names = [line.split()[-1] for line in header if line.startswith("property") and "list" not in line]
    rows = np.array([line.split() for line in lines[len(header) + 1 :][: len(parts["points"])]], float)
    np.testing.assert_array_equal(rows[:, :3].astype(np.float32), parts["points"])
    where = names.index("stiffness")
    assert names[where : where + 3] == ["stiffness", "stiffness_low", "stiffness_high"]
    np.testing.assert_allclose(rows[:, where : where + 3] - parts["stiffness"], 0, atol=1e-12)
    assert f"element face {len(parts['triangles'])}" in header
    assert lines[-1].split() == ["3", *parts["triangles"][-1].astype(str)]


@pytest.mark.parametrize("name", ["a.vtu", "a.scn", "a.usda", "a.obj", "a.ply"])
def test_a_file_of_another_program_is_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text('<Node name="root"/>')
    with pytest.raises(ValueError, match=r"a\.\w+: is no scene to simulate on that palpate wrote .*; give one of --"):
        read_scene(tmp_path / name)


LOOSE = dataclasses.replace(GOOD.estimate, covariance=np.eye(3))
NO_FIELD = dataclasses.replace(PULL, last=dataclasses.replace(PULL.last, skill=0.2))


@pytest.mark.parametrize(
    ("run", "why"),
    [
        (NONE, "No sheet"),
        (GOOD, "No sheet"),
        (dataclasses.replace(RUN, estimate=LOOSE), "not all determined"),
        (dataclasses.replace(NONE, grip=GRIP), "attached is not determined"),
        (dataclasses.replace(NONE, field=NO_FIELD), "does not explain"),
    ],
)
def test_what_is_not_determined_has_no_scene(run: InteractionEstimate, why: str) -> None:
    with pytest.raises(NoEstimate, match=why):
        scene_of(run)
