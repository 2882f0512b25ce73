"""The training door: fit, validate, test, export, resume, two processes, and what it says when something is wrong."""

import contextlib
import os
import re
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mlflow
import pytest
import torch
import yaml
from mlflow import MlflowClient
from mlflow.exceptions import MlflowException

from palpate.cli import infer, tracking, train
from palpate.data.contact.features import FEATURES
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES
from palpate.data.synthetic import __main__ as synthetic
from palpate.models.checkpoint import CheckpointError, require_same_weights
from palpate.models.onnx_session import ParameterModel, PosteriorModel
from palpate.models.posterior import ContactPosterior
from palpate.physics.mechanics import Bounds
from palpate.results.record import sha256_of
from tests.data.clips import write_clip
from tests.tables import read_rows

# Lightning warns of arguments given from Python beside pytest's own on the command line.
pytestmark = pytest.mark.filterwarnings("ignore:LightningCLI's args parameter")
CHECKOUT = Path(__file__).resolve().parents[1]
TERMS = ("gan", "cycle", "identity", "physics", "regularisation")


@pytest.fixture(scope="module")
def clips(tmp_path_factory) -> Path:
    """Four small synthetic clips: two to train, one to validate, one to test."""
    folder = tmp_path_factory.mktemp("clips") / "data"
    arguments = "--clips 4 --frames 14 --seed 1 --size 128x96 --grid-width 64 --grid-height 48 --press-seconds 0.2 0.24"
    assert not synthetic.main(["--output", str(folder), *arguments.split()])
    return folder


@pytest.fixture(scope="module")
def config(clips: Path) -> Path:
    """Configuration of a network that trains in seconds; the run folder is `run` beside it."""
    trainer = {"default_root_dir": str(clips.parent / "run"), "max_epochs": 1, "accelerator": "cpu", "devices": 1}
    trainer |= {"enable_progress_bar": False, "enable_model_summary": False}
    network = {"width": 4, "residual_blocks": 1, "noise": 0.002}
    network |= {"mechanics": {"steps": 40, "load_steps": 10}}
    network |= {"bounds": {"force": [-0.3, 0.0], "initial": [0.5, 0.1, -0.05]}}
    pairs = {"root": str(clips), "cache": str(clips.parent / "cache"), "geometry": {"height": 40, "width": 56}}
    pairs |= {"samples": {"window": 6, "observation": "trajectory"}, "loading": {"fractions": [0.5, 0.25, 0.25]}}
    model = {"class_path": "palpate.models.module.PhysicsInformedGAN", "init_args": network}
    data = {"class_path": "palpate.data.training.datamodule.ClipDataModule", "init_args": pairs}
    settings = {"seed_everything": 0, "tracking": False, "trainer": trainer, "model": model, "data": data}
    path = clips.parent / "tiny.yaml"
    path.write_text(yaml.safe_dump(settings))
    return path


@pytest.fixture(scope="module")
def trained(config: Path) -> Path:
    """Run folder of one epoch."""
    assert train.main(["fit", "-c", str(config)]) == 0
    return config.parent / "run"


@pytest.fixture(scope="module")
def known(config: Path) -> Path:
    """What to add to `config` for head posterior."""
    bounds = {"stiffness": [0.05, 1.0], "damping": [0.005, 0.5], "force": [-0.3, -0.01]}
    change = {
        "trainer": {"default_root_dir": str(config.parent / "posterior")},
        "model": {"head": "posterior", "weights": {"physics": 1.0}, "bounds": bounds},
        "data": {"samples": {"onset_within": 26}, "geometry": {"height": 40, "width": 56, "smoothing": 3.0}},
    }
    path = config.parent / "known.yaml"
    path.write_text(yaml.safe_dump(change))
    return path


def command(*arguments: object) -> list[str]:
    return [sys.executable, str(CHECKOUT / "train.py"), *map(str, arguments)]


def last(folder: Path) -> dict:
    return torch.load(folder / "checkpoints" / "last.ckpt", weights_only=True)


def until_saved(folder: Path) -> None:
    """Wait for a run's first checkpoint."""
    deadline = time.monotonic() + 120
    while not (folder / "checkpoints" / "last.ckpt").is_file() and time.monotonic() < deadline:
        time.sleep(0.05)


def test_fit_leaves_checkpoints_logs_and_configuration(trained: Path):
    checkpoint = last(trained)
    assert len(checkpoint["optimizer_states"]) == 3
    assert yaml.safe_load(checkpoint["configuration"])["model"]["init_args"]["width"] == 4
    assert (trained / "checkpoints" / "best.ckpt").is_file()
    log = trained / "logs" / "version_0"
    assert yaml.safe_load((log / "config.yaml").read_text())["data"]["init_args"]["samples"]["window"] == 6
    header = (log / "metrics.csv").read_text().splitlines()[0].split(",")
    terms = {f"train/{term}" for term in TERMS}
    assert terms | {"val/physics", "val/force_mean", "train/stiffness_sd"} <= set(header)


def test_validate_and_test_write_the_evaluation(trained: Path, config: Path, capsys):
    assert train.main(["validate", "-c", str(config), "--ckpt_path", "best"]) == 0
    assert train.main(["test", "-c", str(config), "--ckpt_path", "best"]) == 0
    assert str(trained / "evaluation" / "table_2.csv") in capsys.readouterr().out
    for name in ("table_2.csv", "figure3.png", "per_frame.csv"):
        assert (trained / "evaluation" / name).stat().st_size > 0


def test_a_user_s_file_where_test_or_export_write_stays(trained: Path, config: Path, tmp_path: Path, capsys):
    table, notes = tmp_path / "run" / "evaluation" / "per_frame.csv", tmp_path / "notes.onnx"
    table.parent.mkdir(parents=True)
    for path in (table, notes):
        path.write_text("precious")
    given = ["-c", str(config), "--ckpt_path", str(trained / "checkpoints" / "best.ckpt")]
    assert train.main(["test", *given, f"--trainer.default_root_dir={tmp_path / 'run'}"]) == 1
    assert f"train.py: {table} is not as this program wrote it; move it away" in capsys.readouterr().err
    assert train.main(["export", *given, f"--output={notes}"]) == 1
    assert f"train.py: {notes} is not as this program wrote it; move it away" in capsys.readouterr().err
    assert table.read_text() == notes.read_text() == "precious"


def test_export_writes_a_model_that_inference_opens(trained: Path, config: Path, capsys):
    output = trained / "out" / "parameters.onnx"
    assert train.main(["export", "-c", str(config), "--ckpt_path", "last", "--output", str(output)]) == 0
    assert "largest difference from torch" in capsys.readouterr().out
    model = ParameterModel(output)
    assert (model.window, model.input_size) == (6, (40, 56))
    metadata = model.metadata
    assert metadata["bounds"]["force"] == [-0.3, 0.0]
    assert metadata["mechanics"]["steps"] == 40
    assert len(metadata["config_sha256"]) == 64
    assert {"geometry", "depth", "classes", "observation", "preprocessing_version", "units"} <= metadata.keys()
    assert str(trained) not in str(metadata)


def refused(capsys, *arguments: object) -> str:
    """Run in this process, expect exit status 2, and return what was said: one line."""
    assert train.main([str(argument) for argument in arguments]) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("train.py:")]
    assert len(said) == 1
    return said[0]


@pytest.mark.acceptance
def test_head_posterior_starts_pretrained_and_resumes_without_the_file(config, known, tmp_path, capsys):
    bounds = Bounds((0.05, 1.0), (0.005, 0.5), (-0.3, -0.01), (0.5, 0.1, -0.05))
    torch.manual_seed(3)
    pretrained = ContactPosterior(FEATURES + SEQUENCE_FEATURES, torch.from_numpy(bounds.log_box))
    torch.save(pretrained.state_dict(), tmp_path / "posterior.pt")
    arguments = ["fit", "-c", str(config), "-c", str(known), "--model.learning_rate", "1e-12", "--model.pretrained"]
    assert train.main([*arguments, str(tmp_path / "posterior.pt")]) == 0
    weights = last(config.parent / "posterior")["state_dict"]
    for generator in ("generator_ab", "generator_ba"):
        for name, value in pretrained.state_dict().items():
            torch.testing.assert_close(weights[f"{generator}.head.posterior.{name}"], value, atol=1e-6, rtol=1e-6)
    missing = [*arguments, str(tmp_path / "nothing.pt"), "--trainer.max_epochs", "2"]
    said = refused(capsys, *missing, "--trainer.default_root_dir", tmp_path / "run")
    assert "nothing.pt does not exist; give a file that train.py fit" in said
    assert train.main([*missing, "--ckpt_path", "last"]) == 0
    assert last(config.parent / "posterior")["epoch"] == 1
    assert train.main(["test", "-c", str(config), "-c", str(known), "--ckpt_path", "last"]) == 0
    assert (config.parent / "posterior" / "evaluation" / "per_frame.csv").stat().st_size > 0


@pytest.mark.acceptance
@pytest.mark.usefixtures("blank_pictures")
def test_the_recommended_system_from_training_to_an_estimate(tmp_path: Path):
    """fit, export and infer.py as a user runs them, from the shipped weights, which a few steps hardly change."""
    clips, root = tmp_path / "clips", tmp_path / "run"
    arguments = "--clips 3 --frames 24 --seed 2 --size 214x120 --press-seconds 0.24 0.28"
    assert not synthetic.main(["--output", str(clips), *arguments.split()])
    smaller = "--model.width 4 --model.residual_blocks 1 --tracking false --trainer.accelerator cpu"
    smaller += f" --data.root {clips} --data.cache {tmp_path / 'cache'} --trainer.default_root_dir {root}"
    options = ["-c", str(CHECKOUT / "configs" / "recommended.yaml"), *smaller.split()]
    options.append("--data.loading.fractions=[0.34,0.33,0.33]")
    few = "--trainer.max_epochs 1 --trainer.limit_train_batches 2 --trainer.limit_val_batches 1"
    assert train.main(["fit", *options, *few.split()]) == 0
    assert train.main(["export", *options, "--ckpt_path", "last", "--output", str(tmp_path / "gan.onnx")]) == 0
    assert PosteriorModel(tmp_path / "gan.onnx").takes_depth
    rows, clip = [], str(clips / "video01" / "video01_00000")
    for number, model in enumerate((["--model", str(tmp_path / "gan.onnx")], [])):
        output = tmp_path / f"results{number}"
        assert infer.main([clip, *model, "--output", str(output), "--no-overlay"]) == 0
        rows += read_rows(output / "video01_00000" / "interactions.csv")[:1]
    trained, shipped = rows
    assert trained["status"] == shipped["status"] == "ok"
    for name in ("stiffness", "damping", "force"):
        assert trained[f"{name}_sd"] != shipped[f"{name}_sd"]
        assert float(trained[name]) == pytest.approx(float(shipped[name]), rel=0.1)


def test_a_second_training_in_one_run_folder_is_refused_and_goes_on_when_asked(config: Path, trained: Path, capsys):
    folder = trained / "checkpoints"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    said = refused(capsys, "fit", "-c", config)
    assert f"{trained} holds a training already; add --ckpt_path last to go on with it, or give another" in said
    # Going on from a checkpoint of another folder would replace these all the same.
    other = trained.parent / "other.ckpt"
    other.write_bytes(before["last.ckpt"])
    assert "holds a training already" in refused(capsys, "fit", "-c", config, "--ckpt_path", other)
    assert train.main(["fit", "-c", str(config), "--ckpt_path", "last"]) == 0  # finished: nothing is left to do
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": {"head": "posterior"}}, "data.geometry.smoothing above 0, or choose head parameters"),
        ({"data": {"samples": {"onset_within": 0}}}, "onset_within is 0"),
        ({"model": {"widht": 5}}, "model.widht"),
        ({"data": {"samples": {"widnow": 5}}}, "data.samples.widnow"),
        ({"model": {"mechanics": {"steps": 0}}}, "mechanics.steps is 0"),
        ({"data": {"samples": {"window": 0}}}, "samples.window is 0; give 1 to 256"),
        ({"data": {"samples": {"observation": "everything"}}}, "data.samples.observation"),
        ({"model": {"width": "wide"}}, "model.width"),
        ({"model": {"width": -4}}, "width -4"),
        ({"model": 3}, "model"),
        ({"data": {"root": 3}}, "data.root"),
        ({"data": {"geometry": {"height": -40}}}, "height"),
        ({"data": {"loading": {"fractions": "most"}}}, "fractions"),
        ({"contact": {"output": "x"}}, "is not accepted"),
        ({"nonsense": {}}, "nonsense"),
    ],
)
def test_a_bad_configuration_gets_a_sentence(config: Path, tmp_path: Path, capsys, change: dict, message: str):
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump(change))
    assert message in refused(capsys, "fit", "-c", config, "-c", path)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"model: [1", "parsing"),
        (bytes(range(128, 256)), "is not a configuration"),
        ("model: {width: 4}".encode("utf-16"), "is not a configuration"),
        (b"model: {width: &a [*a]}", "is not a configuration (it refers to an anchor; write out"),
        (b"model: {width: !!timestamp x}", "is not a configuration"),
        (b"", "is not a configuration; write a mapping"),
        (b"model: " + b"[" * 5000, "nests too deeply"),
        (b"model: {width: " + b"[" * 20 + b"]" * 20 + b"}", "nests too deeply, or holds a number out of range"),
        (b"model: {width: " + b"9" * 400 + b"}", "nests too deeply, or holds a number out of range"),
        (b"model: {width: 0x" + b"f" * 5000 + b"}", "nests too deeply, or holds a number out of range"),
        (b"model: {learning_rate: .inf}", "nests too deeply, or holds a number out of range"),
        (b'data: {root: "a\\0b"}', "or a NUL; correct the file"),
        (None, "can't be read as a configuration (no file but a pipe or a device); check the path."),
    ],
)
def test_a_configuration_that_is_none_is_named(config, tmp_path, capsys, content, expected):
    path = tmp_path / "broken.yaml"
    path.write_bytes(content) if content is not None else os.mkfifo(path)
    said = refused(capsys, "fit", "-c", config, "-c", path)
    assert f"{path} " in said
    assert expected in said
    assert len(said) < len(str(path)) + 300


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("model.widht", 5, "--model.widht"),
        ("model.window", 4, "model.window follows data.samples.window; give that one alone"),
        ("data.bounds.force", "[-0.2, 0.0]", "data.bounds follows model.bounds; give that one alone"),
        ("data.depth.threads", 100_000, "depth.threads is 100000; give 0 to 1024"),
        ("data.loading.num_workers", 100_000, "num_workers is 100000; give 0 to 1024"),
        ("data.loading.batch_size", 100_000, "batch_size is 100000; give 1 to"),
        ("data.geometry.height", 100_000, "geometry.height is 100000; give 8 to 4096"),
        ("data.samples.window", 100_000, "window is 100000; give 1 to 256"),
        ("model.width", 100_000, "width 100000 and residual_blocks 1; give 1 channel or more, a width of 1 to 256"),
        ("model.residual_blocks", 100_000, "and 0 to 64 blocks"),
        ("trainer.devices", 100_000, "trainer.devices is 100000; give 1 to at most"),
        ("trainer.devices", "[1, 2]", "`devices` selected with `CPUAccelerator` should be an int > 0"),
        ("trainer.max_time", "{a: 1}", "invalid keyword argument"),
        ("trainer.check_val_every_n_epoch", 0, "trainer.check_val_every_n_epoch is 0; give more than 0."),
        ("seed_everything", 2**32, "seed_everything is 4294967296; give 0 to 4294967295"),
        ("seed_everything", "9" * 400, "seed_everything is a number beyond ±1e+15; give 0 to 4294967295"),
        ("trainer.precision", "bf16-true", "rollouts are in 32 bits; give 32-true, or bf16-mixed, which has 16"),
        ("trainer.gradient_clip_val", 1, "is 1.0, and three optimisers step by hand; lower model.learning_rate"),
        ("trainer.accumulate_grad_batches", 2, "three optimisers step by hand; raise data.loading.batch_size instead"),
        ("trainer.strategy", "ddp_spawn", "strategy is 'ddp_spawn', and three optimisers step in turn, and files"),
    ],
)
def test_a_value_without_room_or_sense_gets_a_sentence(config, capsys, option, value, expected):
    assert expected in refused(capsys, "fit", "-c", config, f"--{option}={value}")


def test_what_is_not_deterministic_or_no_section_is_said(config: Path, tmp_path: Path, capsys):
    on_gpu = ("--trainer.accelerator", "gpu", "--trainer.deterministic", "true")
    assert "has no deterministic gradient on a GPU; give warn" in refused(capsys, "fit", "-c", config, *on_gpu)
    path = tmp_path / "scheduled.yaml"
    path.write_text("optimizer: Adam")
    assert "the section optimizer is not accepted; correct" in refused(capsys, "fit", "-c", config, "-c", path)


def other_database(path: Path) -> None:
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("create table alembic_version (version_num varchar(32))")
        database.execute("insert into alembic_version values ('of something else')")
        database.commit()


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b"no database at all" * 500),
        *(other_database, os.mkfifo, Path.mkdir),
    ],
)
def test_a_damaged_tracking_database_gets_a_sentence_at_once(config: Path, tmp_path: Path, capsys, damage: Callable):
    damage(tmp_path / "mlflow.db")
    arguments = ("fit", "-c", config, "--tracking", "true", "--trainer.default_root_dir", tmp_path / "run")
    said = refused(capsys, *arguments)
    assert f"{tmp_path / 'mlflow.db'} can't be used (" in said
    assert said.endswith("); move it away, or add --tracking false.")
    assert not (tmp_path / "run" / "checkpoints").exists()


def test_a_folder_that_takes_no_tracking_database_gets_a_sentence_at_once(config: Path, capsys):
    said = refused(capsys, "fit", "-c", config, "--tracking=true", "--trainer.default_root_dir=/proc/palpate")
    assert "/proc/mlflow.db can't be used (" in said


@pytest.mark.parametrize("kind", ["immediate", "exclusive"])
def test_a_locked_tracking_database_gets_a_sentence(config: Path, tmp_path: Path, capsys, monkeypatch, kind: str):
    monkeypatch.setattr(tracking, "LOCK_TIMEOUT_S", 0.1)
    MlflowClient(f"sqlite:///{tmp_path / 'mlflow.db'}").search_experiments()
    with contextlib.closing(sqlite3.connect(tmp_path / "mlflow.db", isolation_level=None)) as database:
        database.execute(f"begin {kind}")
        said = refused(capsys, "fit", "-c", config, "--tracking=true", f"--trainer.default_root_dir={tmp_path / 'run'}")
        assert f"{tmp_path / 'mlflow.db'} can't be used (database is locked); move it away, or add" in said


def test_tracking_that_fails_in_the_middle_gets_a_sentence(config: Path, tmp_path: Path, capsys, monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise MlflowException("(sqlite3.OperationalError) database is locked\n[SQL: INSERT]")

    monkeypatch.setattr(train.RunRecord, "on_save_checkpoint", fail)
    assert train.main(["fit", "-c", str(config), f"--trainer.default_root_dir={tmp_path / 'run'}"]) == 1
    expected = "train.py: tracking failed ((sqlite3.OperationalError) database is locked [SQL: INSERT]); go on with "
    assert expected in capsys.readouterr().err


def test_a_bad_checkpoint_gets_a_sentence(trained: Path, config: Path, tmp_path: Path, capsys):
    assert "nothere.yaml" in refused(capsys, "fit", "-c", tmp_path / "nothere.yaml")
    assert "add --ckpt_path" in refused(capsys, "test", "-c", config)
    # Nor does a new training begin over the best, where the last one is gone.
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    (tmp_path / "run" / "checkpoints" / "best.ckpt").write_bytes((trained / "checkpoints" / "best.ckpt").read_bytes())
    again = ("fit", "-c", config, "--trainer.default_root_dir", tmp_path / "run", "--ckpt_path", "last")
    assert "last.ckpt does not exist" in refused(capsys, *again)
    garbage = tmp_path / "garbage.ckpt"
    garbage.write_bytes((trained / "checkpoints" / "last.ckpt").read_bytes()[:-1000])
    for command in ("fit", "test", "export"):
        said = refused(capsys, command, "-c", config, "--ckpt_path", garbage)
        assert "garbage.ckpt is not a readable checkpoint; give one that train.py fit wrote." in said


def test_a_checkpoint_whose_inside_is_wrong_gets_a_sentence(
    trained: Path, config: Path, tmp_path: Path, capsys, monkeypatch
):
    """Readable, of these settings, and yet of no use."""
    whole = torch.load(trained / "checkpoints" / "last.ckpt", weights_only=True)
    weights, path = whole["state_dict"], tmp_path / "wrong.ckpt"
    first = next(iter(weights))
    cases = [
        ({"state_dict": {}}, "test", f"holds other weights than this network has, {len(weights)} of them"),
        ({"state_dict": weights | {first: torch.zeros(2)}}, "fit", f"1 of them, such as {first}; give the config"),
        ({"state_dict": weights | {"more": torch.zeros(2)}}, "export", "1 of them, such as more; give the config"),
        ({"optimizer_states": [], "state_dict": weights}, "fit", "holds no state of a training to go on from"),
        ({"optimizer_states": "none"}, "fit", "holds no state of a training to go on from"),
        ({"optimizer_states": [{}]}, "fit", "holds no state of a training to go on from"),
        ({"loops": None}, "fit", "holds no state of a training to go on from"),
        ({"loops": {"fit_loop": {}}}, "validate", "holds no state of a training to go on from"),
        ({"optimizer_states": [{"state": {}, "param_groups": []}] * 3}, "fit", "holds no state of a training to go"),
    ]
    built: list[Any] = []
    with monkeypatch.context() as patch:
        patch.setattr(train.TrainCLI, "_run_subcommand", lambda cli, _: built.append(cli.model))
        assert train.main(["fit", "-c", str(config), "--ckpt_path", "last"]) == 0
    for change, command, expected in cases:
        torch.save(whole | change, path)
        if "state_dict" in change:
            assert expected in refused(capsys, command, "-c", config, "--ckpt_path", path)
        else:
            with pytest.raises(CheckpointError, match=expected):
                require_same_weights(path, built[0], command)
    for data in ({}, {"trained_on": 3}, {"trained_on": {"depth": "stored"}}):
        torch.save(whole | {"ClipDataModule": data}, path)
        output = tmp_path / "out.onnx"
        assert train.main(["export", "-c", str(config), "--ckpt_path", str(path), "--output", str(output)]) == 1
        assert "doesn't say what it was trained on; give one that train.py fit" in capsys.readouterr().err
        assert not output.exists()
    torch.save(whole | {"state_dict": {name: values * torch.nan for name, values in weights.items()}}, path)
    assert train.main(["export", "-c", str(config), "--ckpt_path", str(path), "--output", str(output)]) == 1
    assert f"{output} gives a number that is not finite" in capsys.readouterr().err
    assert list(tmp_path.glob("*.onnx")) == []


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("width", 8, "model.width = 4 and the configuration says 8"),
        ("head", "posterior", "model.head = parameters and the configuration says posterior"),
        ("bounds.force", "[-0.2, 0.0]", "model.bounds.force = [-0.3, 0.0]"),
        ("mechanics.steps", 60, "model.mechanics.steps = 40"),
    ],
)
def test_a_checkpoint_of_another_architecture_is_refused_not_followed(trained, config, capsys, option, value, said):
    assert said in refused(capsys, "test", "-c", config, "--ckpt_path", "best", f"--model.{option}", value)


def test_a_data_set_that_is_not_there_or_a_run_folder_that_can_t_be_made_gets_a_sentence(config, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for root, run, said in (("nothing", "run", str(tmp_path / "nothing")), ("clips", "file/run", "train.py:")):
        folders = [f"--data.root={tmp_path / root}", f"--trainer.default_root_dir={tmp_path / run}"]
        assert train.main(["fit", "-c", str(config), *folders]) == 1
        assert said in capsys.readouterr().err


@pytest.mark.acceptance
def test_killed_training_resumes_and_ends_where_an_uninterrupted_run_ends(config: Path, tmp_path: Path):
    arguments = f"fit -c {config} --trainer.max_epochs 2 --ckpt_path last --trainer.default_root_dir".split()
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert train.main([*arguments, str(whole)]) == 0
    with subprocess.Popen(
        command(*arguments, killed),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    ) as process:
        until_saved(killed)
        process.send_signal(signal.SIGKILL)
    interrupted = last(killed)
    assert interrupted["epoch"] < 1
    assert len(interrupted["optimizer_states"]) == 3
    assert train.main([*arguments, str(killed)]) == 0
    expected, resumed = last(whole), last(killed)
    assert resumed["epoch"] == expected["epoch"] == 1
    assert resumed["global_step"] == expected["global_step"]
    for name, weights in expected["state_dict"].items():
        torch.testing.assert_close(resumed["state_dict"][name], weights, rtol=1e-5, atol=1e-6)
    for ours, theirs in zip(resumed["optimizer_states"], expected["optimizer_states"], strict=True):
        for key, state in theirs["state"].items():
            torch.testing.assert_close(ours["state"][key]["exp_avg"], state["exp_avg"], rtol=1e-4, atol=1e-6)


def together(*commands: list[str], **environment: str) -> list[str]:
    """Run commands at the same time, as nodes 0, 1, … of one training, and return what each said when it ended well."""
    environment |= {"OMP_NUM_THREADS": "1", "MASTER_ADDR": "127.0.0.1"}
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        environment["MASTER_PORT"] = str(free.getsockname()[1])
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    running = [
        subprocess.Popen(each, env=os.environ | environment | {"NODE_RANK": str(node)}, **pipes)
        for node, each in enumerate(commands)
    ]
    try:
        said = [process.communicate(timeout=240)[0] for process in running]
    finally:
        for process in running:
            process.kill()
    assert [process.returncode for process in running] == [0] * len(running), said
    return said


@pytest.mark.acceptance
def test_two_processes_fit_and_test_to_one_process_s_numbers(config: Path, tmp_path: Path, capsys):
    """A batch of two samples in one process, one of one sample in each of two; 7 samples to validate and to test."""
    same = "--model.noise 0 --model.weights.cycle 0 --model.weights.identity 0"
    same += " --data.samples.onset_within 7 --trainer.deterministic true"
    arguments = ["-c", str(config), *same.split()]
    one, two = tmp_path / "one", tmp_path / "two"
    assert train.main(["fit", *arguments, f"--trainer.default_root_dir={one}"]) == 0
    tested = ["test", *arguments, f"--ckpt_path={one / 'checkpoints' / 'last.ckpt'}", "--trainer.default_root_dir"]
    capsys.readouterr()
    assert train.main([*tested, str(one)]) == 0
    apart = ["--trainer.num_nodes=2", "--data.loading.batch_size=1"]
    fit = ["fit", *arguments, "--trainer.default_root_dir", str(two), *apart]
    code = f"from palpate.cli.train import main\nassert main({fit}) == main({[*tested, str(two), apart[0]]}) == 0"
    told = capsys.readouterr().out, together(*[[sys.executable, "-c", code]] * 2)[0]
    expected, found = last(one), last(two)
    assert found["global_step"] == expected["global_step"] == 3 * 14 / 2
    for name, weights in expected["state_dict"].items():
        if name.startswith("discriminator") and name.endswith("weight"):  # instance norm hides biases from the loss
            assert (found["state_dict"][name] - weights).abs().mean() < 4e-5  # 7 steps of at most 2e-4
    logged = [read_rows(folder / "logs" / "version_0" / "metrics.csv") for folder in (one, two)]
    for ours, theirs in zip(*logged, strict=True):
        for name, value in theirs.items():
            assert not value or float(ours[name]) == pytest.approx(float(value), rel=0.05), name
    results = []
    for folder, text in zip((one, two), told, strict=True):
        means = {name: float(number) for name, number in re.findall(r"test/(\w+) +│ +(\S+)", text)}
        results.append((means, read_rows(folder / "evaluation" / "per_frame.csv")))
    (means, rows), (means_of_two, rows_of_two) = results
    assert len(means) == 4
    assert means_of_two == pytest.approx(means, rel=1e-5)
    assert [row["frame"] for row in rows_of_two] == [row["frame"] for row in rows]
    assert len(rows) == 7
    for name in ("error_predicted", "next_depth_error"):
        values, values_of_two = ([float(row[name]) for row in each] for each in (rows, rows_of_two))
        assert values_of_two == pytest.approx(values, rel=1e-4)


@pytest.mark.acceptance
def test_where_one_process_diverges_all_end_with_a_sentence(config: Path, tmp_path: Path):
    """The second, which the first has started."""
    program = tmp_path / "diverging.py"
    program.write_text(
        "from palpate.common.doors import enter_door, run_door\nfrom palpate.cli import train\n"
        "from palpate.models import losses\n"
        "from lightning.pytorch.utilities import rank_zero_only\ntotal = losses.total\n"
        "losses.total = lambda *a: total(*a) * (float('nan') if rank_zero_only.rank == 1 else 1.0)\n"
        "enter_door()\nrun_door(train.main)\n"
    )
    arguments = ("fit", "-c", config, "--trainer.devices", 2, "--trainer.default_root_dir", tmp_path / "run")
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(CHECKOUT)}
    done = subprocess.run(
        [sys.executable, str(program), *map(str, arguments)],
        **{"capture_output": True, "text": True, "env": environment, "timeout": 240, "check": False},
    )
    assert done.returncode != 0
    said = sorted(line for line in done.stderr.splitlines() if line.startswith("diverging.py:"))
    assert len(said) == 2, done.stderr
    assert "diverging.py: the loss is nan in epoch 0 at video" in said[0]
    assert said[1] == "diverging.py: the loss of another process is not finite; it says where, and what to do."
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("more", ["devices=2", "num_nodes=2", "strategy=ddp"])
def test_several_processes_look_for_the_parameters_that_a_backward_pass_leaves_out(config, monkeypatch, tmp_path, more):
    built: list[Any] = []

    def build(cli: train.TrainCLI, _: str) -> None:
        cli.model.trainer = cli.trainer
        cli.model.setup("fit")
        built.append(cli.trainer.strategy)

    monkeypatch.setattr(train.TrainCLI, "_run_subcommand", build)
    arguments = ["fit", "-c", str(config), f"--trainer.{more}", f"--trainer.default_root_dir={tmp_path / 'run'}"]
    assert train.main(arguments) == 0
    assert built[0]._ddp_kwargs == {"find_unused_parameters": True}


def test_going_on_follows_the_configuration_s_learning_rate(config: Path, tmp_path: Path):
    """The checkpoint's optimisers bring their own, which a user who lowers it after a divergence does not want."""
    arguments = ["fit", "-c", str(config), f"--trainer.default_root_dir={tmp_path / 'run'}", "--ckpt_path", "last"]
    few = ["--trainer.limit_train_batches=1", "--trainer.limit_val_batches=1"]
    assert train.main([*arguments, *few]) == 0
    changed = ["--model.learning_rate=1e-5", "--model.betas=[0.7,0.9]"]
    assert train.main([*arguments, *few, "--trainer.max_epochs=2", *changed]) == 0
    groups = [group for state in last(tmp_path / "run")["optimizer_states"] for group in state["param_groups"]]
    assert [(group["lr"], *group["betas"]) for group in groups] == [(1e-5, 0.7, 0.9)] * 3


def test_ctrl_c_ends_cleanly_and_keeps_the_last_checkpoint(config: Path, tmp_path: Path, capsys):
    folder, before = tmp_path / "run", signal.getsignal(signal.SIGINT)

    def press() -> None:
        until_saved(folder)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=press).start()
    try:
        arguments = ["--trainer.max_epochs", "500", "--trainer.default_root_dir", str(folder)]
        assert train.main(["fit", "-c", str(config), *arguments]) == 130
    finally:
        signal.signal(signal.SIGINT, before)  # Lightning leaves it ignored
    said = "".join(capsys.readouterr())
    assert "--ckpt_path last" in said
    assert "Traceback" not in said
    assert last(folder)["epoch"] >= 0


@pytest.mark.parametrize("stop", [SystemExit(1), RuntimeError("the file is not complete")])
def test_what_an_interruption_leads_to_is_one(config: Path, monkeypatch, stop: BaseException):
    """Writing a checkpoint, say, ends with an error of its own."""

    def interrupted(*_, **__) -> None:
        try:
            try:
                raise KeyboardInterrupt
            finally:
                raise OSError("cut")
        except OSError:
            raise stop  # noqa: B904

    monkeypatch.setattr(train, "TrainCLI", interrupted)
    assert train.main(["fit", "-c", str(config)]) == 130
    monkeypatch.setattr(train, "TrainCLI", lambda *_, **__: (_ for _ in ()).throw(type(stop)("other")))
    with pytest.raises(type(stop), match="other"):
        train.main(["fit", "-c", str(config)])


def artifacts(client: MlflowClient, run_id: str, folder: str | None = None) -> set[str]:
    """Paths of all files of a run below a folder."""
    found = client.list_artifacts(run_id, folder)
    return {path for each in found for path in (artifacts(client, run_id, each.path) if each.is_dir else {each.path})}


@pytest.mark.slow
def test_one_mlflow_run_holds_fit_resume_test_and_export(clips: Path, config: Path, tmp_path: Path):
    folder, output = tmp_path / "größe", tmp_path / "out.onnx"
    given = ["-c", str(config), "--tracking", "true", f"--trainer.default_root_dir={folder}", "--run_name", "a/first"]
    assert train.main(["fit", *given]) == 0
    assert train.main(["fit", *given, "--ckpt_path", "last", "--trainer.max_epochs", "2"]) == 0
    assert train.main(["validate", *given, "--ckpt_path", "best"]) == 0
    assert train.main(["test", *given, "--ckpt_path", "best"]) == 0
    assert train.main(["export", *given, "--ckpt_path", "best", "--output", str(output)]) == 0
    client = MlflowClient(f"sqlite:///{tmp_path / 'mlflow.db'}")
    experiment = client.get_experiment_by_name("palpate")
    [run] = client.search_runs([experiment.experiment_id])
    assert (run.info.run_name, run.info.status) == ("a/first", "FINISHED")
    assert last(folder)[tracking.RUN_ID] == run.info.run_id

    terms = {f"train/{term}" for term in TERMS}
    others = {"val/physics", "val/stiffness_mean", "val/stiffness_sd", "validate-val/physics", "test/error_predicted"}
    assert terms | others <= run.data.metrics.keys()
    history = [metric.step for metric in client.get_metric_history(run.info.run_id, "val/physics")]
    assert len(history) == 2  # an epoch before resuming, and one after
    assert history[0] < history[1]
    parameters = run.data.params
    assert (parameters["width"], parameters["data/samples/observation"]) == ("4", "trajectory")
    assert parameters["trainer/max_epochs"] == "1"  # as it began; what resumed it is in configs/

    files = artifacts(client, run.info.run_id)
    commands = ("fit", "fit", "validate", "test", "export")
    configs = [f"configs/{number}_{command}.yaml" for number, command in enumerate(commands, start=1)]
    assert {*configs, "best/best.ckpt", "last/last.ckpt", "evaluation/table_2.csv", "network/out.onnx"} <= files
    settings = [yaml.safe_load(mlflow.artifacts.load_text(f"{run.info.artifact_uri}/{path}")) for path in configs]
    assert [each["trainer"]["max_epochs"] for each in settings] == [1, 2, 1, 1, 1]
    kept = client.download_artifacts(run.info.run_id, "last/last.ckpt", str(tmp_path))
    assert Path(kept).read_bytes() == (folder / "checkpoints" / "last.ckpt").read_bytes()

    [given_data] = run.inputs.dataset_inputs
    assert given_data.dataset.name == clips.name
    assert given_data.dataset.digest == sha256_of(clips)[:16]


def test_a_checkpoint_s_run_goes_on_where_the_database_has_it(trained: Path, config: Path, tmp_path: Path, monkeypatch):
    folder, checkpoint = tmp_path / "run", tmp_path / "other.ckpt"
    first = tracking.RunLogger(folder).run_id
    client = MlflowClient(f"sqlite:///{tmp_path / 'mlflow.db'}")
    assert client.get_run(first).info.run_name == "run"
    torch.save(last(trained) | {tracking.RUN_ID: first}, checkpoint)
    assert tracking.RunLogger(folder, "renamed", checkpoint).run_id == first
    assert client.get_run(first).info.run_name == "renamed"
    client.delete_run(first)
    assert tracking.RunLogger(folder, None, checkpoint).run_id != first

    asked: list[tuple] = []

    def loggers(*arguments: object) -> list:
        asked.append(arguments)
        return []

    monkeypatch.setattr(train, "loggers_of", loggers)
    monkeypatch.setattr(train.TrainCLI, "_run_subcommand", lambda *_: None)
    for command in ("fit", "test"):  # a training that begins with another's weights is a run of its own
        assert train.main([command, "-c", str(config), "--ckpt_path", str(checkpoint), "--run_name", "mine"]) == 0
    run = str(config.parent / "run")
    assert asked == [(run, False, "mine", None, "fit"), (run, False, "mine", str(checkpoint), "test")]


@pytest.mark.slow
def test_paper_yaml_trains_resumes_and_evaluates_a_root_in_the_real_layout(tmp_path: Path):
    """Four videos of two folders that follow on, split by name: pairs across the folders, one clip a video."""
    for number in range(1, 5):
        for start in (80, 83):
            name = f"video{number:02d}"
            write_clip(tmp_path / "data" / name / f"{name}_{start:05d}", (0, 1, 2), 3, first=start)
    names = [f"video{number:02d}" for number in range(1, 5)]
    smaller = "--model.width 4 --model.residual_blocks 1 --tracking false --trainer.accelerator cpu"
    smaller += " --trainer.enable_progress_bar false --trainer.enable_model_summary false --data.depth.source stored"
    smaller += f" --data.geometry.height 48 --data.geometry.width 64 --trainer.default_root_dir {tmp_path / 'run'}"
    smaller += f" --data.root {tmp_path / 'data'} --data.cache {tmp_path / 'cache'}"
    parts = {"train": f"[{','.join(names[:2])}]", "val": f"[{names[2]}]", "test": f"[{names[3]}]"}
    smaller += " --model.mechanics.steps 40 --model.mechanics.load_steps 10"
    given = ["-c", str(CHECKOUT / "configs" / "paper.yaml"), *smaller.split()]
    given += [f"--data.loading.videos.{part}={videos}" for part, videos in parts.items()]
    assert train.main(["fit", *given, "--trainer.max_epochs=1"]) == 0
    assert last(tmp_path / "run")["epoch"] == 0
    assert train.main(["fit", *given, "--trainer.max_epochs=2", "--ckpt_path=last"]) == 0
    checkpoint = last(tmp_path / "run")
    assert (checkpoint["epoch"], checkpoint["global_step"]) == (1, 3 * 2 * 5)  # 10 pairs, two a step, three optimisers
    assert train.main(["test", *given, "--ckpt_path=best"]) == 0
    rows = read_rows(tmp_path / "run" / "evaluation" / "per_frame.csv")
    assert [(row["clip"], row["frame"]) for row in rows] == [("video04_00080", str(frame)) for frame in range(5)]
