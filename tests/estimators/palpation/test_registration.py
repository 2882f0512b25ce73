"""A cloud finds its way back to its surface; views of a body become one surface, whose poses and volume are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.palpation.synthetic import sphere
from palpate.data.source.sequence import moved
from palpate.estimators.palpation.registration import View, join_views, register
from palpate.physics.fem import make_solid, mesh_surface

RADII = np.array([0.05, 0.04, 0.045])
"""Of an ellipsoid with a bump, which no turn maps onto itself [m]."""


def body() -> tuple[np.ndarray, np.ndarray]:
    vertices, triangles = sphere(4)
    bump = 1 + 0.15 * np.exp(-np.square(vertices - [0.6, 0.5, 0.62]).sum(axis=1) / 0.1)
    return vertices * bump[:, None] * RADII, triangles


def pose_of(turn: Rotation, shift) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.as_matrix(), shift
    return pose


def seen_from(
    direction: np.ndarray, shift: np.ndarray, turn: np.ndarray, noise: float, seed: int
) -> tuple[View, np.ndarray]:
    """What faces a sensor, in its frame, with a believed pose that is off; and its true pose."""
    chance = np.random.default_rng(seed)
    vertices, triangles = body()
    direction = direction / np.linalg.norm(direction)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = triangles[normals @ direction > 0.2 * np.linalg.norm(normals, axis=1)]
    used, which = np.unique(facing, return_inverse=True)
    true = pose_of(Rotation.align_vectors([-direction], [[0, 0, 1.0]])[0], 0.3 * direction)
    points = vertices[used] + chance.normal(0, noise, len(used))[:, None] * direction
    change = pose_of(Rotation.from_rotvec(turn), shift)
    # In either order: a sensor doesn't know how triangles are turned.
    return View((points - true[:3, 3]) @ true[:3, :3], which.reshape(-1, 3)[:, ::-1], change @ true), true


WAYS = np.array([[1, 0, 0.4], [0.2, 1, 0.4], [-1, 0.1, 0.4], [0, -1, 0.4], [0, 0, 1], [0.3, 0.2, -1.0]])


def views(noise: float) -> tuple[list[View], list[np.ndarray]]:
    chance, given, true = np.random.default_rng(1), [], []
    for number, way in enumerate(WAYS):
        shift, turn = (chance.normal(0, size if number else 0, 3) for size in (0.002, 0.02))
        view, pose = seen_from(way, shift, turn, noise, number)
        given.append(view)
        true.append(pose)
    return given, true


@pytest.mark.parametrize("noise", [0.0, pytest.param(0.0003, marks=pytest.mark.slow)])
def test_poses_are_found_and_the_surface_encloses_the_body(noise: float) -> None:
    given, true = views(noise)
    surface, poses, apart = join_views(given)
    believed, found = [], []
    for view, pose, right in zip(given, poses, true, strict=True):
        middle = view.vertices.mean(axis=0)[None]
        believed.append(np.linalg.norm(moved(middle, view.pose) - moved(middle, right)))
        found.append(np.linalg.norm(moved(middle, pose) - moved(middle, right)))
    assert max(believed) > 0.002
    # Noise lets views slide on a body that is nearly round.
    assert max(found) < (1e-6 if noise == 0 else 0.002)
    assert apart < 2 * noise + 2e-4
    meshes = [mesh_surface(*each, cells=10) for each in (body(), surface)]
    volumes = [make_solid(each.nodes, each.tetrahedra).volumes.sum() for each in meshes]
    assert volumes[1] == pytest.approx(volumes[0], rel=0.03)


def test_triangles_face_the_sensors_and_each_place_is_kept_once() -> None:
    outwards, areas = [], []
    for vertices, triangles in (body(), join_views(views(0.0)[0])[0]):
        one, two, three = vertices[triangles].transpose(1, 0, 2)
        normals = np.cross(two - one, three - one)
        outwards.append(((normals * (one + two + three)).sum(axis=1) > 0).mean())
        areas.append(np.linalg.norm(normals, axis=1).sum())
    assert outwards[1] > 0.99
    assert areas[1] == pytest.approx(areas[0], rel=0.06)


def test_one_view_stays_as_it_is_and_none_is_refused() -> None:
    given = views(0.0)[0][:1]
    (vertices, _), _, apart = join_views(given)
    np.testing.assert_allclose(vertices, moved(given[0].vertices, given[0].pose), atol=1e-12)
    assert apart == 0
    with pytest.raises(ValueError, match="no view at all"):
        join_views([])


def test_a_pose_is_found_though_a_part_is_dented() -> None:
    vertices, triangles = sphere(3)
    vertices = vertices * [1.0, 0.7, 0.5]
    chance = np.random.default_rng(0)
    points = vertices[triangles].mean(axis=1)
    points = points[points[:, 2] > -0.2]
    points[points[:, 2] > 0.45] -= [0, 0, 0.05]  # pressed in
    true = pose_of(Rotation.from_rotvec([0.3, -0.2, 0.5]), [0.1, 0.2, -0.1])
    off = pose_of(Rotation.from_rotvec([0.05, 0.04, -0.03]), [0.02, -0.02, 0.03])
    seen = moved(points, np.linalg.inv(true)) + chance.normal(0, 1e-4, points.shape)
    found = register(seen, (vertices, triangles), off @ true)
    np.testing.assert_allclose(found, true, atol=2e-3)
