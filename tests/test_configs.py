"""Every shipped configuration loads, and the paper's says what the paper says."""

import dataclasses
import functools
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from palpate.cli import train
from palpate.estimators.network.training import ContactSettings
from palpate.estimators.online.determined import BENDINGS
from palpate.estimators.online.objective import PAPER
from palpate.estimators.online.settings import OnlineSettings, load_settings
from palpate.models.contact_module import AmortisedPosterior
from palpate.physics.mechanics import Mechanics

# Lightning warns of arguments given from Python beside pytest's own on the command line.
pytestmark = pytest.mark.filterwarnings("ignore:LightningCLI's args parameter")
CHECKOUT = Path(__file__).resolve().parents[1]
ONLINE_FILE = CHECKOUT / "configs" / "online.yaml"
"""Settings of an estimator, which no command trains."""
CONTACT_FILE = CHECKOUT / "configs" / "contact.yaml"
"""Settings of the posterior's training, which `fit` takes as well."""
MASKS_FILE = CHECKOUT / "configs" / "masks.yaml"
"""Settings of the training of the network that outlines instruments, likewise."""
OTHERS = (ONLINE_FILE, CONTACT_FILE, MASKS_FILE)
SHIPPED = [path for path in sorted((CHECKOUT / "configs").glob("*.yaml")) if path not in OTHERS]


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    """`load(path)`: the command line after everything is built, just before it would train."""
    built: list[train.TrainCLI] = []

    @functools.cache
    def load_configuration(path: Path) -> train.TrainCLI:
        assert train.main(["fit", "-c", str(path), "--tracking", "false", "--trainer.accelerator", "cpu"]) == 0
        return built[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("runs"))  # run folders are relative
        patch.setattr(train.TrainCLI, "_run_subcommand", lambda cli, subcommand: built.append(cli))
        yield load_configuration


def test_the_three_configurations_are_shipped():
    assert [path.stem for path in SHIPPED] == ["paper", "recommended", "smoke"]


def test_the_online_estimator_s_file_holds_every_setting_with_its_default():
    values, settings = yaml.safe_load(ONLINE_FILE.read_text(encoding="utf-8")), OnlineSettings()
    assert load_settings(ONLINE_FILE) == settings
    assert leaves(values).keys() == leaves(dataclasses.asdict(settings)).keys()


def test_the_posterior_s_configuration_holds_every_setting_with_its_default(load):
    cli = load(CONTACT_FILE)
    defaults = ContactSettings()
    assert cli.datamodule.settings == defaults
    assert dict(cli.model.hparams).items() >= dict(AmortisedPosterior(cli.datamodule.contact_features).hparams).items()
    settings = yaml.safe_load(CONTACT_FILE.read_text(encoding="utf-8"))
    assert settings["data"]["init_args"] == dataclasses.asdict(defaults)
    assert settings["model"]["init_args"].keys() == {"rough_rate", "fine_rate", "weight_decay"}


def test_the_masks_configuration_builds_its_own_model(load):
    cli = load(MASKS_FILE)
    assert type(cli.model).__name__ == "InstrumentSegmentation"
    assert cli.trainer.default_root_dir == "runs/masks"


@pytest.mark.acceptance
def test_the_masks_configuration_trains_on_own_pictures_and_exports(tmp_path, capsys):
    cv2.imwrite(str(tmp_path / "one.png"), np.full((60, 90, 3), 90, np.uint8))
    cv2.imwrite(str(tmp_path / "one_tool.png"), np.tile(np.repeat(np.uint8([0, 255]), 45), (60, 1)))
    run = tmp_path / "run"
    small = [
        "--tracking=false",
        "--data.batch_size=2",
        "--data.workers=0",
        "--data.validation=1",
        "--trainer.accelerator=cpu",
    ]
    small += ["--trainer.val_check_interval=1", "--trainer.enable_progress_bar=false", f"--data.real={tmp_path}"]
    command = ["fit", "-c", str(MASKS_FILE), *small, f"--trainer.default_root_dir={run}"]
    assert train.main([*command, "--trainer.max_steps=1"]) == 0
    assert "written in 8-bit numbers, which decide" in capsys.readouterr().out
    assert (run / "instruments.onnx").is_file()
    assert train.main([*command, "--trainer.max_steps=2"]) == 2
    assert "holds a training already; add --ckpt_path last" in capsys.readouterr().err


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_configuration_builds_model_data_and_trainer(load, path: Path):
    cli = load(path)
    assert cli.datamodule.mechanics == cli.model.mechanics
    assert cli.datamodule.bounds == cli.model.bounds
    assert cli.model.generator_ab.channels == cli.datamodule.samples.window
    assert Path(cli.trainer.default_root_dir).parts[0] == "runs"


def test_paper_configuration_is_the_paper_s(load):
    """The configuration as built; its fields are compared with what the paper states below."""
    cli = load(CHECKOUT / "configs" / "paper.yaml")
    networks = (cli.model.generator_ab, cli.model.discriminator_b)
    assert abs(sum(p.numel() for net in networks for p in net.parameters()) / 15.2e6 - 1) < 0.02
    assert cli.model.mechanics == Mechanics(mass=0.001, time_step=0.005, steps=200, load_steps=50)
    geometry, samples = cli.datamodule.preparation.geometry, cli.datamodule.samples
    assert (geometry.force_direction, samples.window) == ("normal", 1)
    periodic = next(c for c in cli.trainer.checkpoint_callbacks if c.filename.startswith("epoch"))
    assert periodic._every_n_epochs == 10
    best = next(c for c in cli.trainer.checkpoint_callbacks if c.filename == "best")
    assert (best.monitor, best.mode) == ("val/physics", "min")


def leaves(settings: dict[str, Any], above: str = "") -> dict[str, Any]:
    """Values of nested mappings by their dotted names, as an option names them; `videos` is one value."""
    found: dict[str, Any] = {}
    for name, value in settings.items():
        nested = isinstance(value, dict) and name != "videos"
        below = above if name == "init_args" else f"{above}{name}."
        found |= leaves(value, below) if nested else {f"{above}{name}": value} if name != "class_path" else {}
    return found


MODEL: dict[str, Any] = {"width": 64, "residual_blocks": 9, "decoder": "direct", "learning_rate": 2e-4}
MODEL |= {"betas": [0.5, 0.999], "weights": {"gan": 1.0, "cycle": 10.0, "identity": 1.0, "physics": 2.0}}
MODEL |= {"bounds": {"stiffness": [0.0, 1.0], "damping": [0.0, 1.0], "force": [-10.0, 0.0]}}
MODEL["bounds"] |= {"initial": [5.34, 0.127, None]}  # of a force none is given
MODEL |= {"mechanics": {"mass": 0.001, "time_step": 0.005, "steps": 200, "load_steps": 50, "scheme": "euler"}}
DATA: dict[str, Any] = {"samples": {"observation": "final"}, "masks": "annotation"}
DATA |= {"loading": {"batch_size": 2, "fractions": [0.7, 0.2, 0.1]}}
DATA |= {"classes": {"tool": ["grasper"], "tissue": ["gallbladder"], "tolerance": 5}}
DATA |= {"depth": {"source": "depthpro-canonical", "bits": 8, "rounded": "picture"}}
DATA |= {"geometry": {"height": 120, "width": 214, "max_edge": 0.05, "smoothing": 0.0, "keep": 1.0}}
DATA["geometry"] |= {"contact": "nearest", "two_pass": True, "displacement": "redetected", "rigid_motion": "keep"}
STATED = leaves({"trainer": {"max_epochs": 100}, "model": MODEL, "data": DATA})
"""What Bini 2026 states, by the fields of paper.yaml."""
OURS = {"seed_everything", "trainer.default_root_dir", "trainer.accelerator", "trainer.devices", "data.root"}
OURS |= {"data.loading.num_workers"}
"""Fields that say where and on what to run."""
IN_CODE = {"damping", "rim", "hidden edge", "anchor", "resizing", "holes", "depth", "discriminator", "first block"}
IN_CODE |= {"head", "input", "mesh", "d_obs", "directions", "checkpointing", "pairs", "no contact"}
"""Departures that no field can undo."""
ONLINE: dict[str, Any] = {"particles": 600}
ONLINE |= {"points": 9000, "start": {"distance": 1.0, "shape": 0.1}}
ONLINE |= {"method": {"name": "PBD-RM-ON", "optimizer": "adam", "rate": 0.1}, "mapping": {"steps": 30, "rate": 50.0}}
ONLINE |= {"bounds": {"distance": 10.0, "shape": 0.02}}
ONLINE |= {"weights": {"gap": 1.0, "history": 1.0, "smoothness": 1.0}}
ONLINE_STATED = leaves(ONLINE)
"""What Liang 2024 states, by the fields of online.yaml."""
ONLINE_OURS = {"thickness"}
ONLINE_IN_CODE = {
    "match",
    "background",
    "pins, gripper",
    "sums",
    "smoothness",
    "lengths",
    "volumes",
    "snapshots",
    "visible",
}
IN_EVALUATION = {"truth", "starts", "match, optimizer", "DiffCloud", "Chamfer distance", "keypoints"}
IN_EVALUATION |= {"figures 5 and 7", "figure 6"}
HEADINGS = ("Departures in fields", "Departures in the code", "What the paper leaves open")
EVALUATED = "Departures in the evaluation"


def listed(head: list[str]) -> dict[str, set[str]]:
    """Names in the lists of a file's head, by heading."""
    names: dict[str, set[str]] = {}
    current: set[str] = set()
    for line in head:
        heading = next((each for each in (*HEADINGS, EVALUATED) if line.startswith(f"# {each}")), None)
        entry = re.fullmatch(r"#   (\S+(?: \S+)*)  +\S.*", line)
        if heading is not None:
            names[heading] = current = set()
        elif entry is not None:
            current.add(entry[1])
    return names


@pytest.mark.parametrize(
    ("name", "first", "stated", "ours", "in_code", "evaluated"),
    [
        ("paper", "seed_everything", STATED, OURS, IN_CODE, set()),
        ("online", "particles", ONLINE_STATED, ONLINE_OURS, ONLINE_IN_CODE, IN_EVALUATION),
    ],
)
def test_the_head_lists_what_differs_from_the_paper(name, first, stated, ours, in_code, evaluated):
    text = (CHECKOUT / "configs" / f"{name}.yaml").read_text(encoding="utf-8")
    head = [line for line in text.splitlines() if line.startswith("#")]
    fields, code, left_open = (listed(head)[heading] for heading in HEADINGS)
    values = leaves(yaml.safe_load(text))
    assert values.keys() == stated.keys() | left_open | ours
    assert not left_open & stated.keys()
    assert fields == {each for each, value in stated.items() if values[each] != value}
    assert code == in_code
    assert listed(head).get(EVALUATED, set()) == evaluated
    body = text[text.index(f"\n{first}:") :]
    for mark, names in (("departure", fields), ("open", left_open)):
        marked = set(re.findall(rf"^ *(\w+):[^#\n]*# {mark}\b", body, re.MULTILINE))
        assert marked == {each.split(".")[-1] for each in names}


def test_the_paper_s_bounds_and_what_passes_them_are_as_the_list_says():
    assert dataclasses.asdict(PAPER) == {name: ONLINE_STATED[f"bounds.{name}"] for name in ("distance", "shape")}
    text = " ".join(ONLINE_FILE.read_text(encoding="utf-8").replace("#", " ").split())
    assert f"Of what `fitted` tries, {BENDINGS[0]:g}, {BENDINGS[1]:g} and {BENDINGS[2]:g} times" in text
    settings = OnlineSettings()
    assert settings.bounds.shape == max(BENDINGS) * settings.bounds.distance  # no smaller one allows all of them
