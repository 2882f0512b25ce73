"""Forces and costs of an instrument that presses a body in space.

The tip is a ball, the shaft a row of balls to the port, one radius apart, each bearing half of what a tip would. A
ball's force follows from its depth in the resting body by a press on a large block. That is simulated once for E = 1
and scaled: forces and work are linear in E. Contact slides without friction, so work is the rise of the stored energy.
Of an edge it is half of all rises and falls, so that it costs the same both ways.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.integrate import cumulative_trapezoid

from palpate.physics.identifiability import NINETY
from palpate.planning.press import simulate_press
from palpate.planning.roadmap import DIGITS, MILLI, TIE, Plan, weighed
from palpate.planning.scene import SoftObject, SpaceScene

RADIUS = 0.01
"""Radius of the tip that presses the block [m]."""
BLOCK = SoftObject((0.1, 0.12, 0.12), 1000.0, held=("right", "top", "bottom"), longest=4 * RADIUS, cells=(4, 4, 4))
"""Four radii are the deepest press that is known; deeper ones count as too much force."""


def unit_press(poisson: float) -> np.ndarray:
    """Return a tip's press by a radius of 1 m and E = 1 Pa: depth [m], force [N] and work [J], shape [3, S]."""
    found = simulate_press(replace(BLOCK, poisson=poisson), RADIUS, np.array([-BLOCK.size[0] / 2, 0.0]), 0.0)
    # So many that the energy, which is interpolated as the force is, is off by little.
    depth = np.linspace(0, found.lengths[-1], 81) / RADIUS
    force = np.interp(depth, found.lengths / RADIUS, found.force) / (BLOCK.young * RADIUS**2)
    return np.stack([depth, force, cumulative_trapezoid(force, depth, initial=0)])


class PressingCosts:
    """Costs of straight lines of the tip in a scene.

    Args:
        scene: as read.
        known: `press` of `unit_press`, and the grid that `surface.measure` returns.
    """

    def __init__(self, scene: SpaceScene, known: dict[str, Any]) -> None:
        self.scene, self.known, self.radius = scene, known, scene.tip_radius
        self.start, self.goal, self.port = (np.array(place) for place in (scene.start, scene.goal, scene.port))
        self.corners = known["low"] + known["step"] * np.array([[0, 0, 0], np.array(known["values"].shape) - 1])
        """Corners of the grid, shape [2, 3] [m]."""
        # Standard deviations of the logarithm of force and work, of bodies of other shapes than the block.
        self.spread, self.work_spread = np.exp(NINETY * np.hypot(scene.young_log_sd, [0.45, 0.56])).tolist()
        """Factors from a force, and from work, to the upper end of its 90 % interval."""

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distance of points [M, 3] from the body, negative within, shape [M] [m]; outside the grid as at
        its border."""
        cells = (points - self.known["low"]) / self.known["step"]
        return ndimage.map_coordinates(self.known["values"], cells.T, order=1, mode="nearest").astype(float)

    def loads(self, tips: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the force [N], infinite where it is not known, and stored energy [J] with the tip at places [M, 3],
        shapes [M].

        Both are for E = 1 Pa.
        """
        depths, forces, energies = self.known["press"] * self.radius ** np.array([[1], [2], [3]])
        found = []
        for some in np.split(tips, range(50_000, len(tips), 50_000)):  # so many at once
            away = self.port - some
            length = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
            away = np.where(away == 0, 1e-12, away) / length
            # Before it enters the grid of distances and beyond where it leaves it the shaft is free.
            ends = np.sort([(corner - some) / away for corner in self.corners], axis=0)
            first, last = np.clip([ends[0].max(axis=1), ends[1].min(axis=1)], 0, length[:, 0]) / self.radius
            begin = np.floor(first).astype(int)
            counts = np.maximum(np.ceil(last).astype(int) - begin, 0)
            row = np.repeat(np.arange(len(some)), counts)
            ball = np.arange(len(row)) + (begin - np.cumsum(counts) + counts)[row]
            depth = self.radius - self.distance(some[row] + self.radius * ball[:, None] * away[row])
            share = np.where(ball == 0, 1.0, 0.5)
            force, energy = np.interp(depth, depths, forces, right=np.inf), np.interp(depth, depths, energies)
            found.append([np.bincount(row, share * each, len(some)) for each in (force, energy)])
        force, energy = np.concatenate(found, axis=1)
        return force, energy

    def along(self, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return places [M, 3] [m] on lines [K, 3] → [K, 3], ends included, and which of them is each line's first,
        [K]."""
        # Distance of places along an edge, over the radius.
        counts = np.ceil(np.linalg.norm(ends - starts, axis=1) / (0.25 * self.radius)).astype(int) + 2
        begin = np.cumsum(counts) - counts
        line = np.repeat(np.arange(len(starts)), counts)
        share = (np.arange(len(line)) - begin[line]) / (counts[line] - 1)
        return starts[line] + share[:, None] * (ends - starts)[line], begin

    def edges(self, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the work along lines [K, 3] → [K, 3] and the largest force, for E = 1 Pa, shapes [K] [J] and [K]
        [N]."""
        tips, begin = self.along(starts, ends)
        force, energy = self.loads(tips)
        changes = np.abs(np.diff(energy, prepend=0.0))
        changes[begin] = 0.0
        return np.add.reduceat(changes, begin) / 2, np.maximum.reduceat(force, begin)

    def deformation(self, work: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the deformation cost of lines of which `edges` told work and force, infinite over the limit, shape [K]
        [mJ]."""
        # Share of the limit that the force may reach at those places; between them it is up to 4.5 % larger.
        over = force * self.scene.young * self.spread > 0.95 * self.scene.limit_N
        return np.where(over, np.inf, np.round(MILLI * self.scene.young * work, DIGITS))

    def price(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return costs of lines [K, 3] → [K, 3], shape [K]; of lines that cost the same the shorter costs a little
        less."""
        way = MILLI * np.linalg.norm(ends - starts, axis=1)
        return weighed(self.scene.alpha, self.deformation(*self.edges(starts, ends)), way) + TIE * way

    def plan(self, places: np.ndarray) -> Plan:
        """Return the cost of a way, its places [P, 3] given."""
        begun, ended = MILLI * self.scene.young * self.loads(places[[0, -1]])[1]
        deformation = self.deformation(*self.edges(places[:-1], places[1:])).sum() + (ended - begun) / 2
        return Plan.of(places, float(deformation), self.scene.alpha)

    def interval(self, plan: Plan) -> tuple[float, float]:
        """Return the 90 % interval of a way's cost; its deformation is log-normal."""
        share, spread = self.scene.alpha * plan.deformation, self.work_spread
        return plan.cost - share * (1 - 1 / spread), plan.cost + share * (spread - 1)
