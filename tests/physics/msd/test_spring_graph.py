"""Meshes sorted around the contact."""

from __future__ import annotations

import numpy as np

from physics.msd.spring_graph import spring_graph
from tests.physics.sheets import hand_mesh, sheet

FLOAT = np.dtype(np.float64)


def test_a_chain_is_sorted_by_distance():
    mesh = hand_mesh([[x, 0, 1] for x in range(6)], [[0, 1], [1, 2], [2, 3], [3, 4]])
    graph = spring_graph(mesh, np.array([2]), np.array([4]), 10, FLOAT)
    assert graph.order[0] == 2
    assert set(graph.order[1:3]) == {1, 3}
    assert set(graph.order) == {0, 1, 2, 3, 4}  # 5 hangs on nothing
    np.testing.assert_array_equal(graph.order[graph.position[:5]], np.arange(5))
    assert graph.position[5] == -1
    np.testing.assert_array_equal(graph.vertex_count, [1, 3, 5])
    np.testing.assert_array_equal(graph.spring_count, [2, 4, 4])
    assert {tuple(ends) for ends in graph.order[graph.springs].tolist()} == {(0, 1), (1, 2), (2, 3), (3, 4)}
    np.testing.assert_allclose(graph.length, 1.0)
    vertices, springs = graph.prefixes(np.array([0, 1, 9]))
    np.testing.assert_array_equal(vertices, [1, 3, 5])
    np.testing.assert_array_equal(springs, [2, 4, 4])


def test_watched_vertices_that_nothing_connects_come_last():
    mesh = hand_mesh([[x, 0, 1] for x in range(7)], [[0, 1], [1, 2], [4, 5]])
    graph = spring_graph(mesh, np.array([0]), np.array([6, 1, 4, 6]), 10, FLOAT)
    np.testing.assert_array_equal(graph.order, [0, 1, 2, 4, 6])
    np.testing.assert_array_equal(graph.vertex_count, [1, 2, 3])
    np.testing.assert_array_equal(graph.position, [0, 1, 2, -1, 3, -1, 4])
    assert len(graph.springs) == 2


def test_distances_count_from_the_nearest_loaded_vertex():
    mesh = hand_mesh([[x, 0, 1] for x in range(7)], [[x, x + 1] for x in range(6)])
    graph = spring_graph(mesh, np.array([1, 5]), np.array([1]), 10, FLOAT)
    np.testing.assert_array_equal(graph.vertex_count, [2, 6, 7])
    assert set(graph.order[:2]) == {1, 5}
    assert graph.order[-1] == 3
    np.testing.assert_array_equal(graph.spring_count, [4, 6, 6])


def test_reach_cuts_the_mesh_one_spring_further_out():
    mesh = sheet(21, 21)
    graph = spring_graph(mesh, np.array([220]), np.array([220]), 3, FLOAT)
    offset = mesh.pixels[graph.order] - mesh.pixels[220]
    same = offset.prod(axis=1) >= 0
    distance = np.where(same, np.abs(offset).max(axis=1), np.abs(offset).sum(axis=1))
    assert distance.max() == 4
    assert len(graph.order) == 1 + 6 * (1 + 2 + 3 + 4)  # hexagonal numbers
    np.testing.assert_array_equal(graph.vertex_count, [1, 7, 19, 37, 61])
    np.testing.assert_array_equal(distance, np.sort(distance))


def test_a_lonely_vertex_is_its_own_graph():
    graph = spring_graph(hand_mesh([[0, 0, 1], [1, 0, 1]], []), np.array([1]), np.array([1]), 5, FLOAT)
    np.testing.assert_array_equal(graph.order, [1])
    assert graph.springs.shape == (0, 2)
    np.testing.assert_array_equal(graph.prefixes(np.array([0, 5]))[0], [1, 1])
