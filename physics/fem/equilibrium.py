"""Equilibrium of a body under forces and prescribed displacements, with exact derivatives.

Newton's method on the potential energy with a backtracking line search (Nocedal & Wright 2006, algorithm 3.1) along
load steps that are halved where it fails. Derivatives come from the tangent at the solution (implicit function
theorem), by (E, ν) and by forces.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array, diags_array

from palpate.physics.fem.laws import Material, Response, respond
from palpate.physics.fem.linear_system import LinearSystem
from palpate.physics.fem.solid import Solid


class NoEquilibrium(ValueError):
    """Newton's method found none along the load."""


@dataclass(frozen=True, eq=False)
class Energy:
    """Potential energy of a body whose displacement is u: elastic(u) + ½ u·A·u - f·u."""

    solid: Solid
    material: Material
    forces: np.ndarray
    """f, shape [N, 3] [N]."""
    quadratic: csr_array | None = None
    """A, shape [3N, 3N] [N/m]: drag within a time step; None = none."""

    def response(self, displacement: np.ndarray, tangent: bool = False) -> Response:
        """Energy [J], stress and tangent of the material at every quadrature point."""
        gradient = self.solid.deformation(displacement)
        mu, lam = (np.broadcast_to(value, len(self.solid.elements))[:, None] for value in self.material.lame)
        return respond(self.material.law, gradient, mu, lam, tangent=tangent)

    def value(self, response: Response, displacement: np.ndarray) -> tuple[float, float]:
        """The energy, infinite where the law isn't defined, and what rounding may make of it [J]."""
        solid = self.solid
        elastic = float((solid.weights * response.energy).sum())
        flat = displacement.ravel()
        inertia = 0.0 if self.quadratic is None else 0.5 * float(flat @ (self.quadratic @ flat))
        outer = float((self.forces * displacement).sum())
        # Neo-Hookean energies are differences of terms of the size of μ.
        rounded = float((solid.volumes * self.material.lame[0]).sum())
        return elastic + inertia - outer, 1e-14 * (rounded + abs(elastic) + abs(inertia) + abs(outer))

    def out_of_balance(self, response: Response, displacement: np.ndarray) -> tuple[np.ndarray, float]:
        """Force that still accelerates every node, shape [N, 3], and the size of the forces that cancel in it [N]."""
        by_element = self.solid.element_forces(response.stress)
        inner, size = self.solid.gather(by_element), float(self.solid.gather(np.abs(by_element)).max())
        if self.quadratic is not None:
            inertia = (self.quadratic @ displacement.ravel()).reshape(-1, 3)
            inner, size = inner + inertia, max(size, float(np.abs(inertia).max()))
        return self.forces - inner, max(size, float(np.abs(self.forces).max()))

    def matrix(self, response: Response) -> csr_array:
        """Second derivatives of the energy, shape [3N, 3N] [N/m]."""
        assert response.tangent is not None
        found = self.solid.stiffness(response.tangent)
        return found if self.quadratic is None else (found + self.quadratic).tocsr()


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A body at rest under a load; N nodes, E elements."""

    energy: Energy
    """Energy that it minimises: body, material (with the name of its law) and forces."""
    displacement: np.ndarray
    """Displacement from rest, shape [N, 3] [m]."""
    held: np.ndarray
    """Mask of prescribed components, shape [N, 3], bool."""
    iterations: int
    """Newton steps that it took, over all load steps."""
    near: LinearSystem | None = None
    """Solution close by, whose factors help."""

    @property
    def material(self) -> Material:
        """Law and constants."""
        return self.energy.material

    @cached_property
    def response(self) -> Response:
        """Response of the material at every quadrature point, with its tangent."""
        return self.energy.response(self.displacement, tangent=True)

    @cached_property
    def reaction(self) -> np.ndarray:
        """Force that holds the prescribed components, shape [N, 3], zero elsewhere [N]."""
        return np.where(self.held, -self.energy.out_of_balance(self.response, self.displacement)[0], 0.0)

    @cached_property
    def _system(self) -> LinearSystem:
        free = ~self.held.ravel()
        return LinearSystem(self.energy.matrix(self.response)[free][:, free].tocsr(), self.near)

    @property
    def solver(self) -> LinearSystem | None:
        """Preconditioner for states close by: this state's system where it was needed, else what helped here."""
        return self.__dict__.get("_system", self.near)

    def moved_by(self, forces: np.ndarray) -> np.ndarray:
        """Derivatives of the displacement along K directions of the nodal forces, [N, 3, K] → [N, 3, K] [m/N]."""
        free = ~self.held.ravel()
        flat = forces.reshape(len(free), -1)
        found = np.zeros_like(flat, dtype=np.float64)
        found[free] = self._system.solve(np.ascontiguousarray(flat[free], np.float64))
        return found.reshape(*self.displacement.shape, -1)

    def tangents(self) -> np.ndarray:
        """Derivatives of the displacement by E (of a body with one) and ν, [N, 3, 2]."""
        material, solid = self.material, self.energy.solid
        slopes = (np.broadcast_to(value, len(solid.elements))[:, None] for value in material.lame_by_poisson)
        # The stress is linear in the Lamé constants, and these in E.
        by_young = solid.forces(self.response.stress) / np.mean(material.young)
        by_poisson = solid.forces(respond(material.law, solid.deformation(self.displacement), *slopes).stress)
        return self.moved_by(-np.stack([by_young, by_poisson], axis=-1))


def find_equilibrium(
    solid: Solid,
    material: Material,
    held: np.ndarray,
    *,
    motion: np.ndarray | None = None,
    forces: np.ndarray | None = None,
    start: np.ndarray | None = None,
    near: LinearSystem | None = None,
) -> Equilibrium:
    """Find the equilibrium of a body.

    Args:
        solid: the body.
        material: material of the body.
        held: mask of the prescribed components, shape [N, 3]; enough to keep the body in place.
        motion: their displacement, shape [N, 3] [m], other entries don't count; None = at rest.
        forces: on the nodes, shape [N, 3] [N]; None = none.
        start: displacement to begin at, shape [N, 3] [m]; None = rest.
        near: `Equilibrium.solver` of a state close by with the same components held, which saves time and changes
            nothing else.

    Raises:
        ValueError: shapes that don't fit, numbers that are not finite, nothing held.
        NoEquilibrium: none found, even with steps 2⁶ times smaller.
    """
    shape = solid.rest.shape
    given = (np.zeros(shape) if each is None else np.asarray(each, np.float64) for each in (motion, forces, start))
    motion, forces, begun = given
    for name, values in (("held", held), ("motion", motion), ("forces", forces), ("start", begun)):
        if np.shape(values) != shape:
            raise ValueError(f"{name} has shape {np.shape(values)}; give one row of three a node, {shape}.")
        if not np.isfinite(values).all():
            raise ValueError(f"{name} holds a number that is not finite.")
    if not held.any():
        raise ValueError("nothing is held, so nothing keeps the body in place; hold some nodes.")
    if np.size(material.young) not in (1, len(solid.elements)):
        raise ValueError(f"there are {np.size(material.young)} Young's moduli; give one, or {len(solid.elements)}.")
    none = Energy(solid, material, np.zeros(shape))
    resting = -none.out_of_balance(none.response(begun), begun)[0]
    displacement, iterations = begun, 0
    done, step, halvings = 0.0, 1.0, 0
    while done < 1:
        aim = 1.0 if done + step > 1 - 1e-9 else done + step
        energy = Energy(solid, material, resting + aim * (forces - resting))
        goal = np.where(held, begun + aim * (motion - begun), displacement)
        try:
            displacement, count, near = settle(energy, displacement, goal, held, near=near)
        except NoEquilibrium:
            step, halvings = step / 2, halvings + 1
            if halvings > 6:
                raise
            continue
        done, iterations = aim, iterations + count
    return Equilibrium(energy, displacement, held, iterations, near)


def settle(
    energy: Energy,
    displacement: np.ndarray,
    goal: np.ndarray,
    held: np.ndarray,
    near: LinearSystem | None = None,
    tolerance: float = 1e-10,
) -> tuple[np.ndarray, int, LinearSystem | None]:
    """Newton's method with a line search, the prescribed components first moved to their goal along with the rest.

    Args:
        energy: minimised energy.
        displacement: at the start, shape [N, 3].
        goal: displacement of the prescribed components, shape [N, 3].
        held: mask of the prescribed components, shape [N, 3].
        near: system of a state close by, whose factors help.
        tolerance: largest force out of balance, over the largest sum of the elements' forces at a node.

    Returns:
        Displacement, shape [N, 3], number of steps, and the last system solved.

    Raises:
        NoEquilibrium: it doesn't converge.
    """
    free = ~held.ravel()
    jump = np.where(held, goal - displacement, 0.0)
    moving = bool(jump.any())
    balanced = np.inf
    response = energy.response(displacement, tangent=True)
    for iteration in range(30):
        force, size = energy.out_of_balance(response, displacement)
        if not np.isfinite(size):
            problem = "an element is turned inside out, where the law isn't defined;"
            raise NoEquilibrium(f"{problem} give smaller load steps.")
        left = float(np.abs(force[~held]).max(initial=0.0))
        relative = left / size if size > 0 else 0.0
        if not moving and relative <= tolerance:
            return displacement, iteration, near
        right, matrix = force.ravel(), energy.matrix(response)
        right = right - matrix @ jump.ravel() if moving else right
        solver = LinearSystem(matrix[free][:, free].tocsr(), near)
        value, rounding = energy.value(response, displacement)
        # Accuracy of a Newton step that is solved iteratively: the outer iteration squares it away.
        path, accuracy = np.zeros(displacement.size), max(1e-3 * min(1.0, relative), 1e-13)
        path[free], slope, near = _downhill(right[free], solver, accuracy)
        whole = path.reshape(-1, 3) + (jump if moving else 0.0)
        if moving:  # the potential of another boundary can't be compared
            displacement, moving = displacement + whole, False
            response = energy.response(displacement, tangent=True)
            if not np.isfinite(energy.value(response, displacement)[0]):
                raise NoEquilibrium("the load step turns an element inside out; give smaller ones.")
            continue
        length = 1.0
        while True:
            trial = displacement + length * whole
            response = energy.response(trial, tangent=True)
            if energy.value(response, trial)[0] <= value + 1e-4 * length * slope + rounding:
                break
            length /= 2
            if length < 2.0**-12:
                if relative <= 1e3 * tolerance:  # as far as rounding lets it
                    return displacement, iteration, near
                raise NoEquilibrium("the line search ends nowhere; give smaller load steps.")
        displacement = trial
        if length == 1.0 and balanced <= 1e2 * tolerance and relative >= balanced / 2:
            return displacement, iteration + 1, near  # rounding: it comes no closer
        balanced = relative
    raise NoEquilibrium("no equilibrium within 30 Newton steps; give smaller load steps.")


def _downhill(right: np.ndarray, solver: LinearSystem, accuracy: float) -> tuple[np.ndarray, float, LinearSystem]:
    """A step of the free components along which the energy falls, its slope along that, and the system that gave it.

    Where Newton's own goes up, the matrix's diagonal is raised.

    Args:
        right: forces out of balance, shape [U].
        solver: solver of the matrix of the free components.
        accuracy: tolerance of `LinearSystem.solve`.

    Raises:
        NoEquilibrium: the matrix is singular.
    """
    matrix = solver.matrix
    for shift in (0.0, 1e-4, 1e-2, 1.0):
        if shift > 0:
            solver = LinearSystem((matrix + diags_array(shift * np.abs(matrix.diagonal()))).tocsr())
        try:
            path = solver.solve(right, accuracy)
        except RuntimeError as error:
            if shift == 0:
                continue
            raise NoEquilibrium("the matrix is singular: too little of the body is held.") from error
        slope = -float(right @ path)
        if slope < 0:
            break
    return path, slope, solver
