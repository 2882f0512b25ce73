"""Exported deformations: meshio reads the values back, SOFA's loader finds types that it knows."""

import dataclasses
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest

from palpate.estimators.direct.estimator import fitted_press
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.online.particle_field import StiffnessMap
from palpate.estimators.online.session import Method
from palpate.estimators.online.surface import make_surface
from palpate.estimators.result import values_of
from palpate.physics.identifiability import NINETY
from palpate.physics.mechanics import PARAMETERS
from palpate.results.artefacts.export import deformation_of, write_series
from tests.estimators.estimates import CONTACT, GOOD, MECHANICS, NONE, THETA
from tests.estimators.online.test_driven import CAMERA, GEOMETRY, driven, first_frame
from tests.physics.sheets import whole_field
from tests.results.fields import PULL

RUN = dataclasses.replace(GOOD, mechanics=MECHANICS)
SOFA_TYPES = {"Int32", "Float64"}


def test_a_press_moves_as_simulated_and_holds_its_estimate(tmp_path):
    times = np.array([0.0, 0.04, 0.08])
    found = deformation_of(RUN, times)
    write_series(tmp_path, "scene_4", found)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["scene_4.ply", "scene_4.pvd", "scene_4_0000.vtu", "scene_4_0001.vtu", "scene_4_0002.vtu"]
    load = fitted_press(CONTACT, RUN.estimate, MECHANICS.time_step, MECHANICS.steps)
    simulated = whole_field(THETA, CONTACT.mesh, load, MECHANICS, dtype=np.float64)
    read = meshio.read(tmp_path / "scene_4_0002.vtu")
    np.testing.assert_allclose(read.points, CONTACT.mesh.vertices, atol=1e-9)
    np.testing.assert_array_equal(read.cells_dict["triangle"], CONTACT.mesh.triangles)
    last = simulated[round(0.08 / MECHANICS.time_step) - 1]
    np.testing.assert_allclose(read.point_data["displacement"], last, rtol=1e-9, atol=1e-12)
    assert not meshio.read(tmp_path / "scene_4_0000.vtu").point_data["displacement"].any()
    numbers = values_of(RUN.estimate.numbers)
    for name in PARAMETERS:
        said = [numbers[f"{name}{end}"] for end in ("", "_low", "_high")]
        np.testing.assert_allclose(np.ravel(read.field_data[name]), said)
    assert np.ravel(read.field_data["TimeValue"]) == pytest.approx(0.08)
    ply = meshio.read(tmp_path / "scene_4.ply")
    np.testing.assert_allclose(ply.points, CONTACT.mesh.vertices)
    sets = ElementTree.parse(tmp_path / "scene_4.pvd").findall("Collection/DataSet")
    assert [(float(each.attrib["timestep"]), each.attrib["file"]) for each in sets] == list(
        zip(times.tolist(), names[2:], strict=True)
    )


def test_arrays_are_text_that_sofa_reads(tmp_path):
    write_series(tmp_path, "scene_4", deformation_of(RUN, np.zeros(1)))
    assert (tmp_path / "scene_4_0000.vtu").read_text().startswith("<VTKFile")
    root = ElementTree.parse(tmp_path / "scene_4_0000.vtu").getroot()
    arrays = {each.attrib["Name"]: each for each in root.iter("DataArray")}
    assert {each.attrib["format"] for each in arrays.values()} == {"ascii"}
    assert {arrays[name].attrib["type"] for name in ("Points", "connectivity", "offsets", "displacement")} <= SOFA_TYPES


@pytest.mark.parametrize("thickness", [None, 0.15])
def test_a_field_has_a_stiffness_at_every_particle(thickness, tmp_path):
    surface = make_surface(first_frame(), CAMERA, GEOMETRY, 150, thickness)
    tissue = driven(surface, np.linspace(0.1, 1, 10), method=Method("PBD"))  # one field from the beginning on
    body, count = surface.body, len(surface.body.rest)
    last = dataclasses.replace(
        PULL.last, faces=body.faces, tetrahedra=body.tetrahedra,
        distance=StiffnessMap(body.rest[:, 0], np.full(count, 0.2), np.ones(count, bool)),
        shape=StiffnessMap(body.rest[:, 0], np.full(count, np.inf), np.zeros(count, bool)),
    )  # fmt: skip
    times = 0.04 * np.arange(len(tissue.past) + 1)
    found = deformation_of(
        dataclasses.replace(NONE, field=dataclasses.replace(PULL, last=last, driven=tissue, times=times)), np.zeros(1)
    )
    np.testing.assert_allclose(found.displacement[-1], tissue.session.positions - body.rest, atol=1e-12)
    write_series(tmp_path, "scene_4", found)
    read = meshio.read(tmp_path / "scene_4_0009.vtu")
    stiffness = tissue.session.fields.distance[:, None] * np.exp(0.2 * NINETY * np.array([0, -1, 1]))
    np.testing.assert_allclose(read.point_data["stiffness"], stiffness, rtol=1e-9)
    np.testing.assert_array_equal(read.point_data["shape_stiffness_known"], np.zeros(count))
    assert ("tetra" in read.cells_dict) == (thickness is not None)


def test_what_is_not_determined_is_not_exported():
    with pytest.raises(NoEstimate, match="not all determined"):
        deformation_of(NONE, np.zeros(1))
    unexplained = dataclasses.replace(PULL, last=dataclasses.replace(PULL.last, skill=0.0))
    with pytest.raises(NoEstimate, match="does not explain"):
        deformation_of(dataclasses.replace(NONE, field=unexplained), np.zeros(1))
