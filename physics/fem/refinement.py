"""Tetrahedra divided where they are too long: bisection of longest edges (Rivara 1984; in space Rivara & Levin 1992).

A tetrahedron is halved through the middle of its longest edge, and so are all others around that edge. Those of which
it is not the longest edge are halved first through their own, so that the mesh stays one without hanging nodes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import KDTree

from palpate.physics.fem.solid import EDGES

Longest = Callable[[np.ndarray], np.ndarray]
"""How long edges may be at most around places [P, 3], shape [P], positive [m]."""
GROWTH = 0.5
"""Of edges' length by the distance from what they crowd around."""


def around(places: np.ndarray, radius: float, edge: float) -> Longest:
    """Edges that crowd where an instrument presses.

    Args:
        places: where, shape [K, 3] [m].
        radius: within which edges are at most
        edge: so long, and farther off by GROWTH longer [m].
    """

    def longest(there: np.ndarray) -> np.ndarray:
        return edge + GROWTH * np.maximum(KDTree(places).query(there)[0] - radius, 0.0)

    return longest


def refine(nodes: np.ndarray, tetrahedra: np.ndarray, longest: Longest) -> tuple[np.ndarray, np.ndarray]:
    """Divide tetrahedra until their edges are short enough.

    Args:
        nodes: shape [N, 3] [m].
        tetrahedra: corners, shape [E, 4], of positive volume.
        longest: how long edges may be, given at the elements' middle.

    Returns:
        nodes, those given first; corners of the tetrahedra, of positive volume.
    """
    while True:
        sides = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
        found, which = np.unique(sides, axis=0, return_inverse=True)
        pairs = np.asarray(found, np.int64)
        which = which.reshape(-1, len(EDGES))
        length = np.linalg.norm(np.diff(nodes[pairs], axis=1)[:, 0], axis=1)
        # Among edges as long as each other up to rounding, all tetrahedra are to choose the same.
        rank = np.empty(len(pairs), np.int64)
        rank[np.lexsort([np.arange(len(pairs)), np.round(length / length.max(), 9)])] = np.arange(len(pairs))
        own = which[np.arange(len(which)), rank[which].argmax(axis=1)]
        wanted = length[own] > longest(nodes[tetrahedra].mean(axis=1))
        if not wanted.any():
            return nodes, tetrahedra
        while True:  # whoever stands around an edge to be halved is halved before, if not by it
            halved = np.zeros(len(pairs), bool)
            halved[own[wanted]] = True
            around = halved[which].any(axis=1)
            if (around == wanted).all():
                break
            wanted = around
        blocked = np.zeros(len(pairs), bool)
        blocked[which[which != own[:, None]]] = True
        halved &= ~blocked
        middle = len(nodes) + np.cumsum(halved) - 1
        some = halved[own]
        ends, old = pairs[own[some]], tetrahedra[some]
        parts = [np.where(old == end[:, None], middle[own[some]][:, None], old) for end in ends.T]
        nodes = np.concatenate([nodes, nodes[pairs[halved]].mean(axis=1)])
        tetrahedra = np.concatenate([tetrahedra[~some], *parts])
