"""How well a grip's foundation and force could be known at best: the Cramér–Rao bound of a sheet whose points are seen
with noise, those of the grip as well."""

from __future__ import annotations

import math

import numpy as np

from estimators.grip.lattice import continued, lattice_springs
from estimators.grip.sheet_fit import BEYOND, GripFrame
from physics.sheet import equilibrium


def grip_bound(points: np.ndarray, spacing: int, frame: GripFrame, log_anchor: float) -> tuple[float, float]:
    """Bounds on the logarithms of foundation over stiffness and of force over stiffness, for σ = 1 px by axis.

    Unknown are the foundation and the grip's true way. One frame counts: errors of following add up, so that the last
    one knows of an even pull what all do.

    Args:
        points: at rest, shape [N, 2] [px].
        spacing: of their grid [px].
        frame: where they truly are, and which are gripped.
        log_anchor: true log of foundation over stiffness.
    """
    nodes = continued(points, spacing, BEYOND)
    springs = lattice_springs(nodes, spacing)
    gripped = np.zeros(len(nodes), bool)
    gripped[: len(points)] = frame.gripped
    anchor = np.full(len(nodes), math.exp(log_anchor))
    around, count = np.flatnonzero(frame.around), int(gripped.sum())
    # Where the nodes go for a unit of motion of every gripped one.
    unit = equilibrium(springs, np.ones(len(springs)), anchor, gripped, np.eye(count))
    response, pull = unit.displacement[around], unit.reaction.sum(axis=0)
    moved = equilibrium(springs, np.ones(len(springs)), anchor, gripped, frame.moved[frame.gripped])
    slope = moved.slopes(np.zeros((len(springs), 1)), anchor[:, None])[:, :, 0]
    # Of the force by the log foundation: what K does to the slope, and what the foundation itself pulls.
    bent = (moved.matrix @ slope)[gripped].sum(axis=0) + (anchor[:, None] * moved.displacement)[gripped].sum(axis=0)
    force = moved.reaction.sum(axis=0)
    along = force / (force @ force)
    # Both axes have the same response; the foundation is common to them.
    own = np.linalg.inv(response.T @ response + np.eye(count))
    cross = response.T @ slope[around]
    information = np.square(slope[around]).sum() - np.einsum("ia,ij,ja->", cross, own, cross)
    variance = 1 / information
    # The grip's way follows the foundation where both are estimated.
    total = along @ bent - np.einsum("a,i,ij,ja->", along, pull, own, cross)
    alone = (along @ along) * (pull @ own @ pull)
    return math.sqrt(variance), math.sqrt(total**2 * variance + alone)
