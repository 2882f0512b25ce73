"""What a network is given of a contact's brightness sequence: amounts of a few shapes in how its light has changed.

The shapes are rings around the contact, even and with one or two periods around it: a dent that faces the camera
darkens in rings, a tilted one on one side. Their amounts are fitted to what is visible, so that an instrument in front
hides no more than it must. A press turned around the line of sight only turns the amounts (`turned`).
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple, Self

import numpy as np

from palpate.data.brightness.sequence import PLACES, REACH
from palpate.data.contact.features import SLOTS, slot_times
from palpate.data.contact.interaction import Interaction
from palpate.physics.mesh import focal_length

RADII = np.array([0.0, 1.0, 2.0, 3.2, 4.7, 6.6])
"""Of the rings [grid pixels]."""
WIDTHS = np.array([0.6, 0.6, 0.65, 0.8, 1.0, 1.2])
"""Standard deviations of the Gaussians across the rings [grid pixels]."""
TURNS = ((1, (1, 2, 3, 4, 5)), (2, (1, 2, 3, 4)))
"""Periods around the contact, and which rings have a cosine and a sine of them."""
RINGS = len(RADII)
SHAPES = RINGS + 2 * sum(len(rings) for _, rings in TURNS)
RIDGE = 0.03
"""Keeps shapes that nothing visible determines small, as a share of a shape's own square."""
LEAST, MOST = -2.0, 1.0
"""Changes of the logarithm of light beyond these are taken to be these."""
SMALL, LARGE = 0.03, 2 / 3
"""A small and a large amount [logarithm of light]."""
USUAL_DISTANCE, USUAL_FOCAL = 0.35, 160.0
"""Of tissue from the camera [scene units], and a focal length [grid pixels]."""
FARTHEST_RIM = 40
"""Rims farther away count as if they were so near [grid pixels]."""
USUAL_STEP = 0.01
"""A coder's step [logarithm of light]."""
LIGHT_FEATURES = SLOTS * (2 * SHAPES + 3) + 2 * RINGS + 5
"""Length of the vector."""


class LightAmounts(NamedTuple):
    """Amounts of the shapes in N frames."""

    amounts: np.ndarray
    """Shape [N, SHAPES]."""
    left: np.ndarray
    """Root mean square of what they leave of the change where it is visible, shape [N]."""
    visible: np.ndarray
    """Share of every ring that is visible, shape [N, RINGS]."""


@dataclass(frozen=True)
class LightSlots:
    """Amounts of B contacts at the slots of `slot_times`, and what else the network is given of them, as arrays."""

    amounts: np.ndarray
    """Shape [B, SLOTS, SHAPES]."""
    left: np.ndarray
    """As of `LightAmounts`, shape [B, SLOTS]."""
    visible: np.ndarray
    """Under the instrument, and when it has gone, shape [B, 2, RINGS]."""
    load: np.ndarray
    """Time under load, where its end is known, else longer than all that is known, shape [B] [s]."""
    distance: np.ndarray
    """Of the contact from the camera, shape [B] [scene units]."""
    focal: np.ndarray
    """Focal length, shape [B] [grid pixels]."""
    rim: np.ndarray
    """Rows or columns from the contact to the mesh's nearest rim, shape [B]."""
    step: np.ndarray
    """As of `BrightnessSequence.coder_step`, shape [B]."""

    def __len__(self) -> int:
        return len(self.load)

    def chosen(self, some: np.ndarray | slice) -> Self:
        """Those of some contacts."""
        return type(self)(*(getattr(self, field.name)[some] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Those of several, at least one, in a row."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    def unexplained(self, known: np.ndarray) -> np.ndarray:
        """Share of the change of light that the shapes leave, root mean square over the first slots, shape [B].

        Args:
            known: as of `vectors`.
        """
        counts = np.arange(SLOTS) < known[:, None]
        shapes = light_shapes()[0]
        explained = np.einsum("bti,ij,btj->bt", self.amounts, shapes.T @ shapes / len(shapes), self.amounts)
        left = (counts * np.square(self.left)).sum(axis=1)
        return np.sqrt(left / np.maximum(left + (counts * explained).sum(axis=1), 1e-12))

    def vectors(self, known: np.ndarray) -> np.ndarray:
        """What the network is given of the first slots of every contact, shape [B, LIGHT_FEATURES], float32.

        `estimators.network.causal_graph` does the same in torch, and what comes before.

        Args:
            known: how many slots count, 1 to SLOTS, shape [B].
        """
        slots = slot_times()
        counts = (np.arange(SLOTS) < known[:, None]).astype(np.float64)
        last = slots[known - 1]
        amounts, free = self.amounts * counts[..., None], last > self.load + 1e-9
        visible = np.stack(
            [self.visible[:, 0], np.where(free[:, None], self.visible[:, 1], self.visible[:, 0])], axis=1
        )
        size = np.log(self.distance / USUAL_DISTANCE), np.log(USUAL_FOCAL / self.focal)
        rim, load = np.minimum(self.rim, FARTHEST_RIM) / FARTHEST_RIM, np.minimum(self.load, last)
        scales = np.stack([*size, rim, load, np.log1p(self.step / USUAL_STEP)], axis=1)
        loaded = (slots <= self.load[:, None] + 1e-9) * counts
        parts = (
            np.arcsinh(amounts / SMALL) / 3,
            amounts / LARGE,
            20 * self.left * counts,
            counts,
            loaded,
            visible,
            scales,
        )
        return np.concatenate([part.reshape(len(self), -1) for part in parts], axis=1).astype(np.float32)


@functools.cache
def light_shapes() -> tuple[np.ndarray, np.ndarray]:
    """The shapes at the places that are compared [P, SHAPES], and which places of the lattice those are [L, L]."""
    rows, columns = np.meshgrid(PLACES, PLACES, indexing="ij")
    inner = (np.abs(rows) <= REACH + 0.5) & (np.abs(columns) <= REACH + 0.5)
    radius, angle = np.hypot(rows, columns)[inner], np.arctan2(rows, columns)[inner]
    rings = np.exp(-np.square((radius[:, None] - RADII) / WIDTHS) / 2)
    turning = [
        math.sqrt(2) * rings[:, ring] * wave(periods * angle)
        for periods, some in TURNS
        for ring in some
        for wave in (np.cos, np.sin)
    ]
    return np.concatenate([rings, np.stack(turning, axis=1)], axis=1), inner


def light_amounts(change: np.ndarray) -> LightAmounts:
    """Amounts of the shapes that explain a change of light best.

    Args:
        change: of the logarithm of light since rest, shape [N, L, L]; not a number where no tissue is visible.
    """
    shapes, inner = light_shapes()
    values = change[:, inner].astype(np.float64)
    visible = np.isfinite(values)
    values = np.clip(np.where(visible, values, 0.0), LEAST, MOST)
    whole, before = np.square(shapes).sum(axis=0), None
    amounts, seen = np.empty((len(values), SHAPES)), np.empty((len(values), RINGS))
    solve, share = np.empty((SHAPES, len(shapes))), np.empty(RINGS)
    for index, shown in enumerate(visible):
        if before is None or not np.array_equal(shown, before):
            some, before = shapes * shown[:, None], shown
            solve = np.linalg.solve(some.T @ some + np.diag(RIDGE * whole), some.T)
            share = (np.square(some).sum(axis=0) / whole)[:RINGS]
        amounts[index], seen[index] = solve @ values[index], share
    left = np.where(visible, values - amounts @ shapes.T, 0.0)
    rms = np.sqrt(np.square(left).sum(axis=1) / np.maximum(visible.sum(axis=1), 1))
    return LightAmounts(amounts, rms, seen)


def turned(amounts: np.ndarray, angle: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
    """Amounts of sequences that are turned, and mirrored first where that is asked for.

    Args:
        amounts: shape [B, ..., SHAPES].
        angle: from columns to rows, shape [B] [rad].
        mirrored: along rows, shape [B], bool.
    """
    found, first = amounts.copy(), RINGS
    ends = (len(amounts), *[1] * (amounts.ndim - 1))
    sign = np.where(mirrored, -1.0, 1.0).reshape(ends)
    for periods, rings in TURNS:
        cosine, sine = (wave(periods * angle).reshape(ends) for wave in (np.cos, np.sin))
        end = first + 2 * len(rings)
        across, down = amounts[..., first:end:2], sign * amounts[..., first + 1 : end : 2]
        found[..., first:end:2] = cosine * across - sine * down
        found[..., first + 1 : end : 2] = sine * across + cosine * down
        first = end
    return found


def light_slots(contact: Interaction) -> tuple[LightSlots, np.ndarray]:
    """What the network is given of one contact, and how many slots of that are known, shape [1].

    Args:
        contact: with a brightness sequence that shows the light in one frame or more.
    """
    sequence, slots = contact.brightness, slot_times()
    assert sequence is not None
    found = light_amounts(sequence.light - sequence.rest)
    times = np.concatenate([[0.0], sequence.times])
    amounts = np.stack([np.interp(slots, times, np.concatenate([[0.0], column])) for column in found.amounts.T], axis=1)
    known = np.clip((slots <= sequence.times[-1] + 1e-9).sum(), 1, SLOTS)
    mesh, vertex = contact.mesh, contact.vertex
    focal, pixel = float(np.mean(focal_length(mesh))), mesh.pixels[vertex]
    rim = np.abs(mesh.pixels[mesh.rim] - pixel).max(axis=1).min(initial=FARTHEST_RIM)
    single = (
        amounts,
        np.interp(slots, sequence.times, found.left),
        found.visible[[0, -1]],
        contact.load_seconds if contact.released else slots[-1] + 1.0,
        float(mesh.vertices[vertex, 2]),
        focal,
        float(rim),
        sequence.coder_step,
    )
    return LightSlots(*(np.asarray(values)[None] for values in single)), known[None]
