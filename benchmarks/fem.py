"""A body at rest, its tangents and its adjoint against element count, beside scikit-fem's own loop.

    python -m benchmarks.fem [--cells 6 10 16] [--rounds 3]

A cantilevered cube of five tetrahedra a cell sags under a force on its far face, by a third of its length. Every
entry is the best of its rounds: time on the clock, and of the processor, which other jobs lengthen less.
scikit-fem assembles the linear law and solves it with SciPy, as its examples do; its answer must be ours to 1e-6.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import skfem
from skfem.helpers import ddot, sym_grad, trace
from skfem.models.elasticity import lame_parameters

from palpate.benchmarks.shared import command_line, machine, print_table
from palpate.physics.fem.equilibrium import Equilibrium, find_equilibrium
from palpate.physics.fem.lattice import box
from palpate.physics.fem.laws import LAWS, Material
from palpate.physics.fem.solid import Solid, make_solid

YOUNG, POISSON, SHARE = 1e3, 0.4, 0.05
"""E [Pa], ν, and the force over E times the cube's face."""
COLUMNS = ("tetrahedra", "law", "Newton steps", "solve [s]", "tangents by (E, ν)", "tangents / solve", "adjoint")


def task(cells: int) -> tuple[Solid, np.ndarray, np.ndarray]:
    """A cube of so many cells along each side, what of it is held, and the forces on it."""
    body = make_solid(*box((1.0, 1.0, 1.0), (cells, cells, cells)))
    end, forces = np.isclose(body.rest[:, 0], 1), np.zeros_like(body.rest)
    forces[end, 2] = -SHARE * YOUNG / end.sum()
    return body, np.repeat(np.isclose(body.rest[:, :1], 0), 3, axis=1), forces


def best(work: Callable[[], Any], rounds: int) -> tuple[Any, tuple[float, float]]:
    """What a call returns, and its shortest time on the clock and of the processor [s]."""
    results, spent = [], []
    for _ in range(rounds):
        clock, processor = time.perf_counter(), time.process_time()
        results.append(work())
        spent.append((time.perf_counter() - clock, time.process_time() - processor))
    return results[-1], (min(clock for clock, _ in spent), min(processor for _, processor in spent))


def by_scikit_fem(body: Solid, held: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Displacement of the linear law, shape [N, 3]."""
    lam, mu = lame_parameters(YOUNG, POISSON)
    mesh = skfem.MeshTet(body.rest.T, body.elements.T)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP1()))

    @skfem.BilinearForm
    def stiffness(u, v, _):
        return lam * trace(sym_grad(u)) * trace(sym_grad(v)) + 2 * mu * ddot(sym_grad(u), sym_grad(v))

    order = np.empty(held.size, int)  # of our components among theirs
    order[basis.nodal_dofs.T.ravel()] = np.arange(held.size)
    fixed = np.flatnonzero(held.ravel()[order])
    system: Any = skfem.condense(stiffness.assemble(basis), forces.ravel()[order], D=fixed)
    found = skfem.solve(*system)
    return found[basis.nodal_dofs].T


def rows(cells: int, rounds: int) -> Iterator[list[str]]:
    """What is measured at one size."""

    def shown(spent: tuple[float, float]) -> str:
        return f"{spent[0]:.2f} ({spent[1]:.2f})"

    body, held, forces = task(cells)
    answers: dict[str, np.ndarray] = {}
    for law in LAWS:
        material = Material(law, YOUNG, POISSON)
        find_equilibrium(body, material, held, forces=forces)  # compiles
        found, solving = best(lambda material=material: find_equilibrium(body, material, held, forces=forces), rounds)
        answers[law] = found.displacement

        def anew(found: Equilibrium = found) -> Equilibrium:
            return Equilibrium(found.energy, found.displacement, held, found.iterations)

        _, slopes = best(lambda anew=anew: anew().tangents(), rounds)
        _, adjoint = best(lambda anew=anew, found=found: anew().gradient(found.displacement), rounds)
        ratio = f"{slopes[1] / solving[1]:.2f}"
        yield [
            str(len(body.elements)),
            law,
            str(found.iterations),
            shown(solving),
            shown(slopes),
            ratio,
            shown(adjoint),
        ]
    other, spent = best(lambda: by_scikit_fem(body, held, forces), rounds)
    off = np.abs(other - answers["linear"]).max() / np.abs(other).max()
    if off > 1e-6:
        raise RuntimeError(f"scikit-fem finds another displacement, off by {off:.1g} of the largest.")
    yield [str(len(body.elements)), "linear, scikit-fem", "1", shown(spent), "", "", ""]


def main() -> None:
    """Measure and print the table."""
    parser = command_line(__doc__)
    parser.add_argument("--cells", type=int, nargs="+", default=[6, 10, 16], help="cells along the cube")
    parser.add_argument("--rounds", type=int, default=3, help="of which the best counts")
    options = parser.parse_args()
    print(f"clock (processor) in seconds; {machine()}\n")
    print_table(COLUMNS, (row for cells in options.cells for row in rows(cells, options.rounds)))


if __name__ == "__main__":
    run_door(main)
