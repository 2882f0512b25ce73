"""Time of the rollout, beside the same equations in JAX on the whole mesh and on one that is cropped by hand.

    pip install "palpate[jax]"
    python -m benchmarks.rollout

A sheet is pressed at its middle, in single precision. The methods take turns, and the fastest turn of each counts.
Derivatives are those of the trajectory by k_s, k_d and F, by forward mode. JAX may use all cores; ours uses one.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import os
import platform
import timeit
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from functools import partial
from importlib.util import find_spec
from typing import Annotated, Any

import numpy as np
import pandas as pd

from benchmarks.harness import show
from palpate.common.options import options
from palpate.physics.load import Press, held
from palpate.physics.mechanics import RECOMMENDED, Mechanics
from palpate.physics.mesh import NORM_GUARD, Mesh, contact_normal, grid_mesh
from palpate.physics.msd.cone import Reach, window_radii
from palpate.physics.msd.simulation import simulate, simulate_sensitivities

EXACT, WINDOW = Mechanics(), Mechanics(window_error=1e-4)
"""The paper's integrator, for the exact rollout and for the window of training."""
THETA = np.array(RECOMMENDED.initial, np.float32)
"""k_s, k_d and F [normalised]."""

Pair = tuple[Callable[[], Any], Callable[[], Any]]
"""Functions that return the contact's path [T, 3], and that with its derivatives by θ [T, 3, 3]."""
Methods = dict[str, Pair]
"""Pairs by the name of their method."""


@dataclass(frozen=True)
class Rollouts:
    """Size of the sheet and number of turns."""

    rows: Annotated[int, 3, 2000] = 106
    """rows of vertices"""
    columns: Annotated[int, 3, 1000] = 140
    """columns of vertices"""
    turns: Annotated[int, 1, 10_000] = 20
    """turns of each method"""


def pressed_sheet(rows: int, columns: int) -> tuple[Mesh, Press]:
    """Return a wavy sheet and a press along the normal of its middle vertex."""
    row, column = np.mgrid[:rows, :columns]
    depth = 0.5 + 0.002 * np.sin(column / 3.1) + 0.001 * np.cos(row / 2.3)
    points = np.stack([0.005 * column, 0.005 * row, depth], axis=-1)
    mesh, middle = grid_mesh(points, np.ones((rows, columns), bool)), rows // 2 * columns + columns // 2
    return mesh, Press.at(middle, contact_normal(mesh, middle), held(EXACT.load_steps, EXACT.steps))


def ours(mesh: Mesh, load: Press) -> Methods:
    """Return the compiled rollouts."""
    given = [(name, (THETA, mesh, load, mechanics)) for name, mechanics in (("exact", EXACT), ("window", WINDOW))]
    return {name: (partial(simulate, *values), partial(simulate_sensitivities, *values)) for name, values in given}


def in_jax(mesh: Mesh, load: Press) -> Methods:
    """Return JAX's rollouts, on the whole mesh and on the part of it that the window's widest step needs."""
    row, column = mesh.pixels[load.vertex]
    used, _ = window_radii(float(THETA[0]), float(THETA[1]), WINDOW, load.steps, Reach())
    rows, columns = (slice(max(at - used.max() - 1, 0), at + used.max() + 2) for at in (row, column))
    whole = np.arange(len(mesh.vertices)).reshape(mesh.grid_shape)
    return {"JAX": _jax_rollout(mesh, load, whole), "JAX, cropped": _jax_rollout(mesh, load, whole[rows, columns])}


def _jax_rollout(mesh: Mesh, load: Press, part: np.ndarray) -> Pair:
    """Write equation 9 of Bini 2026 in JAX for vertices of a mesh that form a grid [H, W]."""
    import jax  # ty: ignore[import-not-found]
    import jax.numpy as jnp  # ty: ignore[import-not-found]

    rest, free, (height, width) = np.moveaxis(mesh.vertices[part], 2, 0), ~mesh.rim[part], part.shape
    row, column = np.argwhere(part == load.vertex)[0]
    push, factor = (np.asarray(values, np.float32) for values in (load.direction, load.factor))
    time_step, mass = EXACT.time_step, EXACT.mass

    def dot(one, two):  # a reduction would keep XLA from fusing
        return one[0] * two[0] + one[1] * two[1] + one[2] * two[2]

    def pull(moved):
        total = jnp.zeros_like(moved)
        for down, right in ((0, 1), (1, 0), (1, 1)):
            near, far = np.s_[:, : height - down, : width - right], np.s_[:, down:, right:]
            side, stretch = rest[far] - rest[near], moved[far] - moved[near]
            now = side + stretch
            length, before = jnp.sqrt(dot(now, now) + NORM_GUARD), np.sqrt(dot(side, side) + NORM_GUARD)
            force = dot(side + now, stretch) / ((length + before) * length) * now
            total = total.at[near].add(force).at[far].add(-force)
        return total

    def path(theta):
        stiffness, damping, force = theta
        keep = free / (1 + time_step * damping / mass)

        def step(state, share):
            moved, velocity = state
            total = (stiffness * pull(moved)).at[:, row, column].add(force * share * push)
            velocity = keep * (velocity + time_step / mass * total)
            moved = moved + time_step * velocity
            return (moved, velocity), moved[:, row, column]

        return jax.lax.scan(step, (jnp.zeros_like(rest), jnp.zeros_like(rest)), factor)[1]

    def tangents(theta):
        return jax.vmap(lambda axis: jax.jvp(path, (theta,), (axis,)), out_axes=(None, 2))(jnp.eye(3))

    def compiled(function):
        function = jax.jit(function)
        return lambda: jax.block_until_ready(function(THETA))

    return compiled(path), compiled(tangents)


def differences(methods: Methods) -> np.ndarray:
    """Largest difference of each method from the first, relative to the peak: the path's or a derivative's."""
    found = [(forward(), *derivatives()) for forward, derivatives in methods.values()]

    def relative(values: np.ndarray, others: np.ndarray) -> float:
        difference, peak = (np.abs(each).max(axis=(0, 1)) for each in (values - others, others))
        return float((difference / peak).max())

    return np.array([np.max([*map(relative, values, found[0])]) for values in found])


def main(arguments: list[str] | None = None) -> int:
    """Print the table; returns the exit status, 1 if a method's values differ by more than the window's threshold."""
    asked: Rollouts = options(Rollouts, arguments, "benchmarks.rollout", __doc__)
    mesh, load = pressed_sheet(asked.rows, asked.columns)
    methods = ours(mesh, load)
    if find_spec("jax"):
        methods |= in_jax(mesh, load)
    else:
        print("JAX is not installed; install 'palpate[jax]' to compare with it.\n")
    difference = differences(methods)  # compiles
    turns = [
        [[timeit.timeit(each, number=1) for each in pair] for pair in methods.values()] for _ in range(asked.turns)
    ]
    times = 1e3 * np.min(turns, axis=0)
    columns = "forward, ms", "derivatives, ms", "forward, × exact", "derivatives, × exact"
    frame = pd.DataFrame(np.hstack([times, times / times[0]]), columns=columns)
    frame.insert(0, "method", list(methods))
    machine = f"{os.cpu_count()} cores {platform.machine()}, {date.today()}"
    print(f"{len(mesh.vertices)} vertices, {load.steps} steps ({machine})\n")
    show(frame.assign(difference=difference))
    return int(not (difference <= WINDOW.window_error).all())


if __name__ == "__main__":
    run_door(main)
