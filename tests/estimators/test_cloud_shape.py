"""Surfaces of clouds: heights, what is covered, and the same view in whatever frame a cloud comes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palpate.data.source.layout import InputError
from palpate.data.source.sequence import moved
from palpate.estimators.cloud_shape import CloudShape, view_across

SIDES = np.array([0.05, 0.03])


def slope(count: int = 4000) -> np.ndarray:
    plane = np.random.default_rng(3).uniform(0, SIDES, (count, 2))
    return np.column_stack([plane, 0.1 * plane[:, 0] - 0.2 * plane[:, 1] + 0.3])


def test_heights_of_a_slope_come_back_where_the_cloud_covers() -> None:
    inner = np.random.default_rng(4).uniform(0.005, SIDES - 0.005, (200, 2))
    heights, covered = CloudShape(slope(), "cloud").heights(inner)
    assert covered.all()
    np.testing.assert_allclose(heights, inner @ [0.1, -0.2] + 0.3, atol=1.5e-4)
    assert not CloudShape(slope(), "cloud").heights(np.array([[-0.01, 0.01], [0.06, 0.01]]))[1].any()


def test_a_mesh_spans_the_cloud() -> None:
    shape = CloudShape(slope(), "cloud")
    mesh = shape.mesh(0.002)
    np.testing.assert_allclose(np.ptp(mesh.vertices[:, :2], axis=0), SIDES, atol=0.002)
    assert shape.area == pytest.approx(SIDES.prod(), rel=0.15)
    assert mesh.grid_shape == (16, 26)


@pytest.mark.parametrize("cloud", [slope(10), np.vstack([slope(), [[9.0, 9.0, 0.3]]])])
def test_too_few_points_or_some_far_off_are_refused(cloud: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"cloud has too few points for a surface, or some far off"):
        CloudShape(cloud, "cloud").mesh(0.002)


def test_the_view_does_not_depend_on_the_frame() -> None:
    cloud, eye, tip = slope(), np.array([0.02, 0.01, 0.0]), np.array([0.05, 0.015, 0.3])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler("xyz", (40, -25, 110), degrees=True).as_matrix(), [0.4, -0.1, 0.2]
    here = moved(cloud, view_across(cloud, eye, tip))
    there = moved(moved(cloud, pose), view_across(*(moved(each, pose) for each in (cloud, eye, tip))))
    np.testing.assert_allclose(here, there, atol=1e-9)
    assert np.ptp(here[:, 2]) < 1e-9
