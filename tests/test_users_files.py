"""Whatever the order of runs, settings, interruptions and foreign files, of whichever doors: what is a user's stays."""

import functools
import os
import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from matplotlib.figure import Figure

from benchmarks.online import __main__ as online
from benchmarks.palpation import __main__ as palpation
from benchmarks.palpation import surfaces
from benchmarks.real import __main__ as real
from benchmarks.recovery.__main__ import Benchmark
from benchmarks.recovery.__main__ import main as measure
from palpate.command import calibrate, infer, plan, train
from palpate.common.files import replacing
from palpate.common.output import LIST, ForeignFile
from palpate.data.clip import prepare
from palpate.data.depth.photometric import write_photometric
from palpate.data.source.layout import InputError
from palpate.data.synthetic import __main__ as synthetic
from palpate.estimators.palpation.material_fit import NOTHING
from palpate.planning import cost_table
from palpate.results.store import OutputError
from tests.benchmarks.recovery_cases import recovery
from tests.data.clips import SETTINGS
from tests.data.clips import write_clip as write_tiny
from tests.data.synthetic.test_clip import write_quickly
from tests.inference_inputs import write_clip, write_model
from tests.planning.cases import quick_press
from tests.planning.test_scene import SHIPPED

Run = Callable[[random.Random, Path], object]
EVENTS = 12
"""Of every sequence; more than half of them are runs."""
PAGES = ("index.html", "clip/page.html")
PLACES = {
    "draw": ("video01/notes.txt", f"video01/{LIST}", *(f"video01/video01_00000/{n}" for n in ("truth.json", "x"))),
    "estimate": ("clip/parameters.csv", "clip/run.json", "clip/notes.txt", ".clip.partial-1/notes.txt", *PAGES),
    "judge_pull": ("table.csv", "results.jsonl", "notes.txt"),
    "judge_frank": ("table.csv", "results.jsonl", "notes.txt"),
    "judge_online": ("table.csv", "table_2.csv", "results.jsonl", "run.json"),
    "calibrate_palpation": ("calibration.json", "errors.csv", "errors.png", "notes.txt"),
    "plan_way": ("plan.json", "plan.png", "presses/notes.txt"),
    "benchmark": ("table.csv", "results.jsonl", "run.json"),
    "train_network": ("checkpoints/best.ckpt", "checkpoints/last.ckpt", "checkpoints/notes.txt"),
    "write_depth": ("depth.onnx", "notes.txt"),
    "keep_prepared": (".tmp-mine/notes.txt", ".tmp-mine/entry/0.npz", "notes.txt"),
}
"""Names by which a user may have something where a door writes."""
KEPT = (".npz", ".ckpt", ".mp4")
"""Ends of the names of our own files that no user edits in between: what is known by its name alone."""


@pytest.fixture
def inputs(tmp_path: Path) -> Path:
    write_clip(tmp_path / "clips" / "clip", 4, 2)
    write_tiny(tmp_path / "tiny", frames=2)
    for name, slope in (("first", 0.1), ("second", 0.2)):
        write_model(tmp_path / f"{name}.onnx", slope=(slope, 0.0, 0.0))
    trainer = {"max_epochs": 1, "accelerator": "cpu", "devices": 1, "enable_model_summary": False}
    model = {"width": 4, "residual_blocks": 1, "mechanics": {"steps": 40, "load_steps": 10}}
    data = {"root": str(tmp_path / "clips"), "geometry": {"height": 40, "width": 56}}
    settings = {"trainer": trainer, "tracking": False, "model": model, "data": data}
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(settings))
    return tmp_path


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, blank_pictures: None) -> None:
    """The doors decide and write as ever, but what takes long is not computed."""
    patch = monkeypatch.setattr
    patch(synthetic, "clip_seed", lambda seed, index: seed + index)
    write_quickly(monkeypatch)
    patch(real, "evaluate_pull", lambda clip, row: row.update(status="ok", skill=random.random()))
    patch(surfaces, "fit_from", lambda *arguments: {"E": random.random()})
    patch(surfaces, "fit_six", lambda *arguments: {"E": random.random()})
    pull = SimpleNamespace(body=SimpleNamespace(count=9))
    sequence = SimpleNamespace(block=False, frames=60, pull=lambda particles, points, frames: pull)
    patch(online, "SEQUENCES", {"thin-shell-1": sequence})
    names = ("chamfer", "ahead", "gap", "keypoint")
    patch(
        online, "run_case", lambda *arguments: {"seconds": 0.1} | {name: np.full(1, random.random()) for name in names}
    )
    patch(cost_table, "simulate_press", quick_press)
    patch(plan, "simulate_press", quick_press)
    settings = SimpleNamespace(law="corotational")
    tissue = SimpleNamespace(notes=[], skin=None, held=None, palpations=[], settings=settings)
    patch(calibrate, "read_scene", lambda path: tissue)
    monkeypatch.setattr(calibrate, "fit_material", lambda *arguments, report: quick_material())
    patch(calibrate, "_picture", lambda scene, found: Figure((1, 1)))
    patch(Benchmark, "work", staticmethod(lambda trial: [recovery(trial.index)]))

    @functools.wraps(train.RunTrainer.fit)  # whose arguments are options
    def fit(trainer: Any, *_: object, **__: object) -> None:
        folder = Path(trainer.default_root_dir)
        (folder / "checkpoints").mkdir(parents=True, exist_ok=True)
        for name in ("best.ckpt", "last.ckpt"):
            with replacing(folder / "checkpoints" / name) as partial:
                partial.write_bytes(b"trained")

    patch(train.RunTrainer, "fit", fit)


def quick_material() -> SimpleNamespace:
    """Of no palpations."""
    found = {
        "young": 1e4 * random.random(),
        "poisson": 0.4,
        "noise": 0.0,
        "solves": 0,
        "verdict": NOTHING,
    }
    return SimpleNamespace(**found, covariance=np.full((2, 2), np.nan), poses=[], rests=[])


def runs_of(inputs: Path) -> dict[str, Run]:
    """Doors by name; each writes into one folder, whatever else is in it."""

    def draw(chance: random.Random, out: Path) -> object:
        asked = ["--overwrite"] if chance.random() < 0.5 else []
        size = ["--size", "small", "--frames", "20", "--press-seconds", "0.2", "0.3"]
        return synthetic.main(["--output", str(out), *size, "--seed", str(chance.randrange(2)), *asked])

    def estimate(chance: random.Random, out: Path) -> object:
        asked = ["--overwrite"] if chance.random() < 0.5 else []
        model = str(inputs / f"{chance.choice(('first', 'second'))}.onnx")
        arguments = [str(inputs / "clips"), "--output", str(out), "--model", model, "--no-overlay", *asked]
        return infer.main(arguments)

    def judge_online(chance: random.Random, out: Path) -> object:
        asked = f"--sequences thin-shell-1 --starts k1 --methods PBD --every {chance.choice((5, 10))}"
        return online.main([*asked.split(), "--output", str(out)])

    def benchmark(chance: random.Random, out: Path) -> object:
        return measure(["--output", str(out), "--clips", str(1 + chance.randrange(3)), "--workers", "0"])

    def fixed(door: Callable[[list[str]], object], *arguments: object) -> Run:
        """What has no choice of its own."""
        return lambda _, out: door([*map(str, arguments), "--output", str(out)])

    own = (draw, estimate, judge_online, benchmark)
    return {run.__name__: run for run in own} | {
        "judge_pull": fixed(real.main, "--pulled", inputs),
        "judge_frank": fixed(palpation.main),
        "calibrate_palpation": fixed(calibrate.main, "palpation", "scene.yaml"),
        "plan_way": lambda chance, out: fixed(plan.main, SHIPPED, "--alpha", chance.random())(chance, out),
        "train_network": lambda _, out: train.main(
            ["fit", "-c", str(inputs / "tiny.yaml"), f"--trainer.default_root_dir={out}"]
        ),
        "write_depth": lambda chance, out: write_photometric(out / "depth.onnx", chance.choice((60.0, 90.0))),
        "keep_prepared": lambda _, out: prepare(inputs / "tiny", SETTINGS, out),
    }


def put(chance: random.Random, out: Path, places: Sequence[str]) -> Path:
    """A user's own file, by a name that a door would give one of its own."""
    path = out / chance.choice(places)
    return path if not os.path.lexists(path) else out / f"mine{chance.random()}.txt"


def edit(chance: random.Random, out: Path, places: Sequence[str]) -> Path:
    """A user's change of what a door has written."""
    found = [path for path in out.rglob("*") if path.is_file() and not path.name.startswith(".")]
    found = [path for path in sorted(found) if not path.name.endswith(KEPT)]
    return chance.choice(found) if found else put(chance, out, places)


def interrupting(step: int | None) -> Iterator[None]:
    """The next `step` changes of names on the disk go well, and then Ctrl-C is pressed."""
    while step is None or step > 0:
        step = None if step is None else step - 1
        yield
    raise KeyboardInterrupt


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("door", PLACES)
def test_no_order_of_runs_interruptions_and_foreign_files_changes_a_user_s_file(door, seed, inputs, monkeypatch):
    """Of one door mostly, in a folder that others use as well."""
    chance, out, doors = random.Random(f"{door} {seed}"), inputs / "out", runs_of(inputs)
    theirs: dict[Path, bytes] = {}
    steps = interrupting(None)
    for name in ("replace", "rename"):
        real_one = getattr(os, name)
        # Before it and after it.
        monkeypatch.setattr(
            os, name, lambda *paths, move=real_one, **named: (next(steps, 0), move(*paths, **named), next(steps, 0))
        )
    for _ in range(EVENTS):
        kind = chance.choice([door] * 6 + [chance.choice([*doors])] * 2 + ["put"] * 3 + ["edit"] * 2)
        if kind in doors:
            steps = interrupting(chance.choice((None, None, *range(6))))
            with suppress(KeyboardInterrupt, SystemExit, OutputError, ForeignFile, InputError):
                doors[kind](chance, out)
            steps = interrupting(None)
        else:
            path = (put if kind == "put" else edit)(chance, out, PLACES[door])
            with suppress(FileExistsError, NotADirectoryError):  # a file of theirs is where a folder would be
                path.parent.mkdir(parents=True, exist_ok=True)
                theirs[path] = f"mine, {chance.random()}".encode()
                path.write_bytes(theirs[path])
                for each in (path, path.parent):
                    os.utime(each, (0, 0))
        found = {path: path.read_bytes() if path.is_file() else None for path in theirs}
        assert found == theirs, kind


@pytest.mark.usefixtures("quick")
def test_these_doors_write_where_nothing_is_in_the_way(inputs: Path) -> None:
    """Else the sequences above would show nothing."""
    written: dict[str, set[str]] = {}
    for name, run in runs_of(inputs).items():
        for _ in range(2):  # what is their own is never in their way
            run(random.Random(1), inputs / name)
        written[name] = {path.name for path in (inputs / name).rglob("*") if path.is_file()}
    expected = {
        "draw": {LIST, "truth.json", "frame_0_endo.png"},
        "estimate": {"run.json", "parameters.csv", "fit.png"},
        "judge_pull": {"table.csv"},
        "judge_frank": {"table.csv", "results.jsonl"},
        "judge_online": {"table.csv", "table_2.csv", "results.jsonl"},
        "calibrate_palpation": {"calibration.json", "errors.csv", "errors.png"},
        "plan_way": {"plan.json", "plan.png"},
        "benchmark": {"table.csv", "results.jsonl", "run.json"},
        "train_network": {"last.ckpt", "best.ckpt"},
        "write_depth": {"depth.onnx", LIST},
        "keep_prepared": {"clip.npz", "0.npz"},
    }
    assert {name: expected[name] & found for name, found in written.items()} == expected
