"""How fast the differentiable rollout is, against a plain torch version.

    python -m benchmarks.rollout

Every contender has a process of its own, must give the baseline's trajectory and gradient, and is timed where it does;
they take turns, so that all ratios come from one run. Large settings see them one after the other, because torch's
graphs wouldn't fit into memory together. The table goes to the terminal, its picture to runs/bench/rollout.png.
"""

from __future__ import annotations

import argparse
import ctypes
import functools
import gc
import math
import multiprocessing
import os
import platform
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table
from torch import Tensor

from physics.load import Press, held
from physics.mechanics import Mechanics
from physics.mesh import contact_normal, grid_mesh, nearest_vertex
from physics.msd import MeshBatch, PressBatch, rollout, rollout_field

PICTURE = Path("runs/bench/rollout.png")
GRID = (120, 214)
"""Height and width of the network's depth grid [px]; the ellipse on it has 14,800 vertices, like the paper's meshes."""
SPACING = 0.0027
"""Distance of two pixels on tissue 0.5 scene units away, seen by a 60° camera [scene units]."""
BASELINE, STENCIL = "torch edges", "torch stencil"
NUMBA = ("numba exact", "numba window", "numba field")
SETTINGS = {(2, 1): (1, 2), (1, 1): (1,), (16, 1): (2,), (1, 2): (1,), (1, 4): (1,), (1, 16): (1,)}
"""Threads of the contenders by batch and multiple of 14,800 vertices; the baseline has one thread."""
SMALL = 4
"""Batch times multiple up to which all processes are held at once, and up to which the stencil's graph fits."""
ROUNDS, PATIENCE = 7, 5.0
"""Times that a contender is timed, unless its turns took so long before [s]."""
SAME_TRAJECTORY, SAME_GRADIENT = 1e-3, 1e-2
"""Largest difference from the baseline's, relative to the latter's peak: single precision over 200 steps."""


@dataclass(frozen=True)
class Task:
    """A batch to roll out, and weights that make one number of its trajectories."""

    theta: Tensor
    """k_s, k_d and F near the paper's mean, shape [B, 3], float32."""
    mesh: MeshBatch
    load: PressBatch
    weights: Tensor
    """Derivative of the loss by the trajectories, shape [B, T, 3]."""

    @property
    def touched(self) -> Tensor:
        """Contact vertices among the joined ones, shape [B]."""
        return self.mesh.vertex_offsets[:-1] + self.load.vertices


@functools.cache
def make_task(batch: int, scale: int, grid: tuple[int, int] = GRID) -> Task:
    """B meshes of `scale` times as many vertices as the grid's, pressed in the middle."""
    height, width = (round(size * math.sqrt(scale)) for size in grid)
    row, column = np.mgrid[:height, :width]
    valid = ((row - height / 2) / height) ** 2 + ((column - width / 2) / width) ** 2 <= 0.4285**2
    random = np.random.default_rng(0)
    mechanics = Mechanics()
    meshes, loads = [], []
    for _ in range(batch):
        phase = 6 * random.random()
        z = 0.5 + 0.02 * np.sin(column / 31 + phase) + 0.01 * np.cos(row / 23)
        points = np.stack([(column - width / 2) * SPACING, (row - height / 2) * SPACING, z], -1)
        meshes.append(grid_mesh(points, valid))
        vertex = nearest_vertex(meshes[-1], points[height // 2, width // 2])
        factor = held(mechanics.load_steps, mechanics.steps)
        loads.append(Press.at(vertex, contact_normal(meshes[-1], vertex), factor))
    return Task(
        theta=torch.tensor([[0.5, 0.09, -0.1]]) * (1 + 0.1 * torch.linspace(-1, 1, batch)[:, None]),
        mesh=MeshBatch.from_meshes(meshes),
        load=PressBatch.of(loads),
        weights=torch.randn(batch, mechanics.steps, 3, generator=torch.Generator().manual_seed(0)),
    )


def spring_list(task: Task, theta: Tensor) -> Tensor:
    """The baseline: springs as a list, positions gathered, forces scattered, gradients by torch's autograd."""
    mesh, mechanics = task.mesh, Mechanics()
    first, second = mesh.springs.unbind(1)
    stiffness, damping, force = theta[mesh.sample_of_vertex()].unsqueeze(2).unbind(1)
    free = (~mesh.rim).float().index_fill(0, task.touched, 1.0)[:, None]
    push = torch.zeros_like(mesh.vertices).index_copy(0, task.touched, task.load.direction) * force
    rest_length = (mesh.vertices[second] - mesh.vertices[first]).norm(dim=1, keepdim=True)
    position, velocity, trajectory = mesh.vertices, torch.zeros_like(mesh.vertices), []
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
        trajectory.append((position - mesh.vertices)[task.touched])
    return torch.stack(trajectory, dim=1)


def simulate(name: str, task: Task, theta: Tensor) -> Tensor:
    """Trajectories of the contact vertices as a contender computes them, shape [B, T, 3]."""
    if name == BASELINE:
        return spring_list(task, theta)
    if name == "numba field":
        field = rollout_field(theta, task.mesh, task.load, backend="numba")
        return field[:, task.touched].transpose(0, 1)
    mechanics = Mechanics(window_error=1e-4 if name == "numba window" else 0.0)
    return rollout(theta, task.mesh, task.load, mechanics, backend=name.split()[0])


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
    """What a contender computed once."""

    forward: float
    """[ms]"""
    total: float
    """Forward and gradient [ms]; not a number for the compiled whole field, which has no gradient."""
    trajectory: np.ndarray
    gradient: np.ndarray | None

    def require_same(self, other: Turn, name: str) -> None:
        """Refuse to time what computes something else.

        Raises:
            RuntimeError: trajectory or gradient differ from another contender's.
        """
        for what, allowed in (("trajectory", SAME_TRAJECTORY), ("gradient", SAME_GRADIENT)):
            seen, expected = getattr(self, what), getattr(other, what)
            if seen is None:
                continue
            difference = np.abs(seen - expected).max() / np.abs(expected).max()
            if not difference <= allowed:
                raise RuntimeError(f"{name}: its {what} differs by {difference:.1e} from that of {BASELINE}.")


def take_turn(name: str, threads: int, setting: tuple) -> Turn:
    """Roll out once with and once without gradient; `setting` are the arguments of `make_task`."""
    torch.set_num_threads(threads)
    task = make_task(*setting)
    gradient, both = None, math.nan
    if name != "numba field":
        gradient, both = timed(lambda: total(name, task))
    trajectory, alone = timed(lambda: forward(name, task))
    return Turn(alone, both, trajectory, gradient)


def timed(work: Callable[[], np.ndarray]) -> tuple[np.ndarray, float]:
    """A result, and how long it took [ms]."""
    start = time.perf_counter()
    result = work()
    return result, 1e3 * (time.perf_counter() - start)


def peak_memory(name: str, threads: int, setting: tuple) -> float:
    """Most memory that a turn takes above what this process held before [MB]; not a number where Linux' /proc isn't."""
    if not Path("/proc/self/clear_refs").exists():
        return math.nan
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")  # forgets the highest mark
    before = resident("VmRSS")
    take_turn(name, threads, setting)
    return resident("VmHWM") - before


def resident(key: str) -> float:
    """A memory figure of this process [MB]."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(key))
    return int(line.split()[1]) / 1024


def own_process() -> ProcessPoolExecutor:
    """A process for one contender, which ends before other work does where memory runs out."""
    return ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=_end_first)


def _end_first() -> None:
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


@dataclass
class Row:
    """Medians of one contender."""

    name: str
    threads: int
    batch: int
    vertices: int
    """Of one mesh."""
    forward: float
    total: float
    """[ms], not a number where there is no gradient."""
    first_call: float
    """Both together [s]."""
    memory: float
    """Above what was held before [MB]."""
    forward_ratio: float = 1.0
    total_ratio: float = 1.0
    """Times faster than the baseline."""


def measure(setting: tuple, threads: tuple[int, ...]) -> list[Row]:
    """Time the contenders and return their rows, the baseline's first; `setting` are the arguments of `make_task`.

    Raises:
        RuntimeError: a contender computes something else than the baseline.
        BrokenProcessPool: one was killed, most likely for lack of memory.
    """
    small = setting[0] * setting[1] <= SMALL
    names = (*NUMBA, STENCIL) if small else NUMBA
    contenders = [(BASELINE, 1), *((name, count) for name in names for count in threads)]
    firsts: dict[tuple[str, int], Turn] = {}
    rows: list[Row] = []
    for group in [contenders] if small else [[each] for each in contenders]:
        with ExitStack() as stack:
            ask = {each: functools.partial(_ask, stack.enter_context(own_process()), *each, setting) for each in group}
            for each in group:
                firsts[each] = ask[each](take_turn)
                firsts[each].require_same(firsts[BASELINE, 1], each[0])
            turns: dict[tuple[str, int], list[Turn]] = {each: [] for each in group}
            for _ in range(ROUNDS):
                for each in group:
                    if sum(turn.forward + np.nan_to_num(turn.total) for turn in turns[each]) < 1e3 * PATIENCE:
                        turns[each].append(ask[each](take_turn))
            for each in group:
                times = np.median([turn[:2] for turn in turns[each]], axis=0).tolist()
                first_call = np.nansum(firsts[each][:2]) / 1e3
                vertices = len(make_task(*setting).mesh.vertices) // setting[0]
                rows.append(Row(*each, setting[0], vertices, *times, first_call, ask[each](peak_memory)))
    for row in rows:
        row.forward_ratio, row.total_ratio = rows[0].forward / row.forward, rows[0].total / row.total
    return rows


def _ask(process: ProcessPoolExecutor, name: str, threads: int, setting: tuple, work: Callable):
    return process.submit(work, name, threads, setting).result()


def show(rows: list[Row], title: str) -> None:
    """Print the table."""
    table = Table(title=title)
    for column in ("contender", "threads", "batch", "vertices", "forward [ms]", "×", "forward + gradient [ms]", "×",
                   "memory above base [MB]", "first call [s]"):  # fmt: skip
        table.add_column(column, justify="left" if column == "contender" else "right")
    for row in rows:
        figures = (row.forward, row.forward_ratio, row.total, row.total_ratio, row.memory, row.first_call)
        cells = ["–" if math.isnan(figure) else f"{figure:,.1f}" for figure in figures]
        table.add_row(row.name, str(row.threads), str(row.batch), f"{row.vertices:,}", *cells)
    Console(width=150).print(table)


def plot(rows: list[Row], title: str, path: Path) -> None:
    """Draw speed at batch 2, and cost of one mesh against its vertices."""

    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    pair = [row for row in rows if row.batch == 2]
    places, ratios = np.arange(len(pair)), np.array([(row.forward_ratio, row.total_ratio) for row in pair])
    for column, label in enumerate(("forward", "forward + gradient")):
        bars = left.barh(places + 0.4 * column - 0.2, np.nan_to_num(ratios[:, column]), 0.38, label=label)
        texts = ["" if math.isnan(ratio) else f"{ratio:.3g}×" for ratio in ratios[:, column]]
        left.bar_label(bars, texts, padding=3, fontsize=8)
    left.set_yticks(places, [f"{row.name}, {row.threads} thr." for row in pair])
    left.invert_yaxis()
    left.set(xscale="log", xlabel=f"times faster than {BASELINE} on one thread", title="batch 2")
    left.set_xlim(0.5, 3 * np.nanmax(ratios))
    left.legend(loc="lower right")
    singles = [row for row in rows if row.batch == 1]
    for name in dict.fromkeys(row.name for row in singles):
        own = [row for row in singles if row.name == name]
        times = [row.forward if math.isnan(row.total) else row.total for row in own]
        right.loglog([row.vertices for row in own], times, "o-", label=name)
    vertices = sorted({row.vertices for row in singles})
    right.set_xticks(vertices, [f"{count:,}" for count in vertices])
    right.minorticks_off()
    right.set(xlabel="vertices", ylabel="forward + gradient [ms]; field: forward", title="batch 1, one thread")
    right.grid(alpha=0.3)
    right.legend(fontsize=8)
    figure.suptitle(title, fontsize=10)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Measure, print the table and draw the picture."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as compiled:
        os.environ["NUMBA_CACHE_DIR"] = compiled  # empty: the first call of a kind compiles
        for (batch, scale), threads in track(SETTINGS.items(), "batches and sizes"):
            try:
                rows += measure((batch, scale, GRID), threads)
            except BrokenProcessPool:
                print(f"batch {batch}, {scale} times the vertices: left out; a process was killed, short of memory.")
    title = f"200-step rollout; {os.cpu_count()} cores {platform.machine()}, {date.today()}"
    show(rows, title)
    plot(rows, title, PICTURE)
    print(f"written: {PICTURE}")


if __name__ == "__main__":
    main()
