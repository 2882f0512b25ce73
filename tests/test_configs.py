"""Every shipped configuration loads, and the paper's says what the paper says."""

from __future__ import annotations

from pathlib import Path

import pytest

import train
from physics.mechanics import Mechanics

# Lightning warns of arguments given from Python beside pytest's own on the command line.
pytestmark = pytest.mark.filterwarnings("ignore:LightningCLI's args parameter")
CHECKOUT = Path(__file__).resolve().parents[1]
SHIPPED = sorted((CHECKOUT / "configs").glob("*.yaml"))


@pytest.fixture
def load(monkeypatch, tmp_path):
    """`load(path)`: the command line after everything is built, just before it would train."""
    monkeypatch.chdir(tmp_path)  # run folders are relative
    built: list[train.TrainCLI] = []
    monkeypatch.setattr(train.TrainCLI, "_run_subcommand", lambda cli, subcommand: built.append(cli))

    def load_configuration(path: Path) -> train.TrainCLI:
        assert train.main(["fit", "-c", str(path), "--tracking", "false", "--trainer.accelerator", "cpu"]) == 0
        return built[-1]

    return load_configuration


def test_the_three_configurations_are_shipped():
    assert [path.stem for path in SHIPPED] == ["paper", "recommended", "smoke"]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_configuration_builds_model_data_and_trainer(load, path: Path):
    cli = load(path)
    assert cli.datamodule.mechanics == cli.model.mechanics
    assert cli.datamodule.bounds == cli.model.bounds
    assert cli.model.generator_ab.channels == cli.datamodule.samples.window
    assert Path(cli.trainer.default_root_dir).parts[0] == "runs"


def test_paper_configuration_is_the_paper_s(load):
    cli = load(CHECKOUT / "configs" / "paper.yaml")
    model, data = cli.model, cli.datamodule
    parameters = sum(p.numel() for net in (model.generator_ab, model.discriminator_b) for p in net.parameters())
    assert abs(parameters / 15.2e6 - 1) < 0.02
    assert vars(model.weights) == {"gan": 1.0, "cycle": 10.0, "identity": 1.0, "physics": 2.0, "regularisation": 0.1}
    assert (model.learning_rate, tuple(model.betas)) == (2e-4, (0.5, 0.999))
    assert (model.bounds.lower, model.bounds.upper) == ((0.0, 0.0, -10.0), (1.0, 1.0, 0.0))
    assert model.mechanics == Mechanics(
        mass=0.001, time_step=0.005, steps=200, load_steps=50, damping="implicit", boundary="fixed"
    )
    assert cli.trainer.max_epochs == 100
    assert (data.loading.batch_size, data.loading.fractions, data.preparation.depth.bits) == (2, (0.7, 0.2, 0.1), 8)
    assert (data.samples.window, data.samples.observation) == (1, "final")
    geometry = data.preparation.geometry
    assert (geometry.height, geometry.width, geometry.max_edge, geometry.keep) == (120, 214, 0.05, 1.0)
    assert (geometry.force_direction, geometry.displacement) == ("normal", "redetected")
    periodic = next(c for c in cli.trainer.checkpoint_callbacks if c.filename.startswith("epoch"))
    assert periodic._every_n_epochs == 10
    best = next(c for c in cli.trainer.checkpoint_callbacks if c.filename == "best")
    assert (best.monitor, best.mode) == ("val/physics", "min")
