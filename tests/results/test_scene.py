"""Scenes: the motion comes back from every format, in our simulator and by SOFA's rules; other files are refused."""

import dataclasses
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from palpate.estimators.estimate import NINETY, NoEstimate
from palpate.estimators.records import InteractionEstimate
from palpate.physics.load import PressShape
from palpate.physics.mechanics import Mechanics
from palpate.results.scene import FORMATS, PARTS, Scene, read_scene, write_scene
from tests.estimators.estimates import CONTACT, COVARIANCE, GOOD, MECHANICS, NONE, THETA
from tests.physics.sheets import whole_field

RUN = dataclasses.replace(GOOD, mechanics=MECHANICS)
SHAPE = PressShape(radius=2.0, offset=(0.3, -0.2), rise=0.02, fall=0.03, lean=(0.2, -0.1))


def shaped(mechanics: Mechanics = MECHANICS) -> InteractionEstimate:
    """A run whose press was fitted with its patch, direction, course and delays."""
    found = dataclasses.replace(GOOD.estimate, shape=SHAPE, delays=(0.004, -0.003), by_light=True)
    return dataclasses.replace(RUN, estimate=found, mechanics=mechanics)


def written(folder: Path, run: InteractionEstimate, kind: str) -> Path:
    path = folder / f"scene_7.{FORMATS[kind]['ending']}"
    write_scene(path, Scene.of(run))
    return path


def moved(scene: Scene) -> np.ndarray:
    return whole_field(scene.theta, scene.mesh, scene.press, scene.mechanics, dtype=np.float64)


@pytest.mark.parametrize("run", [RUN, shaped(), shaped(Mechanics(steps=120))], ids=["step", "patch", "euler"])
@pytest.mark.parametrize("kind", FORMATS)
def test_the_motion_comes_back_from_every_format(kind: str, run: InteractionEstimate, tmp_path: Path) -> None:
    path = written(tmp_path, run, kind)
    given, found = Scene.of(run), read_scene(path)
    assert kind == "usd" or ElementTree.parse(path).getroot().tag in ("Node", "VTKFile")
    expected = moved(given)
    np.testing.assert_allclose(moved(found), expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    assert (found.mechanics.time_step, found.mechanics.scheme) == (run.mechanics.time_step, run.mechanics.scheme)
    np.testing.assert_allclose(found.theta, THETA, rtol=1e-12)
    ends = THETA[:, None] * np.exp(NINETY * np.sqrt(np.diag(COVARIANCE))[:, None] * [[-1, 1], [-1, 1], [1, -1]])
    np.testing.assert_allclose(found.interval, ends, rtol=1e-12)
    np.testing.assert_array_equal(found.mesh.triangles, given.mesh.triangles)
    assert found.by_light == run.estimate.by_light


@pytest.mark.parametrize("mechanics", [Mechanics(steps=120), MECHANICS], ids=["euler", "dkd"])
def test_sofa_s_own_components_move_it_alike(mechanics: Mechanics, tmp_path: Path) -> None:
    """Explicit symplectic Euler, as `EulerExplicitSolver` and the force fields of SOFA's sources have it."""
    run = shaped(mechanics)
    root = ElementTree.parse(written(tmp_path, run, "sofa")).getroot()

    def numbers(tag: str, name: str) -> np.ndarray:
        return np.array([element.get(name).split() for element in root.iter(tag)], float)

    first, second, stiffness, damping, length = numbers("SpringForceField", "spring").reshape(-1, 5).T
    ends, step = np.array([first, second], int), float(root.get("dt"))
    place = rest = numbers("TriangleSetTopologyContainer", "position").reshape(-1, 3)
    (keys, *_), pushed = numbers("LinearForceField", "times"), numbers("LinearForceField", "points")[:, 0].astype(int)
    forces = numbers("LinearForceField", "forces").reshape(len(pushed), len(keys), 3)
    speed, path = np.zeros_like(place), []
    for index in range(mechanics.steps):
        apart = place[ends[1]] - place[ends[0]]
        now = np.linalg.norm(apart, axis=1)
        pull = (stiffness * (now - length) / now)[:, None] * apart
        force = -numbers("UniformVelocityDampingForceField", "dampingCoefficient") * speed
        np.add.at(force, ends, np.array([pull, -pull]))
        for vertex, push in zip(pushed, forces, strict=True):
            force[vertex] += [np.interp(index * step, keys, axis) for axis in push.T]
        force[numbers("FixedProjectiveConstraint", "indices").astype(int)] = 0.0
        speed = speed + step * force / numbers("UniformMass", "vertexMass")
        place = place + step * speed
        path.append(place - rest - (step / 2 * speed if mechanics.scheme == "dkd" else 0.0))
    assert not damping.any()
    expected = moved(Scene.of(run))
    np.testing.assert_allclose(np.array(path), expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_usd_itself_reads_the_scene(tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    stage = pxr.Stage.Open(str(written(tmp_path, shaped(), "usd")))
    prim = stage.GetDefaultPrim()
    np.testing.assert_array_equal(prim.GetAttribute("points").Get(), CONTACT.mesh.vertices)
    stiffness = prim.GetAttribute("palpate:stiffness")
    assert (stiffness.Get()[0], stiffness.GetCustomDataByKey("unit")) == (0.5, PARTS["stiffness"][3])
    assert not stage.HasAuthoredMetadata("metersPerUnit")


@pytest.mark.parametrize("name", ["a.vtp", "a.scn", "a.usda", "a.obj"])
def test_a_file_of_another_program_is_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text('<Node name="root"/>')
    with pytest.raises(ValueError, match=r"a\.\w+: is no scene that palpate wrote .*; give one of `palpate infer --ex"):
        read_scene(tmp_path / name)


LOOSE = dataclasses.replace(GOOD.estimate, covariance=np.eye(3))


@pytest.mark.parametrize("run", [NONE, GOOD, dataclasses.replace(RUN, estimate=LOOSE)])
def test_what_is_not_determined_or_no_sheet_has_no_scene(run: InteractionEstimate) -> None:
    with pytest.raises(NoEstimate, match="not all determined"):
        Scene.of(run)
