"""How an endless gripped sheet answers a force on one of its nodes.

The sheet of `physics.sheet` on a square grid without an end, alike everywhere, springs of stiffness 1 to all eight
neighbours: K u = f is a convolution, and the discrete Fourier transform solves it at once for all nodes. What a force
anywhere does follows by shifting it, so that no equation has to be solved for each node that is pulled.
"""

from __future__ import annotations

import numpy as np


def response(anchor: float, size: int) -> np.ndarray:
    """Displacement of every node for a unit of force on node (0, 0), shape [size, size].

    Indices count modulo `size`: the sheet is repeated beyond, which does not show while motion dies away within it,
    over √(3/anchor) nodes. It adds up to 1/anchor, because the foundation holds all of the force.

    Args:
        anchor: stiffness of a node's foundation over a spring's, positive.
        size: of the repeated piece [nodes].

    Raises:
        ValueError: the anchor is not positive; without any a node has no place.
    """
    if not anchor > 0:
        raise ValueError(f"anchor is {anchor}; without any a node has no place.")
    turn = 2 * np.pi / size
    down, across = np.cos(turn * np.arange(size))[:, None], np.cos(turn * np.arange(size // 2 + 1))
    # Two springs along each axis, and two along each diagonal.
    springs = 2 * (1 - down) + 2 * (1 - across) + 4 * (1 - down * across)
    return np.fft.irfft2(1 / (springs + anchor), (size, size))
