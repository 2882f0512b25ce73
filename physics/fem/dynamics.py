"""Motion of a body: implicit time steps, with mass-proportional damping and with a standard linear solid.

The trapezoidal rule, which is Newmark's with β = 1/4 and γ = 1/2 (Newmark 1959): of second order, stable at any step
where the law is linear, and then its energy balance holds to rounding. A standard linear solid adds to the law a
branch that relaxes, Q̇ + Q/τ = γ Ṡ with S the law's second Piola–Kirchhoff stress (Simo 1987; of law `linear` the stress
itself), integrated exactly for a stress that changes linearly within the step.

Derivatives along directions in the parameters are those of the discrete motion, exact: each time step is a smooth
equation, so one solve with its matrix at the solution carries them on (implicit function theorem).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from palpate.physics.fem.equilibrium import TOLERANCE, Energy, applied, settle
from palpate.physics.fem.laws import Material, Response
from palpate.physics.fem.linear_system import LinearSystem
from palpate.physics.fem.solid import Solid
from palpate.physics.load import Load


@dataclass(frozen=True)
class Relaxation:
    """A standard linear solid: stress under a held strain falls from 1 + ratio to 1 times the law's as e^(-t/time).

    Raises:
        ValueError: a number that is not positive.
    """

    ratio: float
    """γ, stiffness of the relaxing branch over the law's."""
    time: float
    """τ [s]."""

    def __post_init__(self) -> None:
        if not (self.ratio > 0 and self.time > 0):
            raise ValueError(f"a relaxation of ratio {self.ratio:g} and time {self.time:g} s; give positive numbers.")


@dataclass(frozen=True)
class Inertia:
    """What resists motion.

    Raises:
        ValueError: a density that is not positive, a negative damping.
    """

    density: float
    """[kg/m³]."""
    damping: float = 0.0
    """Force per momentum, mass-proportional (Rayleigh's α) [1/s]."""

    def __post_init__(self) -> None:
        if not self.density > 0 or not self.damping >= 0:
            raise ValueError(
                f"density {self.density:g}, damping {self.damping:g}; give a positive and no negative one."
            )


@dataclass(frozen=True, eq=False)
class Direction:
    """A way to change what a motion depends on: the derivative of each by one parameter; T steps, N nodes."""

    young: float = 0.0
    """Of log E, of every element the same."""
    damping: float = 0.0
    """Of Rayleigh's α [1/s]."""
    ratio: float = 0.0
    """Of a standard linear solid's γ."""
    time: float = 0.0
    """Of its τ [s]."""
    pattern: np.ndarray | None = None
    """Of the nodal forces of a step is this, shape [N, 3] [N], times `course`; None = none."""
    course: np.ndarray | None = None
    """Shape [T]."""

    def forces(self, step: int, nodes: int) -> np.ndarray:
        """Derivative of the nodal forces in a step, shape [nodes, 3] [N]."""
        if self.pattern is None or self.course is None:
            return np.zeros((nodes, 3))
        return self.course[step] * self.pattern


@dataclass(frozen=True, eq=False)
class Motion:
    """A body's motion; T steps, N nodes. Index 0 is the beginning."""

    displacement: np.ndarray
    """From rest, shape [T + 1, N, 3] [m]."""
    reaction: np.ndarray
    """Force on what is prescribed, shape [T, N, 3], zero elsewhere [N]: the mean over each time step, which rings where
    a grip's velocity jumps."""
    slopes: np.ndarray
    """Derivatives of the displacement along D directions, shape [T + 1, N, 3, D] [m]."""


def simulate(
    solid: Solid,
    material: Material,
    held: np.ndarray,
    load: Load,
    step: float,
    *,
    inertia: Inertia,
    force: float = 0.0,
    relaxation: Relaxation | None = None,
    directions: Sequence[Direction] = (),
    tolerance: float = TOLERANCE,
) -> Motion:
    """Follow a body under a load, from rest.

    Args:
        solid: the body.
        material: of which it is.
        held: components that don't move, shape [N, 3], bool.
        load: a press of `force`, or a grip whose displacement is from rest; its steps are the time steps.
        step: duration of one [s].
        inertia: density and damping.
        force: F of a press [N].
        relaxation: of a standard linear solid.
        directions: along which derivatives are wanted.
        tolerance: of the balance of forces, as `equilibrium.TOLERANCE`: a looser one saves time.

    Raises:
        ValueError: a step that is not positive.
        NoEquilibrium: a time step without a solution; take smaller ones.
    """
    if not step > 0:
        raise ValueError(f"a time step of {step:g} s; give a positive one.")
    nodes = len(solid.rest)
    now, velocity = np.zeros((nodes, 3)), np.zeros((nodes, 3))
    mass, damping = inertia.density * solid.mass, inertia.damping
    body = _Body(solid, material, mass, damping, step)
    quadratic = ((4 / step**2 + 2 * damping / step) * mass).tocsr()
    branch = None if relaxation is None else _Branch(body, relaxation, now)
    gripped = applied(load, nodes, 0)[0]
    free = ~(held | gripped)
    tangent = _Tangent(body, directions, free, relaxation) if directions else None

    def accelerating(acting: np.ndarray, at: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Forces that accelerate every node, shape [N, 3]."""
        stress = body.law(at).stress
        if branch is not None:
            stress = stress + body.pushed(solid.deformation(at), branch.extra)
        return acting - solid.forces(stress) - damping * _times(mass, speed)

    system, near = None, None
    balance = accelerating(np.zeros((nodes, 3)), now, velocity)
    moved, reactions = [now], []
    for index in range(load.steps):
        _, motion, acting = applied(load, nodes, index, force)
        past = 4 / step**2 * (now + step * velocity) + damping * (2 / step * now + velocity)
        outer = acting + balance + _times(mass, past)
        scale, history = (1.0, None) if branch is None else (branch.scale, branch.history)
        energy = Energy(solid, material, outer, quadratic, scale, history)
        if material.law == "linear" and system is None:
            inside = free.ravel()
            system = LinearSystem(energy.matrix(energy.response(now, tangent=True))[inside][:, inside].tocsr())
        after, _, near = settle(energy, now, np.where(gripped, motion, now), ~free, system, near, tolerance)
        if tangent is not None:
            tangent.advance(index, energy, now, velocity, after, branch, system or near)
        if branch is not None:
            branch.advance(after)
        before, past_balance = velocity, balance
        velocity = 2 / step * (after - now) - before
        balance = accelerating(acting, after, velocity)
        mean = _times(mass, (velocity - before) / step) - (past_balance + balance) / 2
        reactions.append(np.where(free, 0.0, mean))
        now = after
        moved.append(now)
    slopes = np.zeros((len(moved), nodes, 3, 0)) if tangent is None else np.stack(tangent.moved)
    return Motion(np.stack(moved), np.stack(reactions), slopes)


class _Body(NamedTuple):
    """What moves; names as in `simulate`."""

    solid: Solid
    material: Material
    mass: csr_array
    damping: float
    step: float

    def law(self, displacement: np.ndarray, tangent: bool = False) -> Response:
        """The law's own answer where the nodes are displaced [N, 3]."""
        return Energy(self.solid, self.material, np.zeros_like(displacement)).response(displacement, tangent)

    def pulled(self, gradient: np.ndarray, stress: np.ndarray) -> np.ndarray:
        """Second Piola–Kirchhoff stress of a first one [E, Q, 3, 3]; of law `linear` that itself."""
        return stress if self.material.law == "linear" else np.linalg.solve(gradient, stress)

    def pushed(self, gradient: np.ndarray, stress: np.ndarray) -> np.ndarray:
        """The other way round, of stresses [E, Q, 3, 3] or [E, Q, 3, 3, D]."""
        if self.material.law == "linear":
            return stress
        return np.matmul(gradient, stress.reshape(*stress.shape[:3], -1)).reshape(stress.shape)


class _Branch:
    """The relaxing branch of a standard linear solid; E elements, Q quadrature points."""

    def __init__(self, body: _Body, relaxation: Relaxation, displacement: np.ndarray) -> None:
        share, self.body = body.step / relaxation.time, body
        self.left = np.exp(-share)
        """Of the branch's stress after a time step."""
        self.gain = -relaxation.ratio * np.expm1(-share) / share
        """Stress of the branch per change of the law's within a time step."""
        self.by_time = self.left * share / relaxation.time, (self.gain - relaxation.ratio * self.left) / relaxation.time
        """Derivatives of both by τ [1/s]."""
        self.by_ratio = self.gain / relaxation.ratio
        """Derivative of `gain` by γ."""
        self.stress = self._law_stress(displacement)
        """The law's S, shape [E, Q, 3, 3] [Pa]."""
        self.extra = np.zeros_like(self.stress)
        """The branch's Q, likewise."""

    @property
    def scale(self) -> float:
        """What the law's stress is multiplied by within a time step."""
        return 1 + self.gain

    @property
    def history(self) -> np.ndarray:
        """What is added to it: Q as it decays, less the share of the stress that is no change."""
        return self.left * self.extra - self.gain * self.stress

    def advance(self, displacement: np.ndarray) -> None:
        """To the end of a time step, where the displacement is this [N, 3]."""
        stress = self._law_stress(displacement)
        self.extra = self.left * self.extra + self.gain * (stress - self.stress)
        self.stress = stress

    def _law_stress(self, displacement: np.ndarray) -> np.ndarray:
        return self.body.pulled(self.body.solid.deformation(displacement), self.body.law(displacement).stress)


class _Tangent:
    """Derivatives of a motion along D directions, carried on step by step; names as in `simulate`."""

    def __init__(
        self, body: _Body, directions: Sequence[Direction], free: np.ndarray, relaxation: Relaxation | None
    ) -> None:
        nodes, self.body, self.directions, self.free = len(body.solid.rest), body, directions, free
        parts = [(item.young, item.damping, item.ratio, item.time) for item in directions]
        self.young, self.by_damping, self.ratio, self.time = np.array(parts).T
        if relaxation is None and (self.ratio.any() or self.time.any()):
            raise ValueError("a direction changes a relaxation that there is none of; give one.")
        none = np.zeros((nodes, 3, len(directions)))
        self.moved = [none]
        """Of the displacement, one [N, 3, D] a step so far."""
        self.velocity, self.balance = none, none
        shape = (*body.solid.weights.shape, 3, 3, len(directions))
        self.stress, self.extra = np.zeros(shape), np.zeros(shape)
        """Of the branch's `stress` and `extra`, shape [E, Q, 3, 3, D]."""

    def advance(
        self,
        index: int,
        energy: Energy,
        now: np.ndarray,
        velocity: np.ndarray,
        after: np.ndarray,
        branch: _Branch | None,
        near: LinearSystem | None,
    ) -> None:
        """Over a time step that ends at the displacement `after` [N, 3]; the branch is still at its beginning."""
        body, (solid, _, mass, damping, step) = self.body, self.body
        acting = np.stack([item.forces(index, len(now)) for item in self.directions], axis=-1)
        past = 4 / step**2 * (self.moved[-1] + step * self.velocity)
        past = past + damping * (2 / step * self.moved[-1] + self.velocity)
        past = past + self.by_damping * (2 / step * (now - after) + velocity)[..., None]
        outer = acting + self.balance + _times(mass, past)
        gradient = solid.deformation(after)
        response = law = energy.response(after, tangent=True)
        if branch is not None:
            law = body.law(after, tangent=True)
        explicit = energy.scale * self.young * law.stress[..., None]
        if branch is not None:
            left, gain = branch.by_time[0] * self.time, branch.by_time[1] * self.time + branch.by_ratio * self.ratio
            change = gain * law.stress[..., None]
            history = left * branch.extra[..., None] + branch.left * self.extra
            history = history - gain * branch.stress[..., None] - branch.gain * self.stress
            explicit = explicit + change + body.pushed(gradient, history)
        right = (outer - self._forces(explicit)).reshape(-1, len(self.directions))
        inside = self.free.ravel()
        system = LinearSystem(energy.matrix(response)[inside][:, inside].tocsr(), near)
        flat = np.zeros_like(right)
        flat[inside] = system.solve(np.ascontiguousarray(right[inside]))
        moved = flat.reshape(*now.shape, -1)
        strained = self._deformation(moved)
        assert law.tangent is not None
        slope = np.matmul(law.tangent, strained.reshape(*strained.shape[:2], 9, -1)).reshape(strained.shape)
        slope = slope + self.young * law.stress[..., None]
        total = slope
        if branch is not None:
            stress, by_law = body.pulled(gradient, law.stress), slope
            if body.material.law != "linear":
                by_law = body.pushed(np.linalg.inv(gradient), slope - np.einsum("eqijd,eqjk->eqikd", strained, stress))
            extra = branch.left * branch.extra + branch.gain * (stress - branch.stress)
            slopes = left * branch.extra[..., None] + branch.left * self.extra
            slopes = slopes + gain * (stress - branch.stress)[..., None] + branch.gain * (by_law - self.stress)
            self.stress, self.extra = by_law, slopes
            total = slope + body.pushed(gradient, slopes)
            if body.material.law != "linear":
                total = total + np.einsum("eqijd,eqjk->eqikd", strained, extra)
        speed = 2 / step * (after - now) - velocity
        self.velocity = 2 / step * (moved - self.moved[-1]) - self.velocity
        drag = damping * self.velocity + self.by_damping * speed[..., None]
        self.balance = acting - self._forces(total) - _times(mass, drag)
        self.moved.append(moved)

    def _forces(self, stress: np.ndarray) -> np.ndarray:
        """Nodal forces of stresses [E, Q, 3, 3, D], shape [N, 3, D]."""
        return np.stack([self.body.solid.forces(part) for part in np.moveaxis(stress, -1, 0)], axis=-1)

    def _deformation(self, moved: np.ndarray) -> np.ndarray:
        """Of displacements [N, 3, D], shape [E, Q, 3, 3, D]."""
        parts = [self.body.solid.deformation(part) - np.eye(3) for part in np.moveaxis(moved, -1, 0)]
        return np.stack(parts, axis=-1)


def _times(mass: csr_array, values: np.ndarray) -> np.ndarray:
    """Mass times values [N, 3] or [N, 3, D]."""
    return (mass @ values.reshape(mass.shape[0], -1)).reshape(values.shape)
