"""The force on a body whose deformed surface is observed as points, its material known.

Frank 2010, section VI, with the residual linearised instead of differentiated numerically: points are matched with the
closest place of the simulated surface; their distance along its normal is explained by forces on the nodes where
something pulls, each its even share of a force and a normal part of its own; both are repeated until nothing changes.
Widths of noise and parts are those that the data make most likely (expectation maximisation; Bishop 2006, section
9.3.4).

What is observed depends on force over Young's modulus alone, so one fit answers for both.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from palpate.physics.fem import Equilibrium, Material, NoEquilibrium, Solid, find_equilibrium
from palpate.physics.fem.surface import nearest

STRAIN = 0.4
"""By how much a step of the fit may strain an element: beyond, its matches are others and its prediction is off."""
FREE = 100.0
"""Prior standard deviation of the even share's force over that of what a node adds."""
ROUNDS = 30
FAR = 0.002
"""How far a step may move a node until the derivatives are taken anew, where they change [m]."""
LEAST = 1e-12
"""Of a body's size, and of its stiffness times its size squared: noise and nodal forces below are rounding."""
CLOSE = 0.02
"""Change of the total force over its standard deviation, below which the fit is done."""


@dataclass(frozen=True, eq=False)
class SurfaceFit:
    """What a frame's points say; the total force's distribution is normal."""

    rest: Equilibrium
    """The body as fitted."""
    nodal: np.ndarray
    """Force on every pulled node, shape [G, 3] [N]."""
    force: np.ndarray
    """Mean of the total force, shape [3] [N]."""
    covariance: np.ndarray
    """Of it, shape [3, 3] [N²]."""
    noise: float
    """Standard deviation of the points along the surface's normal [m]."""
    slopes: np.ndarray
    """Displacement per component of every pulled node's force, shape [N, 3, 3G] [m/N]."""

    def along(self, direction: np.ndarray) -> tuple[float, float]:
        """Size along a known direction [3], given that the force has no other part: mean and standard deviation [N].

        Raises:
            ValueError: the direction has no length.
        """
        length = float(np.linalg.norm(direction))
        if not length:
            raise ValueError("a direction of no length is none; leave out frames without a force.")
        unit = direction / length
        weighted = np.linalg.solve(self.covariance, unit)
        precision = float(unit @ weighted)
        return float(weighted @ self.force) / precision, precision**-0.5

    @property
    def magnitude(self) -> tuple[float, float]:
        """Size of the total force: mean and standard deviation [N]."""
        size = float(np.linalg.norm(self.force))
        if not size:  # of no direction: along the least known one
            return 0.0, float(np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]))
        return size, float(np.sqrt(self.force @ self.covariance @ self.force)) / size


def fit_surface(
    body: Solid,
    material: Material,
    held: np.ndarray,
    motion: np.ndarray,
    pulled: np.ndarray,
    points: np.ndarray,
    before: SurfaceFit | None = None,
) -> SurfaceFit:
    """Fit the forces that pull a body into the shape of its points.

    Args:
        body: at rest.
        material: of which it is.
        held: which components are prescribed, shape [N, 3], bool.
        motion: where those are, from rest, shape [N, 3] [m].
        pulled: nodes on which something may pull, shape [G].
        points: of the deformed surface, shape [P, 3] [m].
        before: the fit of the frame before, to begin at.

    Raises:
        NoEquilibrium: a shape on the way could not be found.
    """
    force = np.zeros(3) if before is None else before.force
    nodal = np.tile(force / len(pulled), (len(pulled), 1))
    forces = np.zeros_like(body.rest)
    forces[pulled] = nodal
    start, near = (None, None) if before is None else (before.rest.displacement, before.rest.solver)
    rest = find_equilibrium(body, material, held, motion=motion, forces=forces, start=start, near=near)
    constant = material.law == "linear"
    slopes = before.slopes if before is not None and constant else _slopes(rest, pulled) if constant else None
    rest, nodal = _evenly(rest, nodal, pulled, points, slopes)
    size = float(np.ptp(body.rest, axis=0).max())
    least = LEAST * size, LEAST * float(np.mean(material.young)) * size**2
    noise = float(np.sqrt(np.mean(_residuals(rest, points, np.zeros((*rest.displacement.shape, 1)))[0] ** 2)))
    prior = float(np.linalg.norm(nodal.mean(axis=0))) / 10
    slopes = _slopes(rest, pulled) if slopes is None else slopes
    # An even share of a force of which nothing is known, and what every node adds to it.
    summed = np.tile(np.eye(3), (len(pulled), 1))
    parts = np.hstack([FREE / len(pulled) * summed, np.eye(3 * len(pulled))])
    trust, covariance = STRAIN, np.eye(3)
    for _ in range(ROUNDS):
        residual, jacobian = _residuals(rest, points, slopes)
        observed = residual + jacobian @ nodal.ravel()
        mean, root, noise, prior = _posterior(jacobian @ parts, observed, noise, prior, least)
        spread = summed.T @ parts @ root
        covariance = spread @ spread.T
        change = parts @ mean - nodal.ravel()
        moved = slopes @ change
        farthest = float(np.abs(moved).max())
        share = min(1.0, trust / _strain(body, moved))
        following = nodal + share * change.reshape(-1, 3)
        try:
            rest = _follow(rest, pulled, following, share * moved)
        except NoEquilibrium:
            trust /= 2
            if trust < STRAIN / 100:
                raise
            continue
        step, nodal = (following - nodal).sum(axis=0), following
        if share == 1 and (np.abs(step) < CLOSE * np.sqrt(np.diag(covariance))).all():
            break
        if farthest > FAR and not constant:
            slopes = _slopes(rest, pulled)
    return SurfaceFit(rest, nodal, nodal.sum(axis=0), covariance, noise, slopes)


def _evenly(
    rest: Equilibrium, nodal: np.ndarray, pulled: np.ndarray, points: np.ndarray, slopes: np.ndarray | None
) -> tuple[Equilibrium, np.ndarray]:
    """One force, shared out evenly, that brings the body close to its points, and where it rests then."""
    trust = STRAIN
    pulls = np.zeros((*rest.displacement.shape, 3))
    pulls[pulled] = np.eye(3) / len(pulled)
    known = None if slopes is None else slopes @ np.tile(np.eye(3) / len(pulled), (len(pulled), 1))
    for _ in range(ROUNDS):
        even = rest.moved_by(pulls) if known is None else known
        residual, jacobian = _residuals(rest, points, even)
        change = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        moved = even @ change
        farthest = float(np.abs(moved).max())
        share = min(1.0, trust / _strain(rest.energy.solid, moved))
        following = nodal + share * change / len(pulled)
        try:
            rest = _follow(rest, pulled, following, share * moved)
        except NoEquilibrium:
            trust /= 2
            if trust < STRAIN / 100:
                raise
            continue
        nodal = following
        if farthest < FAR / 10:
            break
    return rest, nodal


def _follow(rest: Equilibrium, pulled: np.ndarray, nodal: np.ndarray, moved: np.ndarray) -> Equilibrium:
    """Where a body rests under other forces [G, 3], given the linear prediction of how it moves [N, 3]."""
    energy, displacement = rest.energy, rest.displacement + moved
    forces = np.zeros_like(displacement)
    forces[pulled] = nodal
    if energy.material.law == "linear":  # the prediction is exact
        return Equilibrium(dataclasses.replace(energy, forces=forces), displacement, rest.held, 0)
    motion = np.where(rest.held, rest.displacement, 0.0)
    return find_equilibrium(
        energy.solid, energy.material, rest.held, motion=motion, forces=forces, start=displacement, near=rest.solver
    )


def _strain(body: Solid, moved: np.ndarray) -> float:
    """Largest change of a deformation gradient's entries."""
    return float(np.abs(body.deformation(moved) - np.eye(3)).max())


def _slopes(rest: Equilibrium, pulled: np.ndarray) -> np.ndarray:
    """Displacement per component of every pulled node's force, shape [N, 3, 3G] [m/N]."""
    forces = np.zeros((*rest.displacement.shape, len(pulled), 3))
    for axis in range(3):
        forces[pulled, axis, np.arange(len(pulled)), axis] = 1
    return rest.moved_by(forces.reshape(*rest.displacement.shape, -1))


def _residuals(rest: Equilibrium, points: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of points from the surface along its normal [P] [m]; less derivatives by the forces, [P, U] [m/N]."""
    body = rest.energy.solid
    faces = body.faces
    corners = (body.rest + rest.displacement)[faces]
    face, share = nearest(points, corners)
    place = np.einsum("pk,pkx->px", share, corners[face])
    one, two, three = corners[face].transpose(1, 0, 2)
    normal = np.cross(two - one, three - one)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    residual = ((points - place) * normal).sum(axis=1)
    weighted = (share[:, :, None] * normal[:, None, :]).reshape(len(points), 9)
    at = (3 * faces[face][:, :, None] + np.arange(3)).reshape(len(points), 9)
    flat = slopes.reshape(-1, slopes.shape[-1])
    return residual, np.einsum("pk,pku->pu", weighted, flat[at])


def _posterior(
    jacobian: np.ndarray, observed: np.ndarray, noise: float, prior: float, least: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Mean of the unknowns, a root of their covariance, widths of noise and prior, by expectation maximisation.

    Neither width falls below its `least`: of a body at rest both would be zero.
    """
    noise, prior = max(noise, least[0]), max(prior, least[1])
    left, sizes, right = np.linalg.svd(jacobian, full_matrices=False)
    projected, outside = left.T @ observed, float(np.sum(observed**2) - np.sum((left.T @ observed) ** 2))
    for _ in range(200):
        variance = 1 / (sizes**2 / noise**2 + 1 / prior**2)
        mean = variance * sizes * projected / noise**2
        missing = jacobian.shape[1] - len(sizes)
        left_over = max(outside, 0.0) + float(np.sum((projected - sizes * mean) ** 2 + sizes**2 * variance))
        following = max(float(np.sqrt(left_over / len(observed))), least[0])
        own = float(np.sqrt((np.sum(mean**2 + variance) + missing * prior**2) / jacobian.shape[1]))
        done, noise, prior = abs(following / noise - 1) < 1e-4, following, max(own, least[1])
        if done:
            break
    root = right.T * np.sqrt(variance)
    if jacobian.shape[1] > len(sizes):  # fewer points than unknowns
        root = np.hstack([root, prior * (np.eye(jacobian.shape[1]) - right.T @ right)])
    return right.T @ mean, root, noise, prior
