"""How fast the differentiable rollout is, against a plain torch version, NVIDIA Warp and Taichi.

    python -m benchmarks.rollout [--quick] [--output runs/bench/rollout]

Every contender runs in a process of its own and must give the baseline's trajectory and gradient before it is timed;
they take turns, so that all ratios come from one run. Warp and Taichi (`pip install -e ".[bench]"`) hold every step's
state for their tapes, which counts to their process, not to the memory above base. Warp's CPU backend has one thread.

Writes rollout.csv (medians; ratio = baseline / this), rollout_details.csv (with spreads and first calls) and
rollout.png. First calls are forward + gradient and forward; they find no compiled code in the first setting only.
"""

from __future__ import annotations

import argparse
import csv
import importlib.util
import multiprocessing
import os
import platform
import statistics
import tempfile
import time
from datetime import date
from pathlib import Path
from unittest import mock

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from torch import Tensor

from benchmarks.rollout_cases import GRID, Autograd
from benchmarks.rollout_plot import plot
from benchmarks.rollout_worker import serve

COLUMNS = (
    "backend", "variant", "batch", "vertices", "threads",
    "forward_ms", "total_ms", "peak_mb", "forward_ratio", "total_ratio",
)  # fmt: skip
DETAILS = (*COLUMNS, "forward_min_ms", "forward_max_ms", "total_min_ms", "total_max_ms", "first_call_s", "rounds")
BASELINE = ("torch", "edges", 1)
SETTINGS = ((2, 1.0), (1, 1.0), (16, 1.0), (1, 2.0), (1, 4.0), (1, 16.0))
"""Batch and multiple of 14,800 vertices; the baseline's graph would fill the memory at both large."""
SLOW = 5.0
"""First call from which on a contender's memory is measured together with its time [s]."""
SAME_TRAJECTORY, SAME_GRADIENT = 1e-3, 1e-2
"""Largest difference from the baseline's, relative to the latter's peak: single precision over 200 steps."""


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


def contenders() -> list[tuple[str, str, int]]:
    """Backend, variant and threads of all that can run here, the baseline first."""
    ours = [("numba", variant) for variant in ("exact", "window", "field")] if importlib.util.find_spec("numba") else []
    ours.append(("torch", "stencil"))
    both = [(*name, threads) for name in (*ours, ("taichi", "tape")) for threads in (1, 2)]
    chosen = [BASELINE, *both, ("warp", "tape", 1)]
    return [name for name in chosen if name[0] not in ("warp", "taichi") or importlib.util.find_spec(name[0])]


class Contender:
    """One contender's process."""

    def __init__(self, name: tuple[str, str, int], setting: tuple, cache: Path) -> None:
        """Start it and let it make its first calls.

        Raises:
            RuntimeError: it failed.
        """
        self.name = name
        self.forward: list[float] = []
        self.total: list[float] = []
        self.spent = 0.0
        self.peak: float | None = None
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        own = cache / "-".join(map(str, name))
        # Before it starts: a spawned process imports this module, and numba with it, before it runs anything.
        self.process = context.Process(target=serve, args=(other, name, setting), daemon=True)
        with mock.patch.dict(os.environ, NUMBA_CACHE_DIR=str(own / "numba"), WARP_CACHE_PATH=str(own / "warp")):
            self.process.start()
        other.close()
        self.vertices, self.first_call, self.trajectory, self.gradient = self._receive()

    def _receive(self):
        try:
            answer = self.connection.recv()
        except EOFError:
            answer = f"it ended with status {self.process.exitcode}"
        if isinstance(answer, str):
            raise RuntimeError(f"{' '.join(map(str, self.name))}: {answer}")
        return answer

    def ask(self, what: str):
        """Let it measure."""
        self.connection.send(what)
        return self._receive()

    def turn(self) -> None:
        """Time it once."""
        start = time.perf_counter()
        # Whoever is slow is measured only once, with its memory.
        self.peak, forward, total = self.ask("memory and times" if self.first_call > SLOW else "times")
        self.spent += time.perf_counter() - start
        self.forward.append(forward)
        if total is not None:
            self.total.append(total)

    def require_same(self, baseline: Contender) -> None:
        """Refuse to time what computes something else.

        Raises:
            RuntimeError: trajectory or gradient differ from the baseline's.
        """
        for what, seen, expected, allowed in (
            ("trajectory", self.trajectory, baseline.trajectory, SAME_TRAJECTORY),
            ("gradient", self.gradient, baseline.gradient, SAME_GRADIENT),
        ):
            if seen is None:
                continue
            difference = (np.abs(seen - expected) / np.abs(expected).max()).max()
            if not difference <= allowed:
                raise RuntimeError(f"{' '.join(map(str, self.name))}: its {what} differs by {difference:.1e}.")

    def row(self, batch: int) -> dict[str, object]:
        """Medians and spreads; no ratios yet."""
        if self.first_call <= SLOW:
            self.peak = self.ask("memory and times")[0]
        row: dict[str, object] = dict(zip(("backend", "variant", "threads"), self.name, strict=True))
        row |= {"batch": batch, "vertices": self.vertices // batch, "peak_mb": self.peak}
        row |= {"first_call_s": self.first_call, "rounds": len(self.forward)}
        for key, values in (("forward", self.forward), ("total", self.total)):
            if values:
                row |= {f"{key}_ms": statistics.median(values)}
                row |= {f"{key}_min_ms": min(values), f"{key}_max_ms": max(values)}
        return row

    def stop(self) -> None:
        """End the process."""
        if self.process.is_alive():
            self.connection.send("stop")
        self.process.join(10)
        self.process.terminate()


def measure(setting: tuple, rounds: int, patience: float, cache: Path, advance) -> list[dict[str, object]]:
    """Time all contenders in turns on one setting (batch, scale, grid) and return their rows.

    Args:
        setting: arguments of `make_task`.
        rounds: times that each contender is timed; once at least, and no more after `patience` seconds.
        cache: folder for the contenders' compiled code.
        advance: called once a contender.
    """
    running: list[Contender] = []
    try:
        for name in contenders():
            running.append(Contender(name, setting, cache))
            running[-1].require_same(running[0])
            advance(f"batch {setting[0]}, {setting[1]:g}×: {name[0]} {name[1]}")
        for _ in range(rounds):
            for contender in running:
                if not contender.forward or contender.spent < patience:
                    contender.turn()
        rows = [contender.row(setting[0]) for contender in running]
    finally:
        for contender in running:
            contender.stop()
    for row in rows:
        for key in ("forward", "total"):
            if row.get(f"{key}_ms"):
                row[f"{key}_ratio"] = rows[0][f"{key}_ms"] / row[f"{key}_ms"]
    return rows


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
        grid, settings, rounds = (24, 32), ((2, 1.0), (1, 4.0)), 1
    options.output.mkdir(parents=True, exist_ok=True)
    machine = f"{os.cpu_count()} cores {platform.machine()}, load {os.getloadavg()[0]:.1f}, {date.today()}"
    rows: list[dict[str, object]] = []
    bar = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with tempfile.TemporaryDirectory() as cache, Progress(*bar) as progress:
        job = progress.add_task("rollout", total=len(settings) * len(contenders()))

        def advance(text: str) -> None:
            progress.update(job, advance=1, description=text)

        for index, (batch, scale) in enumerate(settings):
            patience = options.patience * (1 if index else 4)  # the first setting is the one that is judged
            rows += measure((batch, scale, grid), rounds, patience, Path(cache), advance)
            write(options.output / "rollout.csv", COLUMNS, rows)
            write(options.output / "rollout_details.csv", DETAILS, rows)
    show(rows, machine)
    plot(rows, options.output / "rollout.png", machine)
    print(f"written: {options.output}/rollout.csv, rollout_details.csv, rollout.png")


if __name__ == "__main__":
    main()
