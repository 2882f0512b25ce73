"""A body on which tools pressed, simulated, and what their sensors saw of it (Frank 2010, sections V and VI-A)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from palpate.data.source.sequence import moved
from palpate.estimators.palpation.registration import register, thinned
from palpate.estimators.palpation.skin import Match, Skin, cover, shapes_at
from palpate.physics.fem import Equilibrium, Material, find_equilibrium, make_solid
from palpate.physics.fem.curved import bend
from palpate.physics.fem.laws import respond
from palpate.physics.fem.linear_system import LinearSystem
from palpate.physics.fem.meshing import refine
from palpate.physics.fem.solid import EDGES, EIGHTHS

FACTORED = 60_000
"""Unknowns up to which a body's matrix is factorised for all of a fit's systems, some seconds and a gigabyte, and up to
which a body is refined: beyond, a fit would take too long, and memory grows faster than the body."""
OUTLIER = 3.0
"""Distances beyond this many standard deviations count by their size, not its square (Huber 1964)."""
SHOWN = 0.02
"""As in `registration`: motions that a body's facets alone show are the tool's to tell."""
STOOD = 5e-4
"""A pose whose place is known better isn't registered: a flat surface would slide under the tool [m]."""
GRAZING = 0.2
"""Cosine of the angle between sight and normal below which a place doesn't count: there sight tells next to nothing."""


@dataclass(frozen=True, eq=False)
class Palpation:
    """One press and what was observed of it; P points."""

    force: np.ndarray
    """Onto the body, in the body's frame, shape [3] [N]."""
    contact: np.ndarray
    """Where it acts, on the surface at rest, shape [3] [m]."""
    points: np.ndarray
    """Of the deformed surface, in the sensor's frame, in whose origin its eye is, shape [P, 3] [m]."""
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


class Bench:
    """A body with its palpations, that counts what it simulates."""

    def __init__(
        self, skin: Skin, held: np.ndarray, palpations: Sequence[Palpation], law: str, widened: float = 1.0
    ) -> None:
        self.skin, self.held, self.palpations, self.law, self.widened = skin, held, palpations, law, widened
        self.forces = [skin.pressed(each.contact, each.tool_radius, each.force) for each in palpations]
        self.solves = 0
        """Equilibria that were computed, those that failed included."""
        self.stiffening = 0.0
        """b of the law whose stiffness grows by a factor e where the body is strained; 0 = it isn't looked for."""
        self.near: LinearSystem | None = None
        """Of a state of this body: its factors help with all others."""
        # By ICP with the surface at rest, of which the deformed part is what fits worst.
        surface = skin.vertices, skin.triangles
        self.poses = [
            each.pose if each.pose_shift < STOOD else register(thinned(each.points), surface, each.pose, shown=SHOWN)
            for each in palpations
        ]
        self.eyes, self.sights = [], []
        """Whether the frame's origin sees the surface; where sight comes from, in the sensor's frame, shape [P, 3]."""
        apart = []
        for pose, each in zip(self.poses, palpations, strict=True):
            match = Match.of(moved(each.points, pose), *surface)
            normals = match.normal @ pose[:3, :3]
            back = -each.points / np.maximum(np.linalg.norm(each.points, axis=1, keepdims=True), 1e-300)
            self.eyes.append(bool(np.median((back * normals).sum(axis=1)) > 0))
            self.sights.append(back if self.eyes[-1] else normals)
            apart.append(np.abs(match.distance / np.maximum((self.sights[-1] * normals).sum(axis=1), GRAZING)))
        self.noise = max(1.4826 * float(np.median(np.concatenate(apart))), 1e-6 * float(np.ptp(skin.vertices)))
        """Of the points along the sight, by what of them has not moved [m]."""

    @property
    def unknowns(self) -> int:
        """Of the material."""
        return 3 if self.stiffening else 2

    def watch_stiffening(self, rests: Sequence[Equilibrium]) -> None:
        """Count the growth of the stiffness by where bodies' energy is, of that under which most is."""
        means = []
        for rest in rests:
            shape = respond(self.law, rest.energy.solid.deformation(rest.displacement), np.ones(()), np.zeros(()))
            means.append(np.average(shape.energy, weights=shape.energy * rest.energy.solid.weights))
        self.stiffening = 1 / float(max(means))

    def refine(self) -> csr_array:
        """Go on with elements half as long, all of them where that isn't too many unknowns.

        Else those whose middle is closer to a contact than the tool's radius, or than they are long.
        They are divided as straight ones, in whose place the curved ones' own shape functions put the new nodes: the
        body stays as it is.

        Returns:
            of the nodes' values in those of the new ones, shape [N', N].

        Raises:
            ValueError: the unknowns would be more than FACTORED.
        """
        skin, coarse = self.skin, self.skin.body.elements[:, :4]
        straight = make_solid(skin.body.rest[: coarse.max() + 1], coarse, order=2)
        if 8 * skin.body.rest.size <= FACTORED:
            nodes, whole = straight.rest, np.repeat(np.arange(len(coarse)), 8)
            tetrahedra = skin.body.elements[:, EIGHTHS].reshape(-1, 4)
        else:
            corners = straight.rest[coarse]
            longest = np.linalg.norm(corners[:, EDGES[:, 0]] - corners[:, EDGES[:, 1]], axis=2).max(axis=1)
            apart = [np.linalg.norm(corners.mean(axis=1) - each.contact, axis=1) for each in self.palpations]
            radius = np.array([[each.tool_radius] for each in self.palpations])
            longest[(np.array(apart) > np.maximum(radius, longest)).all(axis=0)] = np.inf
            # Halves of an edge may be longer than half of it by rounding.
            nodes, tetrahedra, whole = refine(straight.rest[: coarse.max() + 1], coarse, (0.5 + 1e-9) * longest)
        fine = make_solid(nodes, tetrahedra, order=2)
        if fine.rest.size > FACTORED:
            raise ValueError(f"a finer mesh has {fine.rest.size} unknowns, more than {FACTORED}.")
        of = np.empty(len(fine.rest), np.int64)
        of[fine.elements] = whole[:, None]
        shares = shapes_at(straight, of, fine.rest)
        body = bend(fine, shares @ skin.body.rest - fine.rest)
        self.skin = cover(body, skin.vertices, skin.triangles, skin.shares.sum(axis=1) < 0.5)
        self.held = shares @ self.held > 1 - 1e-9
        self.forces = [self.skin.pressed(each.contact, each.tool_radius, each.force) for each in self.palpations]
        self.near = None
        return shares

    def rest(
        self, young: float, poisson: float, growth: float = 0.0, *, starts: Sequence[np.ndarray | None]
    ) -> list[Equilibrium]:
        """The body under each force.

        Raises:
            NoEquilibrium: it can't bear one.
        """
        return self._found(Material(self.law, young, poisson, self.stiffening * growth), starts)

    def linear(self, young: float, poisson: float) -> list[Equilibrium]:
        """The same by Hooke's law at small strain, where displacements go with 1/E."""
        return self._found(Material("linear", young, poisson), [None] * len(self.forces))

    def _found(self, material: Material, starts: Sequence[np.ndarray | None]) -> list[Equilibrium]:
        found: dict[bytes, Equilibrium] = {}
        for forces, start in zip(self.forces, starts, strict=True):
            if forces.tobytes() in found:  # one press seen several times
                continue
            self.solves += 1
            body, held = self.skin.body, self.held
            rest = find_equilibrium(body, material, held, forces=forces, start=start, near=self.near)
            if self.near is None and (solver := rest.solver) is not None and body.rest.size < FACTORED:
                _ = solver.factors  # once, for all that are solved from here on
            self.near = rest.solver
            found[forces.tobytes()] = rest
        return [found[forces.tobytes()] for forces in self.forces]

    def matched(self, vertices: np.ndarray, which: int, pose: np.ndarray) -> tuple[Match, np.ndarray]:
        """Where a palpation's sights meet the surface in a state, and the cosines of their angles to it [P].

        A sensor errs along its sight: what is met there is what was observed, however far off the point came out. The
        closest place isn't, and is closer wherever the surface bends.
        """
        sights = self.sights[which] @ pose[:3, :3].T
        seen = moved(self.palpations[which].points, pose)
        match = Match.along(seen, sights, vertices, self.skin.triangles)
        return match, (match.normal * sights).sum(axis=1)

    def counting(self, match: Match, cosine: np.ndarray, which: int) -> np.ndarray:
        """Which matched points tell of the body, shape [P], bool."""
        place = match.at(self.skin.triangles, self.skin.vertices)
        counts = np.isfinite(match.distance) & (cosine > GRAZING) & beside_the_tool(place, self.palpations[which])
        # A pose that is a little off carries points around a sharp edge, where distances jump.
        return counts & (self.skin.from_creases(place) > OUTLIER * self.noise)


def beside_the_tool(place: np.ndarray, palpation: Palpation) -> np.ndarray:
    """Which places on the surface at rest, shape [P, 3], the tool doesn't hide, shape [P], bool."""
    return np.linalg.norm(place - palpation.contact, axis=1) > palpation.hole


def surface_error(skin: Skin, rest: Equilibrium, palpation: Palpation, pose: np.ndarray) -> np.ndarray:
    """Squared distance of every point from the simulated surface, not a number where the hole masks it, shape [P] [m²].

    Frank 2010, equation 3.
    """
    match, away = _closest(skin, rest, palpation, pose)
    return np.where(away, np.square(match.apart), np.nan)


def surface_distance(skin: Skin, rest: Equilibrium, palpation: Palpation, pose: np.ndarray) -> np.ndarray:
    """The same with its sign, along the closest place's normal, positive outside, shape [P] [m]."""
    match, away = _closest(skin, rest, palpation, pose)
    return np.where(away, match.distance, np.nan)


def _closest(skin: Skin, rest: Equilibrium, palpation: Palpation, pose: np.ndarray) -> tuple[Match, np.ndarray]:
    match = Match.of(moved(palpation.points, pose), skin.moved(rest.displacement), skin.triangles)
    return match, beside_the_tool(match.at(skin.triangles, skin.vertices), palpation)


def across(palpation: Palpation, pose: np.ndarray) -> np.ndarray:
    """Points in the plane across the force, from the contact, shape [P, 2] [m]: x and y of a force along -z."""
    normal = -palpation.force / np.linalg.norm(palpation.force)
    first = np.eye(3)[int(np.abs(normal[0]) > 0.9)]
    first = first - (first @ normal) * normal
    first /= np.linalg.norm(first)
    return (moved(palpation.points, pose) - palpation.contact) @ np.stack([first, np.cross(normal, first)], axis=1)


def half_as_stiff(rest: Equilibrium) -> Equilibrium:
    """A body under the same forces with half of its Young's modulus: what an error by a factor of two looks like.

    Raises:
        NoEquilibrium: it can't bear them.
    """
    energy = rest.energy
    softer = replace(energy.material, young=energy.material.young / 2)
    start = 2 * rest.displacement
    return find_equilibrium(energy.solid, softer, rest.held, forces=energy.forces, start=start, near=rest.solver)
