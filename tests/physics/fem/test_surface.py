"""Closest places of triangles, by brute force."""

import itertools

import numpy as np

from palpate.physics.fem.surface import closest, nearest


def test_the_closest_place_of_a_triangle_is_the_closest() -> None:
    generator = np.random.default_rng(0)
    points, triangles = generator.normal(size=(40, 3)), generator.normal(size=(40, 3, 3))
    found = closest(points, triangles)
    assert (found > -1e-12).all()
    np.testing.assert_allclose(found.sum(axis=1), 1)
    fine = np.array([[i, j, 60 - i - j] for i, j in itertools.product(range(61), repeat=2) if i + j <= 60]) / 60
    others = np.linalg.norm(np.einsum("sk,pkx->psx", fine, triangles) - points[:, None], axis=2).min(axis=1)
    own = np.linalg.norm(np.einsum("pk,pkx->px", found, triangles) - points, axis=1)
    assert (own <= others + 1e-12).all()
    np.testing.assert_allclose(own, others, atol=0.05)


def test_the_nearest_of_triangles_of_many_sizes_is_found() -> None:
    generator = np.random.default_rng(1)
    triangles = generator.uniform(-1, 1, (30, 1, 3)) + generator.uniform(0.05, 0.8, (30, 1, 1)) * generator.normal(
        size=(30, 3, 3)
    )
    points = generator.uniform(-1, 1, (50, 3))
    face, share = nearest(points, triangles, samples=12)
    found = np.linalg.norm(np.einsum("pk,pkx->px", share, triangles[face]) - points, axis=1)
    all_shares = closest(points[:, None], np.broadcast_to(triangles, (50, 30, 3, 3)))
    places = np.einsum("pfk,fkx->pfx", all_shares, triangles)
    np.testing.assert_allclose(found, np.linalg.norm(places - points[:, None], axis=2).min(axis=1), atol=1e-12)
