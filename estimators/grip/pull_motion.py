"""How points in the picture move if a grip carries a slab of finite elements along a smooth way, to first order.

Where tissue is gripped and how it gets there is prescribed, so that motion, and force over E, depend on the body's
shape, on ρ/E and on d/E alone: φ = (log E, log d) in units of a density, as of `estimators.direct.slab_motion`. Nothing
strains much, so that the motion is linear in the way. This is a natural cubic spline in time which begins at rest;
one simulation for each direction in the picture's plane answers for all its bumps, as these differ in time alone.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from palpate.estimators.direct.slab_motion import DENSITY, POISSON
from palpate.physics.fem import Inertia, Material, simulate
from palpate.physics.fem.slab import Slab
from palpate.physics.load import Grip

CELLS = 6, 6, 2
"""Of the slab, along columns, rows and depth, of quadratic elements: linear ones are far too stiff beside the grip."""
KNOTS = 9
"""Of the way, from its beginning to the last instant that is looked at."""
STEPS = 3
"""Of the simulation from one knot to the next."""


class PullMotion:
    """Motion of n points in the picture, and what holds the grip, at T instants, by 2P numbers of the grip's way.

    Args:
        slab: the body; its contact is the grip's middle.
        cell: width and height of a grid pixel, shape [2] [px].
        places: the points at rest, within the slab, shape [n, 2] (column, row) [px].
        radius: of the tissue that moves as one with the instrument [grid px].
        times: since rest, rising, shape [T] [s].
    """

    def __init__(self, slab: Slab, cell: np.ndarray, places: np.ndarray, radius: float, times: np.ndarray) -> None:
        self.slab, self._shown = slab, slab.between(((places + 0.5) / cell - 0.5)[:, ::-1])
        rest = self._shown @ slab.solid.rest
        self._scale = cell * slab.focal_lengths / rest[:, 2:]
        self._slopes = rest[:, :2] / rest[:, 2:]
        self.scale = float(self._scale.mean())
        """Of the picture [px/scene unit]."""
        apart = np.hypot(slab.columns[:, None] - slab.place[0], slab.rows - slab.place[1])
        self.gripped = slab.top[apart <= radius]
        """Nodes that move with the instrument, the contact's at least."""
        self.step = float(times[-1]) / (KNOTS * STEPS)
        """Of the simulation [s]."""
        after = np.minimum((times / self.step).astype(int), KNOTS * STEPS - 1)
        self._after, self._share = after, times / self.step - after
        self._latest: tuple[np.ndarray, tuple[np.ndarray, np.ndarray]] | None = None

    def at(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By every number of the way: displacement of points, shape [T, n, 2, 2P], and force over E, [T, 2, 2P].

        The way's numbers are displacements [scene units], those along the picture's two directions taking turns, P =
        KNOTS - 1 of each; points move in px, force over E counts in scene units².

        Args:
            logs: φ, shape [2]. The latest is remembered, as it takes half a second.
        """
        if self._latest is None or not np.array_equal(self._latest[0], logs):
            moved, held = zip(*(self._answer(logs, axis) for axis in (0, 1)), strict=True)
            self._latest = np.array(logs), (self._spline(np.stack(moved, -1)), self._spline(np.stack(held, -1)))
        return self._latest[1]

    def _answer(self, logs: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """Of one bump along an axis of the picture: points [S + 1, n, 2] and force over E [S + 1, 2], S steps."""
        young, damping = np.exp(logs)
        path = np.zeros((KNOTS * STEPS, len(self.gripped), 3))
        path[:, :, axis] = np.nan_to_num(_BUMP(np.arange(1, len(path) + 1) / STEPS))[:, None]
        found = simulate(
            self.slab.solid,
            Material("linear", young, POISSON),
            self.slab.held,
            Grip(self.gripped, path),
            self.step,
            inertia=Inertia(DENSITY, damping / DENSITY),
        )
        held = found.reaction[:, self.gripped, :2].sum(axis=1) / young
        # Means over the steps to values between them.
        held = np.concatenate([held[:1] / 2, (held[:-1] + held[1:]) / 2, held[-1:]])
        moved = np.stack([self._shown @ nodes for nodes in found.displacement])
        return self._scale * (moved[..., :2] - self._slopes * moved[..., 2:]), held

    def _spline(self, answer: np.ndarray) -> np.ndarray:
        """What a bump does [S + 1, ..., 2], begun at every knot, seen at the instants [T, ..., 2P]."""
        parts = []
        for knot in range(KNOTS):
            late = np.zeros_like(answer)
            late[knot * STEPS :] = answer[: len(answer) - knot * STEPS]
            parts.append(late)
        # Without curvature at its end.
        last = parts.pop()
        parts[-1] = parts[-1] + 2 * last
        parts[-2] = parts[-2] - last
        share = self._share.reshape(-1, *[1] * answer.ndim)
        whole = np.stack(parts, axis=-2)
        found = (1 - share) * whole[self._after] + share * whole[self._after + 1]
        return found.reshape(*found.shape[:-2], -1)


_BUMP = BSpline.basis_element(np.arange(5.0), extrapolate=False)
