"""The rollout's benchmark runs, checks what it times, and its contenders solve the same problem."""

from __future__ import annotations

import csv
import importlib.util
from typing import ClassVar

import numpy as np
import pytest

from benchmarks import rollout, rollout_contender
from benchmarks.rollout_cases import GRID, Ours, make_task
from benchmarks.rollout_contender import Contender, Failure
from physics import jit


def test_baseline_and_our_backends_agree():
    task = make_task(2, 1.0, (24, 32))
    baseline = rollout.EdgeList(task)
    expected, gradient = baseline.forward(), baseline.total()
    for variant in ("exact", "window", "stencil") if jit.COMPILED else ("stencil",):
        ours = Ours(task, variant)
        np.testing.assert_allclose(ours.forward(), expected, atol=1e-3 * np.abs(expected).max())
        np.testing.assert_allclose(ours.total(), gradient, atol=1e-2 * np.abs(gradient).max())


def test_the_mesh_has_the_papers_size():
    assert len(make_task(1, 1.0, GRID).mesh.vertices) == pytest.approx(14_800, rel=0.01)


@pytest.mark.slow
def test_quick_run_writes_its_table_and_plot(tmp_path, capsys):
    rollout.main(["--quick", "--output", str(tmp_path)])
    with (tmp_path / "rollout.csv").open() as file:
        reader = csv.DictReader(file)
        rows = list(reader)
    assert tuple(reader.fieldnames) == rollout.COLUMNS
    assert len(rows) == 2 * len(rollout.contenders())
    for row in rows:
        assert float(row["forward_ms"]) > 0
        baseline = next(
            other for other in rows
            if (other["backend"], other["variant"], other["batch"], other["vertices"])
            == ("torch", "edges", row["batch"], row["vertices"])
        )  # fmt: skip
        ratio = float(baseline["forward_ms"]) / float(row["forward_ms"])
        assert float(row["forward_ratio"]) == pytest.approx(ratio, rel=1e-3)
        assert bool(row["total_ms"]) == bool(row["total_ratio"]) == (row["variant"] != "field")
    assert (tmp_path / "rollout.png").stat().st_size > 10_000
    assert "torch edges" in capsys.readouterr().out


def idle(name=("warp", "tape", 1)) -> Contender:
    """A contender without a process."""
    contender = Contender.__new__(Contender)
    contender.name, contender.forward, contender.total, contender.peak = name, [], [], None
    contender.spent = contender.longest = 0.0
    return contender


def test_what_computes_something_else_is_not_timed():
    baseline, other = idle(rollout.BASELINE), idle()
    baseline.trajectory, baseline.gradient = np.ones((1, 200, 3)), np.ones((1, 3))
    other.gradient = None
    other.trajectory = baseline.trajectory * 1.0005
    other.require_same(baseline)
    other.trajectory = baseline.trajectory * 1.01
    with pytest.raises(Failure, match=r"warp tape, 1 thread: its trajectory differs by 1\.0e-02"):
        other.require_same(baseline)


def test_whoever_is_slow_has_its_memory_measured_in_its_only_turn(monkeypatch):
    asked, clock = [], iter([0.0, 6.0])
    monkeypatch.setattr(rollout_contender.time, "perf_counter", lambda: next(clock))
    slow = idle()
    slow.first_call, slow.vertices = 5.5, 10
    slow.ask = lambda what: asked.append(what) or (7.0, 1000.0, 5000.0)
    assert slow.wants_turn(20.0)
    slow.turn()
    assert not slow.wants_turn(20.0)
    row = slow.row(2)
    assert asked == ["memory and times"]
    assert (row["peak_mb"], row["forward_ms"], row["total_ms"], row["vertices"]) == (7.0, 1000.0, 5000.0, 5)


def test_a_slow_first_call_alone_takes_no_turns_away(monkeypatch):
    asked, clock = [], iter([0.0, 0.5, 1.0, 1.5])
    monkeypatch.setattr(rollout_contender.time, "perf_counter", lambda: next(clock))
    compiled = idle()
    compiled.first_call, compiled.vertices = 8.0, 10
    compiled.ask = lambda what: asked.append(what) or (7.0 if "memory" in what else None, len(asked), None)
    compiled.turn()
    assert compiled.wants_turn(1.0)
    compiled.turn()
    assert not compiled.wants_turn(1.0)
    row = compiled.row(1)
    assert asked == ["memory and times", "times"]
    assert (row["peak_mb"], row["forward_min_ms"], row["forward_max_ms"]) == (7.0, 1, 2)
    assert "total_ms" not in row


def test_a_contender_that_fails_is_named(tmp_path):
    with pytest.raises(Failure, match="numba unknown, 1 thread: "):
        Contender(("numba", "unknown", 1), (1, 1.0, (0, 0)), tmp_path)


def test_a_contender_whose_process_is_killed_says_so(tmp_path):
    contender = Contender(rollout.BASELINE, (1, 1.0, (12, 16)), tmp_path)
    contender.process.kill()
    contender.process.join()
    with pytest.raises(Failure, match="torch edges, 1 thread: it was killed, probably for lack of memory"):
        contender.turn()
    contender.stop()


def test_who_needs_more_than_its_share_of_the_memory_does_not_fit():
    needs = {("torch", "stencil", 1): 1125.0, ("torch", "edges", 1): 650.0}
    assert rollout.unfit(needs, 16, 23_000.0) == {("torch", "stencil", 1): "it needs about 18 GB of 23 GB"}
    assert rollout.unfit(needs, 2, 23_000.0) == {}
    assert rollout.unfit(needs, 16, None) == {}


def test_needs_are_peaks_by_size_of_whom_they_are_known():
    names = [("torch", "edges", 1), ("numba", "field", 2), ("warp", "tape", 1)]
    keys = ("backend", "variant", "threads", "peak_mb")
    rows = [dict(zip(keys, (*name, peak), strict=True)) for name, peak in zip(names, (80.0, None, 0.0), strict=True)]
    assert rollout.needs_of(rows, 4.0) == {names[0]: 20.0}


def test_available_memory_is_read_where_the_system_tells(monkeypatch, tmp_path):
    monkeypatch.setattr(rollout, "MEMORY", tmp_path / "meminfo")
    assert rollout.available_memory() is None
    rollout.MEMORY.write_text("MemTotal: 4096 kB\nMemAvailable: 2048 kB\n")
    assert rollout.available_memory() == 2.0


class Pretender(Contender):
    """A contender without a process, which fails where it is told to."""

    failing: ClassVar[dict] = {}
    running: ClassVar[list] = []
    log: ClassVar[list] = []

    def __init__(self, name, setting, cache) -> None:
        vars(self).update(vars(idle(name)))
        self.fail("start")
        self.vertices, self.first_call = 8, 0.1
        self.trajectory = np.full((1, 4, 3), 2.0 if self.failing.get(name) == "differ" else 1.0)
        self.gradient = None
        self.running.append(name)

    def fail(self, where) -> None:
        if self.failing.get(self.name) == where:
            raise Failure(self.name, f"no {where}\nand a long story")

    def ask(self, what):
        self.fail({"times": "turn", "memory and times": "row"}[what])
        self.log.append((what, list(self.running)))
        return (1.0 if "memory" in what else None), {"torch": 8.0}.get(self.name[0], 2.0), None

    def stop(self) -> None:
        self.running.remove(self.name)


NAMES = [rollout.BASELINE, ("numba", "exact", 1), ("numba", "window", 1), ("warp", "tape", 1)]


@pytest.fixture
def setting(monkeypatch):
    monkeypatch.setattr(rollout, "Contender", Pretender)
    monkeypatch.setattr(rollout, "contenders", lambda: NAMES)
    for name, empty in (("failing", {}), ("running", []), ("log", [])):
        monkeypatch.setattr(Pretender, name, empty)
    said, advanced = [], []

    def make(batch: int, scale: float) -> rollout.Setting:
        made = rollout.Setting((batch, scale, (1, 1)), None, advanced.append, said.append)
        made.said, made.advanced = said, advanced
        return made

    return make


@pytest.mark.parametrize(("batch", "scale", "alone"), [(2, 2.0, False), (16, 1.0, True), (1, 16.0, True)])
def test_only_small_settings_hold_all_processes_at_once(setting, batch, scale, alone):
    chosen = setting(batch, scale)
    rows = chosen.measure(3, 5.0, {})
    turns = [running for what, running in Pretender.log if what == "times"]
    expected = [[name] for name in NAMES for _ in range(3)] if alone else [NAMES] * 12
    assert turns == expected
    assert Pretender.running == []
    assert [row["forward_ratio"] for row in rows] == [1.0, 4.0, 4.0, 4.0]
    assert [row["rounds"] for row in rows] == [3] * 4
    assert (len(chosen.advanced), chosen.said) == (4, [])


@pytest.mark.parametrize("batch", [2, 16])
@pytest.mark.parametrize(
    ("failing", "reason"),
    [("start", "no start"), ("differ", "its trajectory differs by 1.0e+00"), ("turn", "no turn"), ("row", "no row")],
)
def test_whoever_fails_is_left_out_and_the_rest_goes_on(setting, batch, failing, reason):
    Pretender.failing[NAMES[1]] = failing
    chosen = setting(batch, 1.0)
    rows = chosen.measure(2, 5.0, {})
    assert [row["variant"] for row in rows] == ["edges", "window", "tape"]
    assert chosen.said == [f"numba exact, 1 thread: left out at batch {batch}, {reason}"]
    assert Pretender.running == []


@pytest.mark.parametrize("failing", ["start", "turn", "row"])
def test_without_the_baseline_nothing_goes_on(setting, failing):
    Pretender.failing[rollout.BASELINE] = failing
    with pytest.raises(Failure, match=f"torch edges, 1 thread: no {failing}"):
        setting(2, 1.0).measure(2, 5.0, {})
    assert Pretender.running == []


def test_whoever_needs_too_much_is_not_started(setting, monkeypatch):
    monkeypatch.setattr(rollout, "available_memory", lambda: 10_000.0)
    chosen = setting(1, 16.0)
    rows = chosen.measure(1, 5.0, {NAMES[1]: 1000.0, NAMES[2]: 100.0})
    assert [row["variant"] for row in rows] == ["edges", "window", "tape"]
    where = "batch 1, 16× the vertices"
    assert chosen.said == [f"numba exact, 1 thread: left out at {where}, it needs about 16 GB of 10 GB"]
    assert len(chosen.advanced) == 4


def test_a_setting_too_large_for_the_baseline_is_left_out(setting, monkeypatch):
    monkeypatch.setattr(rollout, "available_memory", lambda: 10_000.0)
    chosen = setting(16, 1.0)
    assert chosen.measure(1, 5.0, {rollout.BASELINE: 1000.0}) == []
    assert chosen.said[-1] == "batch 16: left out, because there is nothing to compare with"
    assert Pretender.log == []


@pytest.mark.parametrize("absent", ["warp", "taichi"])
def test_what_is_not_installed_is_left_out(monkeypatch, absent):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == absent else found(name))
    assert absent not in {name[0] for name in rollout.contenders()}
    assert rollout.contenders()[0] == rollout.BASELINE
