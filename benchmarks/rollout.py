"""How fast the differentiable rollout is, against a plain torch version.

    python -m benchmarks.rollout

Every contender must give the baseline's trajectory and gradient before it is timed; they take turns, so that all ratios
come from one run. It takes 12 GB of memory.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import ctypes
import gc
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from rich.progress import track
from torch import Tensor

from palpate.benchmarks.shared import command_line, machine, print_table, timed
from palpate.physics.load import Press, held
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import Mesh, contact_normal, grid_mesh, nearest_vertex
from palpate.physics.msd import rollout

GRID = (120, 214)
"""Height and width of the network's depth grid [px]; the ellipse on it has 14,800 vertices, like the paper's meshes."""
SPACING = 0.0027
"""Distance of two pixels on tissue 0.5 scene units away, seen by a 60° camera [scene units]."""
BASELINE = "spring list"
NUMBA = ("numba exact", "numba window")
SETTINGS = {(2, 1): (1, 2), (1, 1): (1,), (16, 1): (2,), (1, 2): (1,), (1, 4): (1,), (1, 16): (1,)}
"""Threads of the contenders by batch and multiple of 14,800 vertices; the baseline has one thread."""
ROUNDS, PATIENCE = 7, 5e3
"""Times that a contender is timed, unless its turns took so long before [ms]."""
ALLOWED = {"trajectory": 1e-3, "gradient": 1e-2}
"""Largest difference from the baseline's, relative to the latter's peak: single precision over 200 steps."""


def pressed_sheet(scale: float, phase: float) -> tuple[Mesh, Press]:
    """A mesh of `scale` times as many vertices as the grid's, pressed in the middle."""
    height, width = (round(size * math.sqrt(scale)) for size in GRID)
    row, column = np.mgrid[:height, :width]
    z = 0.5 + 0.02 * np.sin(column / 31 + phase) + 0.01 * np.cos(row / 23)
    points = np.stack([(column - width / 2) * SPACING, (row - height / 2) * SPACING, z], -1)
    mesh = grid_mesh(points, ((row - height / 2) / height) ** 2 + ((column - width / 2) / width) ** 2 <= 0.4285**2)
    vertex, mechanics = nearest_vertex(mesh, points[height // 2, width // 2]), Mechanics()
    return mesh, Press.at(vertex, contact_normal(mesh, vertex), held(mechanics.load_steps, mechanics.steps))


@dataclass(frozen=True)
class Task:
    """A batch to roll out, and weights that make one number of its trajectories."""

    theta: Tensor
    """k_s, k_d and F near the paper's mean, shape [B, 3], float32."""
    meshes: list[Mesh]
    loads: list[Press]
    weights: Tensor
    """Derivative of the loss by the trajectories, shape [B, T, 3]."""


def make_task(batch: int, scale: float) -> Task:
    """B sheets that differ a little, each of `scale` times as many vertices as the grid's."""
    phases = 6 * np.random.default_rng(0).random(batch)
    meshes, loads = map(list, zip(*(pressed_sheet(scale, phase) for phase in phases), strict=True))
    return Task(
        theta=torch.tensor([[0.5, 0.09, -0.1]]) * (1 + 0.1 * torch.linspace(-1, 1, batch)[:, None]),
        meshes=meshes,
        loads=loads,
        weights=torch.randn(batch, loads[0].steps, 3, generator=torch.Generator().manual_seed(0)),
    )


def spring_list(task: Task, theta: Tensor) -> Tensor:
    """The baseline: springs as a list, positions gathered, forces scattered, gradients by torch's autograd."""
    mechanics, sizes = Mechanics(), [len(mesh.vertices) for mesh in task.meshes]
    starts = np.cumsum([0, *sizes[:-1]])
    springs = [mesh.springs + start for mesh, start in zip(task.meshes, starts, strict=True)]
    first, second = torch.from_numpy(np.concatenate(springs)).long().unbind(1)
    touched = torch.from_numpy(starts + [load.vertex for load in task.loads])
    rest = torch.from_numpy(np.concatenate([mesh.vertices for mesh in task.meshes]))
    rim = torch.from_numpy(np.concatenate([mesh.rim for mesh in task.meshes]))
    direction = torch.tensor(np.stack([load.direction for load in task.loads]), dtype=rest.dtype)
    stiffness, damping, force = theta.repeat_interleave(torch.tensor(sizes), 0).unsqueeze(2).unbind(1)
    free = (~rim).float().index_fill(0, touched, 1.0)[:, None]
    push = torch.zeros_like(rest).index_copy(0, touched, direction) * force
    rest_length = (rest[second] - rest[first]).norm(dim=1, keepdim=True)
    position, velocity, trajectory = rest, torch.zeros_like(rest), []
    kick = mechanics.time_step / mechanics.mass
    for step in range(mechanics.steps):
        along = position[second] - position[first]
        length = along.norm(dim=1, keepdim=True)
        pull = stiffness[first] * (length - rest_length) * along / length
        total = torch.zeros_like(position).index_add(0, first, pull).index_add(0, second, -pull)
        if step < mechanics.load_steps:
            total = total + push
        velocity = free * (velocity + kick * total) / (1 + kick * damping)
        position = position + mechanics.time_step * velocity
        trajectory.append((position - rest)[touched])
    return torch.stack(trajectory, dim=1)


def simulate(name: str, task: Task, theta: Tensor) -> Tensor:
    """Trajectories of the contact vertices as a contender computes them, shape [B, T, 3]."""
    if name == BASELINE:
        return spring_list(task, theta)
    mechanics = Mechanics(window_error=1e-4 if name == "numba window" else 0.0)
    return rollout(theta, task.meshes, task.loads, mechanics)


def forward(name: str, task: Task) -> np.ndarray:
    """Trajectories without a gradient, shape [B, T, 3]."""
    with torch.no_grad():
        return simulate(name, task, task.theta).numpy()


def total(name: str, task: Task) -> np.ndarray:
    """Gradient of Σ weights·trajectory by θ, shape [B, 3]."""
    theta = task.theta.clone().requires_grad_()
    (task.weights * simulate(name, task, theta)).sum().backward()
    return theta.grad.numpy()  # ty: ignore[missing-union-attribute]  after backward()


class Turn(NamedTuple):
    """What a contender computed once, and how long it took [ms]."""

    trajectory: np.ndarray
    gradient: np.ndarray
    forward: float
    total: float
    """Forward and gradient."""


def take_turn(name: str, threads: int, task: Task) -> Turn:
    """Roll out once with and once without gradient."""
    torch.set_num_threads(threads)
    (gradient, both), (trajectory, alone) = timed(total, name, task), timed(forward, name, task)
    return Turn(trajectory, gradient, alone, both)


def require_same(name: str, turn: Turn, baseline: Turn) -> None:
    """Refuse to time what computes something else.

    Raises:
        RuntimeError: trajectory or gradient differ from the baseline's.
    """
    for what, allowed in ALLOWED.items():
        found, expected = getattr(turn, what), getattr(baseline, what)
        difference = np.abs(found - expected).max() / np.abs(expected).max()
        if not difference <= allowed:
            raise RuntimeError(f"{name}: its {what} differs by {difference:.1e} from that of {BASELINE}.")


def memory_above(function: Callable[..., Any], *arguments: Any) -> float:
    """Most memory that a call takes above what the process held before [MB]; not a number where Linux' /proc isn't."""
    if not Path("/proc/self/clear_refs").exists():
        return math.nan
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")  # forgets the highest mark
    before = resident("VmRSS")
    function(*arguments)
    return resident("VmHWM") - before


def resident(key: str) -> float:
    """A memory figure of this process [MB]."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(key))
    return int(line.split()[1]) / 1024


def measure(batch: int, scale: float, threads: tuple[int, ...]) -> list[dict[str, Any]]:
    """Time the contenders and return their rows of the table, the baseline's first; medians, not a number = nothing.

    Raises:
        RuntimeError: a contender computes something else than the baseline.
    """
    task = make_task(batch, scale)
    contenders = [(BASELINE, 1), *itertools.product(NUMBA, threads)]
    turns: dict[tuple[str, int], list[Turn]] = {}
    for each in contenders:
        turns[each] = [take_turn(*each, task)]
        require_same(each[0], turns[each][0], turns[BASELINE, 1][0])
    for _ in range(ROUNDS):
        for each in contenders:
            if np.sum([turn[2:] for turn in turns[each][1:]]) < PATIENCE:
                turns[each].append(take_turn(*each, task))
    medians = {each: np.median([turn[2:] for turn in turns[each][1:]], axis=0) for each in contenders}
    return [
        {
            "contender": each[0],
            "threads": each[1],
            "batch": batch,
            "vertices": len(task.meshes[0].vertices),
            "forward [ms]": times[0],
            "forward ×": medians[BASELINE, 1][0] / times[0],
            "forward + gradient [ms]": times[1],
            "forward + gradient ×": medians[BASELINE, 1][1] / times[1],
            "memory above base [MB]": memory_above(take_turn, *each, task),
        }
        for each, times in medians.items()
    ]


def cell(value: float | str) -> str:
    """How a value of the table is written."""
    if isinstance(value, float):
        return "–" if math.isnan(value) else f"{value:,.1f}"
    return str(value)


def main() -> None:
    """Measure and print the table."""
    command_line(__doc__).parse_args()
    print(f"200-step rollout; {machine()}\n")
    settings = track(SETTINGS.items(), "batches and sizes")
    rows = [row for (batch, scale), threads in settings for row in measure(batch, scale, threads)]
    print_table([*rows[0]], ([cell(value) for value in row.values()] for row in rows))


if __name__ == "__main__":
    run_door(main)
