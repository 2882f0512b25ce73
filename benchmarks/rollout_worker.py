"""One contender of `benchmarks.rollout` in a process of its own: its first call, its times and its memory."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

STATUS, FIRST_TO_GO = Path("/proc/self/status"), Path("/proc/self/oom_score_adj")


def serve(connection: Connection, contender: tuple[str, str, int], setting: tuple) -> None:
    """Make the contender, then measure whatever the parent asks for; an exception is sent as its text."""
    with contextlib.suppress(OSError):  # where memory runs out, this process ends, not the benchmark or other work
        FIRST_TO_GO.write_text("1000")
    try:
        import torch

        from benchmarks.rollout_cases import make_task

        torch.set_num_threads(contender[2])
        task = make_task(*setting)
        start = time.perf_counter()
        runner = _make(contender, task)
        gradient = runner.total() if runner.total else None
        trajectory = runner.forward()
        first = time.perf_counter() - start
        connection.send((len(task.mesh.vertices), first, trajectory, gradient))
        while (asked := connection.recv()) != "stop":
            before = _settle() if asked == "memory and times" else None
            times = _times(runner)
            connection.send((None if before is None else _resident("VmHWM") - before, *times))
    except Exception as error:
        connection.send(f"{type(error).__name__}: {error}")


def _make(contender: tuple[str, str, int], task):
    """The contender, with its library imported only here."""
    backend, variant, threads = contender
    if backend == "torch" and variant == "edges":
        from benchmarks.rollout import EdgeList

        return EdgeList(task)
    if backend == "warp":
        from benchmarks.rollout_warp import Warp

        return Warp(task, _arrays(task))
    if backend == "taichi":
        from benchmarks.rollout_taichi import Taichi

        return Taichi(task, _arrays(task), threads)
    from benchmarks.rollout_cases import Field, Ours

    return Field(task) if variant == "field" else Ours(task, variant)


def _arrays(task) -> dict[str, np.ndarray]:
    """The joined batch as plain arrays, single precision."""
    mesh, contact = task.mesh, task.contact
    rest, springs = mesh.vertices.numpy(), mesh.springs.numpy().astype(np.int32)
    touched = (mesh.vertex_offsets[:-1] + contact.vertex).numpy()
    free = (~mesh.rim).numpy().astype(np.float32)
    push = np.zeros_like(rest)
    free[touched], push[touched] = 1.0, contact.direction.numpy()
    return {
        "theta": task.theta.numpy(),
        "rest": rest,
        "springs": springs,
        "length": np.linalg.norm(rest[springs[:, 1]] - rest[springs[:, 0]], axis=1),
        "sample": mesh.sample_of_vertex().numpy().astype(np.int32),
        "touched": touched.astype(np.int32),
        "free": free,
        "push": push,
        "weights": task.weights.numpy(),
    }


def _times(runner) -> tuple[float, float | None]:
    """Duration of one forward and of one forward + gradient [ms]."""
    durations = []
    for work in (runner.forward, runner.total):
        start = time.perf_counter()
        if work:
            work()
        durations.append(1e3 * (time.perf_counter() - start) if work else None)
    return durations[0], durations[1]


def _settle() -> float | None:
    """Give freed memory back, forget the highest mark so far and say what is held now [MB]; None where unknown."""
    try:
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
        return _resident("VmRSS")
    except (OSError, AttributeError):
        return None


def _resident(key: str) -> float:
    """A memory figure of this process [MB]."""
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith(key))
    return int(line.split()[1]) / 1024
