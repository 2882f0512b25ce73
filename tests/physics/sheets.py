"""Small meshes and an independent right-hand side for the tests of the simulator."""

import dataclasses

import numpy as np

from palpate.physics import Grip, Mesh, Press, contact_normal, grid_mesh, held
from palpate.physics.msd.simulation import simulate


def surface(height: int, width: int, depth: float = 0.5) -> np.ndarray:
    """Points [H, W, 3] of a wavy surface seen through a 60° pinhole camera."""
    row, column = np.mgrid[:height, :width]
    focal = width / 2 / np.tan(np.deg2rad(30))
    z = depth + 0.02 * np.sin(column / 3.1) + 0.01 * np.cos(row / 2.3)
    return np.stack([(column - width / 2) * z / focal, (row - height / 2) * z / focal, z], -1).astype(np.float32)


def sheet(height: int = 10, width: int = 10, spacing: float = 0.01, keep: float = 1.0) -> Mesh:
    """A wavy grid mesh with a spacing near that of real tissue."""
    row, column = np.mgrid[:height, :width]
    z = 0.5 + 0.3 * spacing * np.sin(column / 1.7) + 0.2 * spacing * np.cos(row / 1.3)
    points = np.stack([column * spacing, row * spacing, z], -1).astype(np.float32)
    return grid_mesh(points, np.ones((height, width), dtype=bool), max_edge=10 * spacing, keep=keep)


def loose(mesh: Mesh) -> Mesh:
    """Mesh with no rim that is held."""
    return dataclasses.replace(mesh, rim=np.zeros_like(mesh.rim))


def hand_mesh(vertices, springs, rim=None, triangles=()) -> Mesh:
    """A mesh from lists; pixels are given as one row."""
    vertices = np.asarray(vertices, dtype=np.float32).reshape(-1, 3)
    count = len(vertices)
    return Mesh(
        vertices=vertices,
        triangles=np.asarray(triangles, dtype=np.int32).reshape(-1, 3),
        springs=np.asarray(springs, dtype=np.int32).reshape(-1, 2),
        rim=np.zeros(count, dtype=bool) if rim is None else np.asarray(rim, dtype=bool),
        pixels=np.stack([np.zeros(count), np.arange(count)], axis=1).astype(np.int32),
        grid_shape=(1, count),
    )


def pressed(mesh: Mesh, vertex: int, load_steps: float, steps: int, direction: np.ndarray | None = None) -> Press:
    """A press on one vertex, along its normal unless a direction is given, that lasts so many of all steps."""
    return Press.at(vertex, contact_normal(mesh, vertex) if direction is None else direction, held(load_steps, steps))


def smooth_path(times: np.ndarray, duration: float) -> np.ndarray:
    """Share of a way that is gone at each time, from rest to rest: 3s² − 2s³ of the duration's share s."""
    share = np.clip(np.asarray(times) / duration, 0.0, 1.0)
    return share * share * (3 - 2 * share)


def gripped(mesh: Mesh, vertices, duration: float, steps: int, time_step: float = 0.005, size: float = 0.004) -> Grip:
    """A grip that pulls, turns and lifts its vertices on a smooth path, of about a given size."""
    vertices = np.asarray(vertices, np.int64)
    rest = mesh.vertices[vertices].astype(np.float64)
    turned = np.stack([-(rest - rest.mean(axis=0))[:, 1], (rest - rest.mean(axis=0))[:, 0], 0 * rest[:, 0]], axis=1)
    goal = size * np.array([0.5, -0.3, 0.8]) + 0.2 * turned
    return Grip(vertices, smooth_path(time_step * np.arange(1, steps + 1), duration)[:, None, None] * goal)


def whole_field(theta, mesh: Mesh, load, mechanics, **options) -> np.ndarray:
    """Displacement of every vertex after each step, shape [T, N, 3]."""
    return simulate(theta, mesh, load, mechanics, watch=np.arange(len(mesh.vertices)), **options)


def position_form_force(displacement: np.ndarray, mesh: Mesh, stiffness: float) -> np.ndarray:
    """Elastic force [N, 3] written the textbook way, k (|d| − |d₀|) d/|d| a spring, one spring after the other."""
    rest = mesh.vertices.astype(np.float64)
    force = np.zeros_like(displacement)
    for first, second in mesh.springs:
        current = rest[second] + displacement[second] - rest[first] - displacement[first]
        length, rest_length = np.linalg.norm(current), np.linalg.norm(rest[second] - rest[first])
        if length > 0:
            pull = stiffness * (length - rest_length) * current / length
            force[first] += pull
            force[second] -= pull
    return force


def energy(displacement: np.ndarray, velocity: np.ndarray, mesh: Mesh, stiffness: float, mass: float) -> float:
    """Elastic plus kinetic energy."""
    position = mesh.vertices.astype(np.float64) + displacement
    rest = mesh.vertices.astype(np.float64)
    first, second = mesh.springs.T
    length = np.linalg.norm(position[second] - position[first], axis=1)
    rest_length = np.linalg.norm(rest[second] - rest[first], axis=1)
    return 0.5 * stiffness * ((length - rest_length) ** 2).sum() + 0.5 * mass * (velocity**2).sum()
