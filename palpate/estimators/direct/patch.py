"""Motion of vertices under a press on a patch, in any direction, whose force rises, holds and falls.

Besides φ and the delays (`estimators.direct.motion`) the parameters are the patch's radius, as a logarithm, its middle
next to the contact vertex, and the shares of rise and fall. The first share is of the time under load, the second of
the rest; without a release there is no fall. `PressShape` defines them.
"""

import math

import numpy as np

from palpate.estimators.direct.motion import PressMotion
from palpate.physics.load import Press, PressShape

RADII = (1.0, 8.0)
"""Radii of patches [grid pixels]: at the least it is one vertex, and dents are visible as far as 7."""


class PatchMotion(PressMotion):
    """Displacements under a press of any shape; parameters D: φ, the delays, then log R, row, column, lean to the
    right, lean downwards, rise, fall."""

    starts = 8
    """Number of candidates; wide dents are deep, and from a bad start pixels seem to show other tissue."""
    looks = 4
    """Number of decisions at the best fit; two left a seventh of the fall of an over-damped press wrong."""
    parts = 3
    """Parts of a pixel along an axis. Whole pixels jump between patches at a dent's wall, which resembles another force
    profile: the ratios of two clips were off by up to 2.9 bounds, with parts by 1.2."""
    astray, uneven = 0.02, 0.008
    """Errors of the simulated dent, sideways [grid px] and relative in depth, from the steps at the ends of vertices'
    patches; measured at the true motion of 13 synthetic clips."""
    sampled = False
    """False, as draws in ten dimensions shrink to a few and underestimate standard deviations; the optima's covariance
    counts instead."""

    @property
    def centred(self) -> np.ndarray:
        """Centred parameters as in `PressMotion`; the patch's place and the lean among them."""
        return np.concatenate([super().centred, self.delays.stop + np.arange(1, 5)])

    def box(self, tissue: np.ndarray) -> np.ndarray:
        """Return the box, as in `PressMotion`, with the shape's parameters behind."""
        # A patch's middle lies up to 2.5 grid pixels from the vertex along an axis, a force leans by up to 40 degrees.
        ends = [np.log(RADII), *2 * [(-2.5, 2.5)], *2 * [(-0.85, 0.85)], (0.0, 1.0)]
        if self.contact.released:
            ends.append((0.0, 1.0))
        return np.hstack([super().box(tissue), np.array(ends).T])

    def shape(self, logs: np.ndarray, longer: float = 0.0) -> PressShape:
        """Return the shape of all parameters [D]; `longer` as in `load`."""
        radius, row, column, right, down, *shares = logs[self.delays.stop :].tolist()
        seconds = self._seconds(logs, longer)
        rise, fall = (*shares, 0.0)[:2]
        rise, fall = rise * seconds, fall * (1 - rise) * seconds
        return PressShape(math.exp(radius), (row, column), rise, fall, (right, down))

    def parameters(self, logs: np.ndarray, shape: PressShape) -> np.ndarray:
        """Return all parameters [D] from φ and the delays, and a shape."""
        seconds = self._seconds(logs)
        courses = [shape.rise / seconds, shape.fall / (seconds - shape.rise)][: 1 + self.contact.released]
        return np.concatenate([logs, [math.log(shape.radius)], shape.offset, shape.lean, courses])

    def _seconds(self, logs: np.ndarray, longer: float = 0.0) -> float:
        """Return the time of which rise and fall are shares [s]."""
        return self.loaded(logs, longer) if self.contact.released else float(self.times[-1])

    def load(self, logs: np.ndarray, time_step: float, steps: int, longer: float = 0.0) -> Press:
        """Return the load as `PressMotion` does."""
        contact, seconds = self.contact, self.loaded(logs, longer)
        shape = self.shape(logs, longer)
        return shape.press(contact.mesh, contact.vertex, contact.direction, seconds, time_step, steps)

    def _others(self, logs: np.ndarray) -> np.ndarray:
        """Return derivatives by the shape's parameters: differences towards the middle of their range."""
        middles = self.box(np.zeros((2, 3))).mean(axis=0)
        here, found = self.quick(logs), []
        # Small against the bounds, large against rounding.
        steps = (0.02, 0.05, 0.05, 0.02, 0.02, 0.02, 0.02)
        for index, size in enumerate(steps[: len(logs) - self.delays.stop], self.delays.stop):
            changed = np.array(logs, np.float64)
            size = size if logs[index] < middles[index] else -size
            changed[index] += size
            found.append((self.quick(changed) - here) / size)
        return np.stack(found, axis=-1)
