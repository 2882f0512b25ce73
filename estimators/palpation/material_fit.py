"""Young's modulus and Poisson's ratio from forces and the deformed surfaces that they leave (Frank 2010, section VI).

The residual is the distance of a measured point from the simulated surface, along its normal, with what the tool hides
masked. `fit_material` is Gauss–Newton with exact derivatives by (1/E, ν) and by the sensors' poses, all at once: the
displacement is nearly linear in 1/E, so starts a factor of thirty off take two steps more. The paper's own descent:
`estimators/palpation/descent.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from estimators.palpation.registration import placed, register, thinned, turned
from estimators.palpation.skin import Match, Skin
from physics.fem import Equilibrium, Material, NoEquilibrium, find_equilibrium
from physics.fem.linear_system import LinearSystem

POISSON = (0.0, 0.495)
"""Range of ν that is looked at; below 0 no tissue lies, above it the elements lock."""
KNOWN = 0.025
"""A ν whose standard deviation is below this counts as determined: 95 % lie within 0.05."""
ROUNDS = 25
CLOSE = 0.15
"""Step of log E and ν over their standard deviations by the noise, that ends the fit."""
ROUGH = 1.02
"""By what factor the error may grow in a step: points change their triangles, which roughens it."""
SHORTEST = 0.01
"""Share of a step, below which none is tried."""
FARTHEST_STEP = 10.0
"""Factor by which a step changes E at most."""
CRUSHED = 0.03
"""Of the body's size: a start that the linear law would displace farther is made stiffer first."""
FACTORED = 60_000
"""Unknowns up to which a body's matrix is factorised for all of a fit's systems: some seconds and a gigabyte."""
OUTLIER = 3.0
"""Distances beyond this many standard deviations count by their size, not its square (Huber 1964)."""


@dataclass(frozen=True, eq=False)
class Palpation:
    """One press and what was seen of it; P points."""

    force: np.ndarray
    """Onto the body, in the body's frame, shape [3] [N]."""
    contact: np.ndarray
    """Where it acts, on the surface at rest, shape [3] [m]."""
    points: np.ndarray
    """Of the deformed surface, in the sensor's frame, shape [P, 3] [m]."""
    pose: np.ndarray
    """Of the sensor in the body's frame as the tool that carries it tells, shape [4, 4]."""
    tool_radius: float = 0.015
    """Of the patch on which the force acts [m]."""
    hole: float = 0.02
    """Around the contact, where points show the tool or its shadow and don't count [m]."""
    pose_shift: float = 0.005
    """Standard deviation of the pose's place [m]."""
    pose_turn: float = 0.03
    """Standard deviation of its direction [rad]."""


@dataclass(frozen=True)
class FitSettings:
    """How a fit sees its model."""

    law: str = "corotational"
    """Of `physics.fem.LAWS`: co-rotational is the paper's."""
    young: float = 1e4
    """E to begin at [Pa]."""
    poisson: float = 0.3
    """ν to begin at."""
    model_error: float = 0.02
    """By what share displacements of mesh and law are off, alike within a quarter of the body: what the covariance
    takes beside the sensor's noise."""


@dataclass(frozen=True, eq=False)
class MaterialFit:
    """What the palpations say; O of them."""

    young: float
    """[Pa]."""
    poisson: float
    covariance: np.ndarray
    """Of (log E, ν), shape [2, 2]; of `descend` not a number."""
    poses: list[np.ndarray]
    """Of the sensors, aligned, each of shape [4, 4]."""
    rests: list[Equilibrium]
    """The body under each force."""
    noise: float
    """Root mean square distance that is left [m]."""
    solves: int
    """Equilibria that were computed."""
    steps: int

    @property
    def young_sd(self) -> float:
        """Standard deviation of log E: relative."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def poisson_sd(self) -> float:
        """Standard deviation of ν."""
        return float(np.sqrt(self.covariance[1, 1]))

    @property
    def verdict(self) -> str:
        """Whether ν is `determined` too, or `young` alone."""
        return "determined" if self.poisson_sd < KNOWN else "young"


class Bench:
    """A body with its palpations, that counts what it simulates."""

    def __init__(self, skin: Skin, held: np.ndarray, palpations: Sequence[Palpation], law: str) -> None:
        self.skin, self.held, self.palpations, self.law = skin, held, palpations, law
        self.forces = [skin.pressed(each.contact, each.tool_radius, each.force) for each in palpations]
        self.solves = 0
        self.near: LinearSystem | None = None
        """Of a state of this body: its factors help with all others."""
        # By ICP with the surface at rest, of which the deformed part is what fits worst.
        self.poses = [register(thinned(each.points), skin.vertices, skin.triangles, each.pose) for each in palpations]
        apart = [
            np.abs(Match.of(placed(pose, each.points), skin.vertices, skin.triangles).distance)
            for pose, each in zip(self.poses, palpations, strict=True)
        ]
        self.noise = max(1.4826 * float(np.median(np.concatenate(apart))), 1e-6 * float(np.ptp(skin.vertices)))
        """Of the points along the normal, by what of them has not moved [m]."""

    def rest(self, young: float, poisson: float, starts: Sequence[np.ndarray | None]) -> list[Equilibrium]:
        found = []
        for forces, start in zip(self.forces, starts, strict=True):
            self.solves += 1
            material = Material(self.law, young, poisson)
            body, held = self.skin.body, self.held
            found.append(find_equilibrium(body, material, held, forces=forces, start=start, near=self.near))
            self.near = found[-1].solver
        return found

    def matched(self, rest: Equilibrium, which: int, pose: np.ndarray) -> tuple[np.ndarray, Match, np.ndarray]:
        """Points in the body's frame, their matches, and which count, shape [P]."""
        each = self.palpations[which]
        seen, vertices = placed(pose, each.points), self.skin.moved(rest.displacement)
        match = Match.of(seen, vertices, self.skin.triangles)
        place = match.at(self.skin.triangles, self.skin.vertices)
        away = beside_the_tool(place, each)
        # Noise carries points around a sharp edge one way only, which looks like a dent.
        away &= self.skin.from_creases(place) > OUTLIER * self.noise
        # Beyond a rim the closest place lies aside, not below.
        facing = np.abs(match.distance) >= 0.5 * match.apart
        return seen, match, away & (facing | (match.apart < OUTLIER * self.noise))

    def softest(self, young: float, poisson: float) -> float:
        """E, raised where the linear law would crush the body."""
        size = float(np.ptp(self.skin.vertices, axis=0).max())
        farthest = 0.0
        for forces in self.forces:
            self.solves += 1
            material = Material("linear", young, poisson)
            rest = find_equilibrium(self.skin.body, material, self.held, forces=forces, near=self.near)
            farthest = max(farthest, float(np.abs(rest.displacement).max()))
            if self.near is None and rest.solver is not None and rest.displacement.size < FACTORED:
                self.near = rest.solver
                _ = self.near.factors  # once, for all that are solved from here on
        return young * max(1.0, farthest / (CRUSHED * size))


def fit_material(
    skin: Skin,
    held: np.ndarray,
    palpations: Sequence[Palpation],
    settings: FitSettings = FitSettings(),
    told: Callable[[str], None] = lambda line: None,
) -> MaterialFit:
    """Fit E, ν and the poses.

    Args:
        skin: the surface at rest on its body.
        held: which components of the nodes are fixed, shape [N, 3], bool.
        palpations: one or several.
        settings: law and start.
        told: is given a line after every step.

    Raises:
        NoEquilibrium: the body can't bear the forces at any stiffness that was tried.
        ValueError: a contact off the surface, or too few points beside the hole.
    """
    bench = Bench(skin, held, palpations, settings.law)
    poses = bench.poses
    poisson = float(np.clip(settings.poisson, *POISSON))
    young = bench.softest(settings.young, poisson)
    nothing = np.zeros_like(skin.body.rest)
    rests = _reached(bench, young, poisson, [nothing] * len(palpations))
    young = float(np.mean(rests[0].material.young))
    told(f"start: E {young:.4g} Pa, ν {poisson:.3f}")
    trust, steps = 1.0, 0
    system = _System(bench, settings, rests, poses, poisson)
    for steps in range(1, ROUNDS + 1):
        step, sd = system.step()
        if (np.abs(step[:2]) < CLOSE * sd).all():
            break
        change = step * trust
        growth = float(np.clip(1 + change[0], 1 / FARTHEST_STEP, FARTHEST_STEP))
        aim = young / growth, float(np.clip(poisson + change[1], *POISSON))
        moved = [turned(pose, part) for pose, part in zip(poses, change[2:].reshape(-1, 6), strict=True)]
        try:
            tried = bench.rest(*aim, [growth * rest.displacement for rest in rests])
        except NoEquilibrium:
            try:
                tried = bench.rest(*aim, [rest.displacement for rest in rests])
            except NoEquilibrium:
                trust /= 3
                if trust < SHORTEST:
                    raise
                continue
        following = _System(bench, settings, tried, moved, aim[1])
        if following.cost > ROUGH * system.cost:
            trust /= 3
            if trust < SHORTEST:
                break
            continue
        trust = min(1.0, 2 * trust)
        (young, poisson), rests, poses, system = aim, tried, moved, following
        told(f"step {steps}: E {young:.4g} Pa, ν {poisson:.3f}, {1000 * system.noise:.3g} mm left")
    return MaterialFit(young, poisson, system.covariance(), poses, rests, float(system.noise), bench.solves, steps)


def _reached(bench: Bench, young: float, poisson: float, starts: Sequence[np.ndarray]) -> list[Equilibrium]:
    for _ in range(5):
        try:
            return bench.rest(young, poisson, starts)
        except NoEquilibrium:
            young *= 4
    return bench.rest(young, poisson, starts)


class _System:
    """Residuals at one place, linearised by (relative 1/E, ν, every pose's six)."""

    def __init__(
        self,
        bench: Bench,
        settings: FitSettings,
        rests: Sequence[Equilibrium],
        poses: Sequence[np.ndarray],
        poisson: float,
    ) -> None:
        self.settings, self.poses, self.bench, self.rests, self.poisson = settings, poses, bench, rests, poisson
        self.parts = [
            bench.matched(rest, which, pose) for which, (rest, pose) in enumerate(zip(rests, poses, strict=True))
        ]
        residuals = [match.distance[counts] for _, match, counts in self.parts]
        if min(map(len, residuals)) < 12:
            raise ValueError("fewer than 12 points lie on the surface beside the hole; give more, or a smaller hole.")
        self.residual = np.concatenate(residuals)
        limit = OUTLIER * bench.noise
        size = np.abs(self.residual)
        self.weight = np.minimum(1.0, limit / np.maximum(size, 1e-300))
        self.cost = float(np.mean(np.where(size < limit, size**2, limit * (2 * size - limit))))
        self.noise = float(np.sqrt(np.mean(self.weight * np.square(self.residual))))

    def linearised(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Jacobian of the residuals [R, 2 + 6·O], displacement along the normals [R] and places at rest [R, 3]."""
        triangles, skin = self.bench.skin.triangles, self.bench.skin
        blocks, sinks, places = [], [], []
        for which, (rest, (seen, match, counts)) in enumerate(zip(self.rests, self.parts, strict=True)):
            by_young, by_poisson = np.moveaxis(rest.tangents()[0], -1, 0)
            # Relative compliance a: E/a, so that ∂/∂a at 1 is -E ∂/∂E.
            by_compliance = -float(np.mean(rest.material.young)) * by_young
            normal = match.normal[counts]
            columns = [
                -(match.at(triangles, skin.shares @ slope)[counts] * normal).sum(axis=1)
                for slope in (by_compliance, by_poisson)
            ]
            block = np.zeros((len(normal), 2 + 6 * len(self.rests)))
            block[:, :2] = np.stack(columns, axis=1)
            block[:, 2 + 6 * which : 8 + 6 * which] = np.hstack([np.cross(seen[counts], normal), normal])
            blocks.append(block)
            sinks.append((match.at(triangles, skin.shares @ rest.displacement)[counts] * normal).sum(axis=1))
            places.append(match.at(triangles, skin.vertices)[counts])
        return np.concatenate(blocks), np.concatenate(sinks), np.concatenate(places)

    def _prior(self) -> tuple[np.ndarray, np.ndarray]:
        """Precision [U] and how far the unknowns are from their prior means [U].

        ν is as likely anywhere in its range: a normal prior would draw it to the middle, and with it raise E.
        """
        precision, off = [0.0, 0.0], [0.0, 0.0]
        for pose, each in zip(self.poses, self.bench.palpations, strict=True):
            gone = pose @ np.linalg.inv(each.pose)
            turn = np.array([gone[2, 1] - gone[1, 2], gone[0, 2] - gone[2, 0], gone[1, 0] - gone[0, 1]]) / 2
            off += [*turn, *gone[:3, 3]]
            precision += [each.pose_turn**-2] * 3 + [each.pose_shift**-2] * 3
        return np.array(precision), np.array(off)

    def step(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss–Newton's, shape [U], of ν none where it would leave its range; sd of (log E, ν) by the noise, [2]."""
        jacobian, _, _ = self.linearised()
        precision, off = self._prior()
        weight = self.weight[:, None] / self.noise**2
        normal = jacobian.T @ (weight * jacobian) + np.diag(precision)
        right = -((weight * jacobian).T @ self.residual + precision * off)
        free = np.ones(len(right), bool)
        found = np.linalg.solve(normal, right)
        if not POISSON[0] < self.poisson + found[1] < POISSON[1] and self.poisson in POISSON:
            free[1] = False
            found = np.zeros(len(right))
            found[free] = np.linalg.solve(normal[free][:, free], right[free])
        return found, np.sqrt(np.diag(np.linalg.inv(normal))[:2])

    def covariance(self) -> np.ndarray:
        """Of (log E, ν): the sensor's noise, and displacements that mesh and law have wrong by `model_error`."""
        jacobian, sinks, places = self.linearised()
        weight = self.weight[:, None] / self.noise**2
        precision = self._prior()[0]
        precision[1] = 12 / (POISSON[1] - POISSON[0]) ** 2  # nor can ν be farther off than its range lets it
        inverse = np.linalg.inv(jacobian.T @ (weight * jacobian) + np.diag(precision))
        gain = inverse[:2] @ (weight * jacobian).T
        # Beyond so many points sums over pairs gain nothing: errors are alike among neighbours.
        some = np.unique(np.linspace(0, len(sinks) - 1, min(len(sinks), 800)).astype(int))
        reach = float(np.ptp(self.bench.skin.vertices, axis=0).max()) / 4
        apart = np.square(places[some, None] - places[None, some]).sum(axis=2)
        alike = np.exp(-apart / (2 * reach**2))
        lever = gain[:, some] * sinks[some] * (len(sinks) / len(some))
        found = inverse[:2, :2] + self.settings.model_error**2 * lever @ alike @ lever.T
        sign = np.diag([-1.0, 1.0])  # log E falls as the compliance grows
        return sign @ found @ sign


def beside_the_tool(place: np.ndarray, palpation: Palpation) -> np.ndarray:
    """Which places on the surface at rest, shape [P, 3], the tool doesn't hide, shape [P], bool."""
    return np.linalg.norm(place - palpation.contact, axis=1) > palpation.hole


def surface_error(skin: Skin, rest: Equilibrium, palpation: Palpation, pose: np.ndarray) -> np.ndarray:
    """Squared distance of every point from the simulated surface, not a number where the hole masks it, shape [P] [m²].

    Frank 2010, equation 3.
    """
    match = Match.of(placed(pose, palpation.points), skin.moved(rest.displacement), skin.triangles)
    away = beside_the_tool(match.at(skin.triangles, skin.vertices), palpation)
    return np.where(away, np.square(match.apart), np.nan)
