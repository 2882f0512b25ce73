"""A cloud finds its way back to its surface."""

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.palpation.synthetic import sphere
from palpate.data.source.sequence import moved
from palpate.estimators.palpation.registration import register


def pose_of(turn: Rotation, shift) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.as_matrix(), shift
    return pose


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
