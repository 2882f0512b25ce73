"""Gauss–Newton on points' distances from a simulated surface, by the material's constants and the sensors' poses.

Between two simulations displacements are linear in the former, and points are matched anew as often as it takes. Where
derivatives exist they are exact (`physics.fem.equilibrium`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.estimators.palpation.bench import Bench
from palpate.estimators.palpation.registration import turned
from palpate.physics.fem import Equilibrium, Material, NoEquilibrium

POISSON = (0.0, 0.495)
"""Range of ν that is looked at; below 0 no tissue lies, above it the elements lock."""


@dataclass(frozen=True, eq=False)
class State:
    """Motion of the body under a press, linearised around what was simulated."""

    moved: np.ndarray
    """Displacement of the surface's vertices, shape [V, 3] [m]."""
    slopes: np.ndarray
    """Derivatives of `moved` by relative compliance, E's inverse over that simulated, and by ν, shape [V, 3, 2] [m]."""
    nodes: np.ndarray
    """Displacement of the body's nodes, shape [N, 3] [m]."""
    node_slopes: np.ndarray
    """Derivatives of `nodes` by the same, shape [N, 3, 2] [m]."""

    def predicted(self, change: np.ndarray) -> np.ndarray:
        """Return the displacement of the nodes with a change of what `slopes` are by, [2], shape [N, 3] [m]."""
        return self.nodes + self.node_slopes @ change


def states_of(bench: Bench, rests: Sequence[Equilibrium], scale: float) -> list[State]:
    """Return states of simulated bodies, as they would be with all displacements so many times larger."""
    states: dict[int, State] = {}
    for rest in rests:
        if id(rest) in states:  # one press seen several times
            continue
        # E/a, of which ∂/∂a at 1 is -E ∂/∂E.
        slopes = rest.tangents() * np.array([-float(np.mean(rest.material.young)), 1.0])
        on_skin = bench.skin.shares @ slopes.reshape(len(slopes), -1)
        surface = scale * (bench.skin.shares @ rest.displacement), scale * on_skin.reshape(-1, 3, 2)
        states[id(rest)] = State(*surface, scale * rest.displacement, scale * slopes)
    return [states[id(rest)] for rest in rests]


def _unknowns(which: int) -> np.ndarray:
    """Return indices of the unknowns that a palpation's points constrain, two of the material and six of its pose,
    shape [8]."""
    return np.concatenate([np.arange(2), 2 + np.arange(6 * which, 6 + 6 * which)])


class System:
    """Residuals with a change of relative 1/E and ν from what was simulated, linearised by these and every pose's
    six."""

    close = 0.3
    """Change of log E and ν that needs no further simulation, over their standard deviations by the noise. It is made
    all the same, by the derivatives, and its square is left."""
    rough = 1.02
    """Factor by which the error may grow in a step: another choice of points roughens it."""
    shortest = 0.01
    """Share of a step below which none is tried."""

    def __init__(
        self,
        bench: Bench,
        states: Sequence[State],
        change: np.ndarray,
        poses: Sequence[np.ndarray],
        ends: tuple[float, float],
        chosen: Sequence[np.ndarray] | None = None,
    ) -> None:
        self.bench, self.states, self.change, self.poses, self.ends = bench, states, change, list(poses), ends
        self.chosen: list[np.ndarray] = []
        """Masks of the points that count, of each press [P]; the same until something is simulated again."""
        skin, triangles = bench.skin, bench.skin.triangles
        residuals, blocks, sinks, places = [], [], [], []
        for which, (state, pose) in enumerate(zip(states, poses, strict=True)):
            moved = state.moved + state.slopes @ change
            match, cosine = bench.matched(skin.vertices + moved, which, pose)
            self.chosen.append(bench.counting(match, cosine, which) if chosen is None else chosen[which])
            counts = self.chosen[which] & np.isfinite(match.distance) & (cosine > bench.grazing / 2)
            if np.count_nonzero(counts) < 12:
                raise ValueError("fewer than 12 surface points lie outside the hole; give more, or a smaller hole.")
            along = match.normal[counts] / cosine[counts, None]
            met = match.at(triangles, skin.vertices + moved)[counts]
            by_material = -np.einsum("px,pxk->pk", along, match.at(triangles, state.slopes)[counts])
            # A sight turns about its eye together with its point: what moves is where it meets the surface.
            blocks.append(np.hstack([by_material, np.cross(met, along), along]))
            residuals.append(match.distance[counts])
            sinks.append((match.at(triangles, moved)[counts] * along).sum(axis=1))
            places.append(match.at(triangles, skin.vertices)[counts])
        self.residual, self.jacobian = np.concatenate(residuals), np.concatenate(blocks)
        """Derivatives by the material's two unknowns and the six of a point's pose, shape [R, 8]."""
        self.which = np.repeat(np.arange(len(states)), [len(block) for block in blocks])
        self.sinks, self.places = np.concatenate(sinks), np.concatenate(places)
        limit, size = bench.outlier * bench.noise, np.abs(self.residual)
        self.weight = np.minimum(1.0, limit / np.maximum(size, 1e-300))
        self.cost = float(np.mean(np.where(size < limit, size**2, limit * (2 * size - limit))))
        self.noise = float(np.sqrt(np.mean(self.weight * np.square(self.residual))))
        self.precision = self.weight / self.noise**2
        """Weights of the residuals, shape [R] [1/m²]."""

    def solved(self) -> "System":
        """Take Gauss–Newton steps, without a simulation."""
        system, trust = self, 1.0
        for _ in range(20):
            step, sd = system.step()
            step = trust * step
            before = 1 + system.change[0]
            compliance = np.clip(before + step[0], before / 10, 10 * before)
            poisson = np.clip(system.change[1] + step[1], *self.ends)
            change, turns = np.array([compliance - 1, poisson]), step[2:].reshape(-1, 6)
            poses = [turned(pose, part) for pose, part in zip(system.poses, turns, strict=True)]
            following = System(self.bench, self.states, change, poses, self.ends, self.chosen)
            if following.cost > self.rough * system.cost and trust > self.shortest:
                trust /= 3
                continue
            moved, system, trust = change - system.change, following, min(1.0, 2 * trust)
            if (np.abs(moved) < self.close / 6 * sd).all():
                break
        return system

    def _normal(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the normal matrix [U, U] and right-hand side [U], with the tool's information on the poses.

        ν is as likely anywhere in its range: a normal prior would draw it to the middle, and with it raise E.
        """
        off = [0.0] * 2
        for pose, each in zip(self.poses, self.bench.palpations, strict=True):
            step = pose @ np.linalg.inv(each.pose)
            turn = np.array([step[2, 1] - step[1, 2], step[0, 2] - step[2, 0], step[1, 0] - step[0, 1]]) / 2
            off += [*turn, *step[:3, 3]]
        normal, right = np.diag(self._precision()), -self._precision() * off
        weighted = self.jacobian * self.precision[:, None]
        for which in range(len(self.poses)):
            own, unknowns = self.which == which, _unknowns(which)
            normal[np.ix_(unknowns, unknowns)] += weighted[own].T @ self.jacobian[own]
            right[unknowns] -= weighted[own].T @ self.residual[own]
        return normal, right

    def _precision(self) -> np.ndarray:
        """Return prior precisions of the unknowns, shape [U]."""
        poses = [[each.pose_turn**-2] * 3 + [each.pose_shift**-2] * 3 for each in self.bench.palpations]
        return np.concatenate([[0.0] * 2, *poses])

    def step(self) -> tuple[np.ndarray, np.ndarray]:
        """Return Gauss–Newton's step, shape [U], none where it would leave its range; sd of 1/E and ν by the noise,
        [2]."""
        normal, right = self._normal()
        sd = np.sqrt(np.diag(np.linalg.inv(normal))[:2])
        # Where the body leaves a pose open, as a ball its turns, facets pull it to and fro: a step moves it by a
        # tenth of its standard deviation.
        normal += np.diag(self._precision()) / 0.1**2
        found = np.linalg.solve(normal, right)
        (low, high), at = self.ends, self.change[1]
        free = np.ones(len(right), bool)
        free[1] = not ((at <= low and found[1] < 0) or (at >= high and found[1] > 0))
        if not free[1]:
            found = np.zeros(len(right))
            found[free] = np.linalg.solve(normal[free][:, free], right[free])
        return found, sd

    def still(self) -> bool:
        """Return whether the change is too small to need another simulation."""
        sd = np.sqrt(np.diag(np.linalg.inv(self._normal()[0]))[:2])
        return bool((np.abs(self.change) < self.close * sd).all())

    def covariance(self, model_error: float) -> np.ndarray:
        """Return the covariance of (log E, ν), by the sensor's noise and the share of displacements that the model gets
        wrong."""
        normal = self._normal()[0]
        normal[1, 1] += 12 / (POISSON[1] - POISSON[0]) ** 2  # nor can ν be farther off than its range lets it
        inverse = np.linalg.inv(normal)
        # Beyond so many points sums over pairs gain nothing: errors are correlated among neighbours.
        count = len(self.sinks)
        some = np.unique(np.linspace(0, count - 1, min(count, 800)).astype(int))
        own = inverse[:2, np.stack([_unknowns(which) for which in self.which[some]])]
        gain = np.einsum("isu,su->is", own, self.jacobian[some]) * self.precision[some]
        reach = float(np.ptp(self.bench.skin.vertices, axis=0).max()) / 4
        apart = np.square(self.places[some, None] - self.places[None, some]).sum(axis=2)
        correlation = np.exp(-apart / (2 * reach**2))
        lever = gain * self.sinks[some] * (count / len(some))
        found = inverse[:2, :2] + model_error**2 * lever @ correlation @ lever.T
        sign = np.diag([-1.0, 1.0])  # log E falls as the compliance grows
        return sign @ found @ sign


Fit = tuple[float, float, list[Equilibrium], System]
"""State of the iteration: E and ν as simulated last, the bodies, and the system solved from there."""


def ends(poisson: float) -> tuple[float, float]:
    """Return the range within which ν may change between two simulations."""
    return max(POISSON[0] - poisson, -0.15), min(POISSON[1] - poisson, 0.15)


def iterated(bench: Bench, begun: Fit, report: Callable[[str], None]) -> Fit:
    """Simulate and solve in turn.

    Args:
        bench: the body.
        begun: E [Pa], ν, and what is known so far, its steps not made yet; without bodies, by the linear law, to which
            there is no way back.
        report: as in `fit_material`.

    Raises:
        NoEquilibrium: as `fit_material`.
    """
    young, at, rests, system = begun
    found, steps, trust, stiffer = system.solved(), 0, 1.0, 1.0
    while True:
        aim = stiffer * young / (1 + trust * found.change[0]), at + trust * float(found.change[1])
        starts: list[np.ndarray | None] = [None] * len(bench.palpations)
        if rests:
            starts = [state.predicted(trust * found.change) for state in found.states]
        try:
            tried = bench.rests(Material("corotational", *aim), starts)
        except NoEquilibrium:
            if rests:
                trust /= 3
            else:  # no state to go back to, but a stiffer body bears more
                stiffer *= 4
            # Stiffer than that over the linear law's E, no equilibrium is searched.
            if trust < System.shortest or stiffer > 4.0**5:
                raise
            continue
        following = System(bench, states_of(bench, tried, 1.0), np.zeros(2), found.poses, ends(aim[1]))
        if rests and following.cost > System.rough * system.cost and trust > System.shortest:
            trust /= 3
            continue
        step = trust * found.change
        steps, stiffer = steps + 1, 1.0
        (young, at), rests, system = aim, tried, following
        found = system.solved()
        # Close to ν = 0.5 derivatives change with ν, and whole steps go to and fro.
        # Steps of which the next one takes back a quarter are halved.
        trust = trust / 2 if steps > 1 and step @ found.change < -0.25 * step @ step else 1.0
        report(f"step {steps}: E {young:.4g} Pa, ν {at:.3f}, {1000 * found.noise:.3g} mm left")
        if found.still() or steps == 15:
            return young, at, rests, found
