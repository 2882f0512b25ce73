"""A body on which tools pressed, simulated, and what their sensors saw of it (Frank 2010, sections V and VI-A)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.common.robust import median_sd
from palpate.data.source.sequence import moved
from palpate.estimators.palpation.registration import register, thinned
from palpate.estimators.palpation.skin import Match, Skin
from palpate.physics.fem import Equilibrium, Material, find_equilibrium
from palpate.physics.fem.linear_system import LinearSystem


@dataclass(frozen=True, eq=False)
class Palpation:
    """One press and what was observed of it; P points."""

    force: np.ndarray
    """Force onto the body, in the body's frame, shape [3] [N]."""
    contact: np.ndarray
    """Place where the force acts, on the surface at rest, shape [3] [m]."""
    points: np.ndarray
    """Points of the deformed surface, in the sensor's frame, in whose origin its eye is, shape [P, 3] [m]."""
    pose: np.ndarray
    """Pose of the sensor in the body's frame as the tool that carries it tells, shape [4, 4]."""
    tool_radius: float = 0.015
    """Radius of the patch on which the force acts [m]."""
    hole: float = 0.02
    """Radius around the contact within which points show the tool or its shadow and don't count [m]."""
    pose_shift: float = 0.005
    """Standard deviation of the pose's place [m]."""
    pose_turn: float = 0.03
    """Standard deviation of the pose's direction [rad]."""


class Bench:
    """A body with its palpations, that counts what it simulates."""

    outlier = 3.0
    """Distance beyond which a point counts by its size, not its square (Huber 1964) [standard deviations]."""
    grazing = 0.2
    """Cosine of the angle between sight and normal below which a place doesn't count: it constrains next to nothing."""

    def __init__(self, skin: Skin, held: np.ndarray, palpations: Sequence[Palpation]) -> None:
        self.skin, self.held, self.palpations = skin, held, palpations
        self.forces = [skin.pressed(each.contact, each.tool_radius, each.force) for each in palpations]
        self.solves = 0
        """Equilibria that were computed, those that failed included."""
        self.near: LinearSystem | None = None
        """State of this body whose factors help with all others."""
        # By ICP with the surface at rest, of which the deformed part is what fits worst.
        surface = skin.vertices, skin.triangles
        # A pose whose place is known better isn't registered: a flat surface would slide under the tool [m].
        # As in `registration`: motions that a body's facets alone show are the tool's to tell.
        known = [each.pose_shift < 5e-4 for each in palpations]
        given = [(thinned(each.points), surface, each.pose) for each in palpations]
        self.poses = [each[2] if sure else register(*each, shown=0.02) for sure, each in zip(known, given, strict=True)]
        self.eyes: list[bool] = []
        """True for palpations whose frame's origin sees the surface."""
        self.sights: list[np.ndarray] = []
        """Directions towards the sensor, in its frame, shape [P, 3] each."""
        apart = []
        for pose, each in zip(self.poses, palpations, strict=True):
            match = Match.of(moved(each.points, pose), *surface)
            normals = match.normal @ pose[:3, :3]
            back = -each.points / np.maximum(np.linalg.norm(each.points, axis=1, keepdims=True), 1e-300)
            self.eyes.append(bool(np.median((back * normals).sum(axis=1)) > 0))
            self.sights.append(back if self.eyes[-1] else normals)
            apart.append(np.abs(match.distance / np.maximum((self.sights[-1] * normals).sum(axis=1), self.grazing)))
        self.noise = max(median_sd(np.concatenate(apart)), 1e-6 * float(np.ptp(skin.vertices)))
        """Noise of the points along the sight, by what of them has not moved [m]."""

    def rests(self, material: Material, starts: Sequence[np.ndarray | None]) -> list[Equilibrium]:
        """Return the equilibria of the body under each force.

        Raises:
            NoEquilibrium: it can't bear one.
        """
        found: dict[bytes, Equilibrium] = {}
        for forces, start in zip(self.forces, starts, strict=True):
            if forces.tobytes() in found:  # one press seen several times
                continue
            self.solves += 1
            body, held = self.skin.body, self.held
            rest = find_equilibrium(body, material, held, forces=forces, start=start, near=self.near)
            # A larger matrix would take too many gigabytes to factorise.
            if self.near is None and (solver := rest.solver) is not None and body.rest.size < 60_000:
                _ = solver.factors  # once, for all that are solved from here on
            self.near = rest.solver
            found[forces.tobytes()] = rest
        return [found[forces.tobytes()] for forces in self.forces]

    def matched(self, vertices: np.ndarray, which: int, pose: np.ndarray) -> tuple[Match, np.ndarray]:
        """Match a palpation's sights with the surface in a state; return the cosines of their angles to it, too [P].

        A sensor errs along its sight: what is met there is what was observed, however far off the point came out. The
        closest place isn't, and is closer wherever the surface bends.
        """
        sights = self.sights[which] @ pose[:3, :3].T
        match = Match.along(moved(self.palpations[which].points, pose), sights, vertices, self.skin.triangles)
        return match, (match.normal * sights).sum(axis=1)

    def counting(self, match: Match, cosine: np.ndarray, which: int) -> np.ndarray:
        """Return the mask of the matched points that constrain the body, shape [P], bool."""
        place = match.at(self.skin.triangles, self.skin.vertices)
        counts = np.isfinite(match.distance) & (cosine > self.grazing) & beside_the_tool(place, self.palpations[which])
        # A pose that is a little off carries points around a sharp edge, where distances jump.
        return counts & (self.skin.from_creases(place) > self.outlier * self.noise)


def beside_the_tool(place: np.ndarray, palpation: Palpation) -> np.ndarray:
    """Return the mask of places on the surface at rest [P, 3] that the tool doesn't hide, shape [P], bool."""
    return np.linalg.norm(place - palpation.contact, axis=1) > palpation.hole


def surface_error(skin: Skin, rest: Equilibrium, palpation: Palpation, pose: np.ndarray) -> np.ndarray:
    """Return the squared distance of every point from the simulated surface, not a number where the hole masks it,
    shape [P] [m²].

    Frank 2010, equation 3.
    """
    match = Match.of(moved(palpation.points, pose), skin.moved(rest.displacement), skin.triangles)
    away = beside_the_tool(match.at(skin.triangles, skin.vertices), palpation)
    return np.where(away, np.square(match.apart), np.nan)
