"""Blocks, and how they are held."""

import numpy as np

from palpate.physics.fem import Solid, box, make_solid


def block(cells: int = 2, order: int = 1, *, seed: int | None = None) -> Solid:
    """A unit cube, its inner nodes moved at random with a seed."""
    nodes, tetrahedra = box((1.0, 1.0, 1.0), (cells, cells, cells))
    if seed is not None:
        inner = ((nodes > 0) & (nodes < 1)).all(axis=1)
        nodes[inner] += np.random.default_rng(seed).uniform(-0.1, 0.1, (inner.sum(), 3)) / cells
    return make_solid(nodes, tetrahedra, order=order)


def clamped(body: Solid) -> np.ndarray:
    """Held where x = 0, shape [N, 3]."""
    return np.repeat(np.isclose(body.rest[:, :1], 0.0), 3, axis=1)


def rotation(seed: int = 0) -> np.ndarray:
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return turn * np.linalg.det(turn)
