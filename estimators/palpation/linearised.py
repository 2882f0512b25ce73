"""Points of palpations against simulated surfaces, linear in (1/E, ν) around what was simulated, and in the poses.

Between two simulations Gauss–Newton steps go on by these derivatives; points are matched anew as often as it takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.estimators.palpation.bench import GRAZING, OUTLIER, Bench, Progress
from palpate.estimators.palpation.registration import turned
from palpate.physics.fem import Equilibrium

POISSON = (0.0, 0.495)
"""Range of ν that is looked at; below 0 no tissue lies, above it the elements lock."""
INNER = 20
"""Steps between two simulations."""
CLOSE = 0.3
"""Change of log E and ν over their standard deviations by the noise, that needs no further simulation: it is made all
the same, by the derivatives, and what is left is of its square."""
ROUGH = 1.02
"""By what factor the error may grow in a step: which points count changes, which roughens it."""
SHORTEST = 0.01
"""Share of a step, below which none is tried."""
FARTHEST, WIDEST = 10.0, 0.15
"""Factor by which a step changes E at most, and by how much ν moves between two simulations."""
STRIDE = 0.1
"""Of a pose's standard deviation as the tool tells it: what a step moves it by where the body leaves it open, as a ball
its turns. Facets pull it to and fro there."""


@dataclass(frozen=True, eq=False)
class State:
    """How a press moves the body close to what was simulated."""

    moved: np.ndarray
    """Displacement of the surface's vertices, shape [V, 3] [m]."""
    slopes: np.ndarray
    """Its derivatives by relative compliance, E's inverse over that simulated, and by ν, shape [V, 3, 2] [m]."""
    nodes: np.ndarray
    """Displacement of the body's nodes, shape [N, 3] [m]."""
    node_slopes: np.ndarray
    """Its derivatives likewise, shape [N, 3, 2] [m]."""

    def predicted(self, change: np.ndarray) -> np.ndarray:
        """Displacement of the nodes with a change of relative compliance and ν, shape [N, 3] [m]."""
        return self.nodes + self.node_slopes @ change


def states_of(bench: Bench, rests: Sequence[Equilibrium], scale: float) -> list[State]:
    """Of simulated bodies, as they would be with all displacements so many times larger."""
    states: dict[int, State] = {}
    for rest in rests:
        if id(rest) in states:  # one press seen several times
            continue
        by_young, by_poisson = np.moveaxis(bench.slopes(rest), -1, 0)
        # E/a, of which ∂/∂a at 1 is -E ∂/∂E.
        slopes = np.stack([-float(np.mean(rest.material.young)) * by_young, by_poisson], axis=-1)
        on_skin = bench.skin.shares @ slopes.reshape(len(slopes), -1)
        moved = bench.skin.shares @ rest.displacement
        surface = scale * moved, scale * on_skin.reshape(-1, 3, 2)
        states[id(rest)] = State(*surface, scale * rest.displacement, scale * slopes)
    return [states[id(rest)] for rest in rests]


def _unknowns(which: int) -> np.ndarray:
    """Indices of what a palpation's points tell of, shape [8]."""
    return np.concatenate([[0, 1], np.arange(2 + 6 * which, 8 + 6 * which)])


class System:
    """Residuals with a change of (relative 1/E, ν) from what was simulated, linearised by it and every pose's six."""

    def __init__(
        self,
        bench: Bench,
        states: Sequence[State],
        change: np.ndarray,
        poses: Sequence[np.ndarray],
        poisson: float,
        chosen: Sequence[np.ndarray] | None = None,
    ) -> None:
        self.bench, self.states, self.change, self.poses, self.poisson = bench, states, change, list(poses), poisson
        self.chosen: list[np.ndarray] = []
        """Which points count, of each press [P]: the same ones until something is simulated again."""
        skin, triangles = bench.skin, bench.skin.triangles
        residuals, blocks, sinks, places = [], [], [], []
        for which, (state, pose) in enumerate(zip(states, poses, strict=True)):
            moved = state.moved + state.slopes @ change
            match, cosine = bench.matched(skin.vertices + moved, which, pose)
            self.chosen.append(bench.counting(match, cosine, which) if chosen is None else chosen[which])
            counts = self.chosen[which] & np.isfinite(match.distance) & (cosine > GRAZING / 2)
            if np.count_nonzero(counts) < 12:
                raise ValueError(
                    "fewer than 12 points lie on the surface beside the hole; give more, or a smaller hole."
                )
            along = match.normal[counts] / cosine[counts, None]
            met = match.at(triangles, skin.vertices + moved)[counts]
            by_material = -np.einsum("px,pxk->pk", along, match.at(triangles, state.slopes)[counts])
            # A sight turns about its eye together with its point: what moves is where it meets the surface.
            blocks.append(np.hstack([by_material, np.cross(met, along), along]))
            residuals.append(match.distance[counts])
            sinks.append((match.at(triangles, moved)[counts] * along).sum(axis=1))
            places.append(match.at(triangles, skin.vertices)[counts])
        self.residual, self.jacobian = np.concatenate(residuals), np.concatenate(blocks)
        """By the material's two and the six of the pose that a point was observed from, shape [R, 8]."""
        self.which = np.repeat(np.arange(len(states)), [len(block) for block in blocks])
        self.sinks, self.places = np.concatenate(sinks), np.concatenate(places)
        limit, size = OUTLIER * bench.noise, np.abs(self.residual)
        self.weight = np.minimum(1.0, limit / np.maximum(size, 1e-300))
        self.cost = float(np.mean(np.where(size < limit, size**2, limit * (2 * size - limit))))
        self.noise = float(np.sqrt(np.mean(self.weight * np.square(self.residual))))

    def solved(self) -> System:
        """By Gauss–Newton steps, without a simulation."""
        system, trust = self, 1.0
        for _ in range(INNER):
            step, sd = system.step()
            step = trust * step
            compliance = 1 + system.change[0]
            change = np.array(
                [
                    np.clip(compliance + step[0], compliance / FARTHEST, FARTHEST * compliance) - 1,
                    np.clip(system.change[1] + step[1], *self._bounds()),
                ]
            )
            poses = [turned(pose, part) for pose, part in zip(system.poses, step[2:].reshape(-1, 6), strict=True)]
            following = System(self.bench, self.states, change, poses, self.poisson, self.chosen)
            if following.cost > ROUGH * system.cost and trust > SHORTEST:
                trust /= 3
                continue
            moved, system, trust = change - system.change, following, min(1.0, 2 * trust)
            if (np.abs(moved) < CLOSE / 6 * sd).all():
                break
        return system

    def _bounds(self) -> tuple[float, float]:
        """Of ν's change."""
        return max(POISSON[0] - self.poisson, -WIDEST), min(POISSON[1] - self.poisson, WIDEST)

    def _normal(self) -> tuple[np.ndarray, np.ndarray]:
        """Normal matrix [U, U] and right-hand side [U], with what the tool tells of the poses.

        ν is as likely anywhere in its range: a normal prior would draw it to the middle, and with it raise E.
        """
        off = [0.0, 0.0]
        for pose, each in zip(self.poses, self.bench.palpations, strict=True):
            gone = pose @ np.linalg.inv(each.pose)
            turn = np.array([gone[2, 1] - gone[1, 2], gone[0, 2] - gone[2, 0], gone[1, 0] - gone[0, 1]]) / 2
            off += [*turn, *gone[:3, 3]]
        normal, right = np.diag(self._precision()), -self._precision() * off
        weighted = self.jacobian * (self.weight / self.noise**2)[:, None]
        for which in range(len(self.poses)):
            own, unknowns = self.which == which, _unknowns(which)
            normal[np.ix_(unknowns, unknowns)] += weighted[own].T @ self.jacobian[own]
            right[unknowns] -= weighted[own].T @ self.residual[own]
        return normal, right

    def _precision(self) -> np.ndarray:
        """What is known of the unknowns beforehand, shape [U]."""
        poses = [[each.pose_turn**-2] * 3 + [each.pose_shift**-2] * 3 for each in self.bench.palpations]
        return np.concatenate([[0.0, 0.0], *poses])

    def step(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss–Newton's, shape [U], of ν none where it would leave its range; sd of (log E, ν) by the noise, [2]."""
        normal, right = self._normal()
        sd = np.sqrt(np.diag(np.linalg.inv(normal))[:2])
        normal += np.diag(self._precision()) / STRIDE**2
        found = np.linalg.solve(normal, right)
        low, high = self._bounds()
        if (self.change[1] <= low and found[1] < 0) or (self.change[1] >= high and found[1] > 0):
            free = np.arange(len(right)) != 1
            found = np.zeros(len(right))
            found[free] = np.linalg.solve(normal[free][:, free], right[free])
        return found, sd

    def progress(self, young: float) -> Progress:
        """By the derivatives, from what was simulated with that E [Pa]."""
        return self.bench.progress(young / (1 + self.change[0]), self.poisson + self.change[1])

    def still(self) -> bool:
        """Whether what was simulated is as good."""
        sd = np.sqrt(np.diag(np.linalg.inv(self._normal()[0]))[:2])
        return bool((np.abs(self.change) < CLOSE * sd).all())

    def covariance(self, model_error: float) -> np.ndarray:
        """Of (log E, ν): the sensor's noise, and displacements that mesh and law have wrong by that share."""
        normal = self._normal()[0]
        normal[1, 1] += 12 / (POISSON[1] - POISSON[0]) ** 2  # nor can ν be farther off than its range lets it
        inverse = np.linalg.inv(normal)
        # Beyond so many points sums over pairs gain nothing: errors are correlated among neighbours.
        count = len(self.sinks)
        some = np.unique(np.linspace(0, count - 1, min(count, 800)).astype(int))
        own = inverse[:2, np.stack([_unknowns(which) for which in self.which[some]])]
        gain = np.einsum("isu,su->is", own, self.jacobian[some]) * self.weight[some] / self.noise**2
        reach = float(np.ptp(self.bench.skin.vertices, axis=0).max()) / 4
        apart = np.square(self.places[some, None] - self.places[None, some]).sum(axis=2)
        correlation = np.exp(-apart / (2 * reach**2))
        lever = gain * self.sinks[some] * (count / len(some))
        found = inverse[:2, :2] + model_error**2 * lever @ correlation @ lever.T
        sign = np.diag([-1.0, 1.0])  # log E falls as the compliance grows
        return sign @ found @ sign
