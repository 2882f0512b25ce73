"""Input of a network for a dent's sequence: the amounts of a few shapes in it at every instant, as one vector.

The response of a sheet of equal springs to a point load is a function of its graph Laplacian L. So its dents lie in the
span of the static responses of sheets with elastic foundations, (L + α)⁻¹δ. With six of them the bounds of 12 simulated
contacts were at most 11 % wider than the whole sequence's.
"""

import functools

import numpy as np
from scipy.sparse import eye_array
from scipy.sparse.linalg import spsolve

from palpate.data.contact.features import SLOTS, contact_features, contact_surroundings, slot_times
from palpate.data.contact.interaction import SAME_INSTANT, Interaction
from palpate.physics.depth import REACH, DepthSequence
from palpate.physics.mesh import grid_springs, laplacian

SHAPES = 6
"""Number of shapes of a dent."""
FOUNDATIONS = (0.02, 20.0)
"""Smallest and largest α, over the springs' stiffness."""
MARGIN = 13
"""Margin of the shapes' sheet beyond the depth-change sequence [grid pixels]."""
RIDGE = 1e-3
"""Ridge regularisation of shapes that hidden pixels leave undetermined."""
ROUNDED = 1.4
"""Factor on the noise given to a network with sequences if depth was rounded.

Errors of still tissue are then the same in all frames and in neighbouring pixels, as informative as fewer, larger ones.
"""
LARGE = 40.0
"""Large amount of a shape, in units of the mesh's spacing."""
SEQUENCE_FEATURES = 2 * SLOTS * SHAPES + 2
"""Length of the vector."""
WITHIN = SEQUENCE_FEATURES - 2
"""Place in the vector of the uncertainty of the press's instants; 0 = exact."""


@functools.cache
def dent_shapes() -> np.ndarray:
    """Orthonormal shapes on the pixels of a depth-change sequence, shape [P, SHAPES], the narrowest first."""
    side = 2 * (REACH + MARGIN) + 1
    springs = np.concatenate([grid_springs((side, side), *step) for step in ((1, 0), (0, 1), (1, 1))])
    stiffness = laplacian(springs, np.ones(len(springs)), np.zeros(side * side))
    press = np.zeros(side * side)
    press[side * side // 2] = 1
    inner = np.s_[MARGIN : side - MARGIN, MARGIN : side - MARGIN]
    found = []
    for foundation in np.geomspace(*FOUNDATIONS[::-1], SHAPES):
        answer = spsolve((stiffness + foundation * eye_array(side * side)).tocsc(), press)
        found.append(answer.reshape(side, side)[inner].ravel())
    shapes, mixed = np.linalg.qr(np.stack(found, axis=1))
    return shapes * np.sign(np.diag(mixed))


def shape_amounts(change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Amounts of the shapes in a depth-change sequence by least squares, and their error propagation.

    Args:
        change: shape [N, P]; NaN where nothing is visible.

    Returns:
        Amounts, shape [N, SHAPES]; and factors L of their covariances L·Lᵀ for independent errors of variance 1,
        shape [N, SHAPES, SHAPES].
    """
    shapes, visible = dent_shapes(), np.isfinite(change)
    normal = np.einsum("np,pi,pj->nij", visible.astype(np.float64), shapes, shapes) + RIDGE * np.eye(SHAPES)
    inverse = np.linalg.inv(normal)
    amounts = np.einsum("nij,nj->ni", inverse, np.where(visible, change, 0.0) @ shapes)
    return amounts, np.linalg.cholesky(inverse)


def motion_in_sequence(contact: Interaction) -> np.ndarray:
    """The contact's motion as its own pixel of the depth-change sequence shows it, shape [N, 3] [scene units].

    Its depth changes along the pixel's ray. The tracked motion is given instead if a pixel of the grid is one of the
    picture, and at instants without a sequence. A pixel that is the mean of several shows neighbours as well, and
    tracks slip by more than a dent's width.
    """
    sequence, mesh, moved = contact.sequence, contact.mesh, contact.moved.copy()
    if sequence is None or not len(sequence.times) or not sequence.is_finer_than(mesh.grid_shape):
        return moved
    times, middle = contact.observation.times, sequence.change[:, REACH, REACH]
    frames = np.abs(sequence.times - times[:, None]).argmin(axis=1)
    known = (np.abs(sequence.times[frames] - times) <= SAME_INSTANT) & np.isfinite(middle[frames])
    ray = mesh.vertices[contact.vertex] / mesh.vertices[contact.vertex, 2]
    moved[known] = middle[frames[known], None] * ray
    return moved


def network_noise(contact: Interaction) -> float:
    """σ of a contact that networks are given [scene units], larger where depth was rounded."""
    sequence = contact.sequence
    return contact.noise * (ROUNDED if sequence is not None and sequence.noise.rounded else 1.0)


def dent_features(contact: Interaction, within: float) -> np.ndarray:
    """Vector of a contact and its depth-change sequence, shape [FEATURES + SEQUENCE_FEATURES], float32.

    Args:
        contact: with or without a depth-change sequence.
        within: uncertainty of the instants [s], as in `sequence_features`.
    """
    sequence, noise = contact.sequence, network_noise(contact)
    shown = contact.having(point=contact.observation.moved(motion_in_sequence(contact), noise))
    around = contact_surroundings(contact)
    return np.concatenate([contact_features(shown, around), sequence_features(sequence, around.spacing, noise, within)])


def sequence_features(sequence: DepthSequence | None, spacing: float, noise: float, within: float) -> np.ndarray:
    """The vector of a depth-change sequence, shape [SEQUENCE_FEATURES], float32.

    Args:
        sequence: depth-change sequence of a contact; None where it has none.
        spacing: spacing of the mesh [scene units].
        noise: σ of every pixel [scene units].
        within: the press began, and ended, at most so long before or after the time stamps [s].
    """
    amounts, present = np.zeros((SLOTS, SHAPES)), False
    if sequence is not None:
        change = sequence.change.reshape(len(sequence.times), (2 * REACH + 1) ** 2)
        # Share of the pixels that must be visible in a frame that counts.
        kept = np.isfinite(change).mean(axis=1) >= 0.4
        present = bool(kept.any())
        if present:
            found, times = shape_amounts(change[kept])[0], sequence.times[kept]
            slots = slot_times()
            start = np.concatenate([[0.0], times])
            columns = [np.interp(slots, start, np.concatenate([[0.0], column])) for column in found.T]
            amounts = np.stack(columns, axis=1) * (slots <= times[-1] + 1e-9)[:, None]
    arguments = amounts[None], np.array([spacing]), np.array([noise]), np.array([within]), np.array([present])
    return join_sequence_features(*arguments)[0]


def join_sequence_features(
    amounts: np.ndarray, spacing: np.ndarray, noise: np.ndarray, within: np.ndarray, present: np.ndarray
) -> np.ndarray:
    """Vectors of many depth-change sequences, shape [B, SEQUENCE_FEATURES], float32.

    Args:
        amounts: amounts of the shapes at every slot, 0 where not visible, shape [B, SLOTS, SHAPES] [scene units].
        spacing, noise: shapes [B] [scene units].
        within: uncertainty of the instants, shape [B] [s].
        present: mask of contacts with a depth-change sequence, shape [B].
    """
    relative = amounts * present[:, None, None] / spacing[:, None, None]
    scaled = np.arcsinh(relative / (2 * (noise / spacing)[:, None, None])) / 5
    flags = within / slot_times()[0], present
    parts = [part.reshape(len(amounts), -1) for part in (relative / LARGE, scaled, *flags)]
    return np.concatenate(parts, axis=1).astype(np.float32)
