"""How fast the differentiable rollout is, against a plain torch version, NVIDIA Warp and Taichi.

    python -m benchmarks.rollout [--quick] [--output runs/bench/rollout]

Every contender runs in a process of its own and must give the baseline's trajectory and gradient before it is timed;
they take turns, so that all ratios come from one run. Only large settings see them one after the other, because they
wouldn't fit into memory together. Whoever needs too much of it (judged by the first setting's peak), fails, or computes
something else is left out, and a line says so. Warp and Taichi (`pip install -e ".[bench]"`) hold every step's state
for their tapes, which counts to their process, not to the memory above base. Warp's CPU backend has one thread.

Writes rollout.csv (medians; ratio = baseline / this), rollout_details.csv (with spreads and first calls) and
rollout.png. First calls are forward + gradient and forward; they find no compiled code in the first setting only.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import importlib.util
import os
import platform
import tempfile
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from torch import Tensor

from benchmarks.rollout_cases import GRID, Autograd
from benchmarks.rollout_contender import Contender, Failure, title
from benchmarks.rollout_plot import plot

COLUMNS = (
    "backend", "variant", "batch", "vertices", "threads",
    "forward_ms", "total_ms", "peak_mb", "forward_ratio", "total_ratio",
)  # fmt: skip
DETAILS = (*COLUMNS, "forward_min_ms", "forward_max_ms", "total_min_ms", "total_max_ms", "first_call_s", "rounds")
BASELINE = ("torch", "edges", 1)
SETTINGS = ((2, 1.0), (1, 1.0), (16, 1.0), (1, 2.0), (1, 4.0), (1, 16.0))
"""Batch and multiple of 14,800 vertices; the baseline's graph would fill the memory at both large."""
TOGETHER = 4
"""Batch times multiple up to which all contenders' processes are held at once."""
SHARE = 0.6
"""Share of the available memory that one contender may be expected to need."""
MEMORY = Path("/proc/meminfo")
UNPREDICTED = ("warp", "taichi")
"""Backends whose peak says nothing of a larger setting, because they allocate before it is measured."""

Name = tuple[str, str, int]
"""A contender's backend, variant and threads."""


class EdgeList(Autograd):
    """The baseline: springs as a list, positions gathered, forces scattered, gradients by torch's autograd."""

    def simulate(self, theta: Tensor) -> Tensor:
        """Trajectories of the contact vertices, shape [B, T, 3]."""
        mesh, contact, mechanics = self.task.mesh, self.task.contact, self.task.mechanics
        first, second = mesh.springs.unbind(1)
        touched = mesh.vertex_offsets[:-1] + contact.vertex
        stiffness, damping, force = theta[mesh.sample_of_vertex()].unsqueeze(2).unbind(1)
        free = (~mesh.rim).float().index_fill(0, touched, 1.0)[:, None]
        push = torch.zeros_like(mesh.vertices).index_copy(0, touched, contact.direction) * force
        rest_length = (mesh.vertices[second] - mesh.vertices[first]).norm(dim=1, keepdim=True)
        position, velocity, trajectory = mesh.vertices, torch.zeros_like(mesh.vertices), []
        for step in range(mechanics.steps):
            along = position[second] - position[first]
            length = along.norm(dim=1, keepdim=True)
            pull = stiffness[first] * (length - rest_length) * along / length
            total = torch.zeros_like(position).index_add(0, first, pull).index_add(0, second, -pull)
            if step < mechanics.load_steps:
                total = total + push
            kick = mechanics.time_step / mechanics.mass
            velocity = free * (velocity + kick * total) / (1 + kick * damping)
            position = position + mechanics.time_step * velocity
            trajectory.append((position - mesh.vertices)[touched])
        return torch.stack(trajectory, dim=1)


def contenders() -> list[Name]:
    """Backend, variant and threads of all that can run here, the baseline first."""
    ours = [("numba", variant) for variant in ("exact", "window", "field")] if importlib.util.find_spec("numba") else []
    ours.append(("torch", "stencil"))
    both = [(*name, threads) for name in (*ours, ("taichi", "tape")) for threads in (1, 2)]
    chosen = [BASELINE, *both, ("warp", "tape", 1)]
    return [name for name in chosen if name[0] not in ("warp", "taichi") or importlib.util.find_spec(name[0])]


def unfit(needs: dict[Name, float], size: float, available: float | None) -> dict[Name, str]:
    """Reasons to leave contenders out of a setting.

    Args:
        needs: their peaks [MB] for a batch times scale of 1; who isn't in it is let in.
        size: batch times scale.
        available: memory to be had [MB], or None where unknown, which lets everybody in.
    """
    if available is None:
        return {}
    return {
        name: f"it needs about {need * size / 1e3:.3g} GB of {available / 1e3:.3g} GB"
        for name, need in needs.items()
        if need * size > SHARE * available
    }


def needs_of(rows: list[dict[str, object]], size: float) -> dict[Name, float]:
    """Peaks [MB] for a batch times scale of 1, from the rows of a setting of another size, of whom they are known."""
    return {
        (row["backend"], row["variant"], row["threads"]): row["peak_mb"] / size
        for row in rows
        if row["peak_mb"] is not None and row["backend"] not in UNPREDICTED
    }


def available_memory() -> float | None:
    """Memory that processes can have [MB]; None where unknown."""
    try:
        line = next(line for line in MEMORY.read_text().splitlines() if line.startswith("MemAvailable"))
        return int(line.split()[1]) / 1024
    except (OSError, StopIteration):
        return None


class Setting:
    """One batch and mesh size, and who takes part."""

    def __init__(self, task: tuple, cache: Path, advance: Callable[[str], None], say: Callable[[str], None]) -> None:
        """Keep the arguments.

        Args:
            task: batch, scale and grid: arguments of `make_task`.
            cache: folder for the contenders' compiled code.
            advance: called with what is at work, once a contender.
            say: called with a line on everybody who is left out.
        """
        self.task, self.cache, self.advance, self.say = task, cache, advance, say
        self.size = task[0] * task[1]
        self.where = f"batch {task[0]}" + (f", {task[1]:g}× the vertices" if task[1] != 1 else "")
        self.baseline: Contender | None = None

    def measure(self, rounds: int, patience: float, needs: dict[Name, float]) -> list[dict[str, object]]:
        """Time who can take part and return their rows, the baseline's first; none where that can't.

        Args:
            rounds: times that each contender is timed; once at least.
            patience: a contender that took so long has no further round [s].
            needs: memory, as for `unfit`.
        """
        refused = unfit(needs, self.size, available_memory())
        for name, reason in refused.items():
            self.advance(self.where)
            self._leave_out(name, reason)
        names = [name for name in contenders() if name not in refused]
        if BASELINE not in names:
            self.say(f"{self.where}: left out, because there is nothing to compare with")
            return []
        groups = [names] if self.size <= TOGETHER else [[name] for name in names]
        rows = [row for group in groups for row in self._group(group, rounds, patience)]
        for row in rows:
            for key in ("forward", "total"):
                if row.get(f"{key}_ms"):
                    row[f"{key}_ratio"] = rows[0][f"{key}_ms"] / row[f"{key}_ms"]
        return rows

    def _group(self, names: list[Name], rounds: int, patience: float) -> list[dict[str, object]]:
        """Rows of contenders that run side by side and take turns."""
        running: list[Contender] = []
        rows: list[dict[str, object]] = []
        try:
            for name in names:
                self.advance(f"{self.where}: {title(name)}")
                with self._surviving(name, running):
                    running.append(Contender(name, self.task, self.cache))
                    self.baseline = self.baseline or running[-1]  # it comes first, and outlives its process here
                    running[-1].require_same(self.baseline)
            for _ in range(rounds):
                for contender in [each for each in running if each.wants_turn(patience)]:
                    with self._surviving(contender.name, running):
                        contender.turn()
            for contender in running.copy():
                with self._surviving(contender.name, running):
                    rows.append(contender.row(self.task[0]))
        finally:
            for contender in running:
                contender.stop()
        return rows

    @contextlib.contextmanager
    def _surviving(self, name: Name, running: list[Contender]) -> Iterator[None]:
        """Go on without a contender that fails, unless all others are compared with it."""
        try:
            yield
        except Failure as failure:
            if name == BASELINE:
                raise
            self._leave_out(name, failure.reason.partition("\n")[0])
            for contender in [each for each in running if each.name == name]:
                running.remove(contender)
                contender.stop()

    def _leave_out(self, name: Name, reason: str) -> None:
        self.say(f"{title(name)}: left out at {self.where}, {reason}")


def show(rows: list[dict[str, object]], machine: str) -> None:
    """Print the table."""
    table = Table(title=f"200-step rollout; {machine}; median (min–max); × against torch edges on one thread")
    for column in ("contender", "threads", "batch", "vertices", "forward ms", "×", "forward + gradient ms", "×",
                   "peak MB", "first call s"):  # fmt: skip
        table.add_column(column, justify="left" if column == "contender" else "right")
    for row in rows:
        cells = [f"{row['backend']} {row['variant']}", *(f"{row[key]:,}" for key in ("threads", "batch", "vertices"))]
        for key in ("forward", "total"):
            known = row.get(f"{key}_ms")
            spread = f" ({row[f'{key}_min_ms']:.1f}–{row[f'{key}_max_ms']:.1f})" if known else ""
            cells += [f"{known:.1f}{spread}" if known else "-", f"{row[f'{key}_ratio']:.1f}" if known else "-"]
        peak = "-" if row["peak_mb"] is None else f"{row['peak_mb']:.0f}"
        table.add_row(*cells, peak, f"{row['first_call_s']:.1f}")
    Console(width=150).print(table)


def write(path: Path, columns: tuple[str, ...], rows: list[dict[str, object]]) -> None:
    """Write rows as CSV, numbers with five digits; what isn't known stays empty."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        for row in rows:
            rounded = {key: f"{value:.5g}" if isinstance(value, float) else value for key, value in row.items()}
            writer.writerow(rounded)


def main(arguments: list[str] | None = None) -> None:
    """Measure, print the table, write the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a small mesh, one round: whether it works, no figures")
    parser.add_argument("--output", type=Path, default=Path("runs/bench/rollout"))
    parser.add_argument("--rounds", type=int, default=7, help="times that each contender is timed")
    parser.add_argument("--patience", type=float, default=5.0, help="no further round for one that took so long [s]")
    options = parser.parse_args(arguments)
    grid, settings, rounds = GRID, SETTINGS, options.rounds
    if options.quick:
        grid, settings, rounds = (24, 32), ((2, 1.0), (1, 6.0)), 1
    options.output.mkdir(parents=True, exist_ok=True)
    machine = f"{os.cpu_count()} cores {platform.machine()}, load {os.getloadavg()[0]:.1f}, {date.today()}"
    rows: list[dict[str, object]] = []
    bar = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with tempfile.TemporaryDirectory() as cache, Progress(*bar) as progress:
        job = progress.add_task("rollout", total=len(settings) * len(contenders()))

        def advance(text: str) -> None:
            progress.update(job, advance=1, description=text)

        def say(line: str) -> None:
            progress.console.print(line, markup=False, highlight=False, soft_wrap=True)

        needs: dict[Name, float] = {}
        for index, (batch, scale) in enumerate(settings):
            patience = options.patience * (1 if index else 4)  # the first setting is the one that is judged
            rows += Setting((batch, scale, grid), Path(cache), advance, say).measure(rounds, patience, needs)
            needs = needs or needs_of(rows, batch * scale)
            write(options.output / "rollout.csv", COLUMNS, rows)
            write(options.output / "rollout_details.csv", DETAILS, rows)
    show(rows, machine)
    plot(rows, options.output / "rollout.png", machine)
    print(f"written: {options.output}/rollout.csv, rollout_details.csv, rollout.png")


if __name__ == "__main__":
    main()
