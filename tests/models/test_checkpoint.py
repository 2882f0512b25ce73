"""Checkpoints that can't be used get a sentence, and none is followed into another network."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest
import torch

from models.checkpoint import CheckpointError, read_checkpoint, require_same_model
from models.module import PhysicsInformedGAN
from physics.mechanics import Bounds, Mechanics

SETTINGS = {
    "window": 1,
    "width": 4,
    "residual_blocks": 1,
    "decoder": "direct",
    "bounds": asdict(Bounds()),
    "mechanics": asdict(Mechanics(steps=40, load_steps=10)),
}


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    module = PhysicsInformedGAN(width=4, residual_blocks=1, mechanics=Mechanics(steps=40, load_steps=10))
    path = tmp_path / "last.ckpt"
    torch.save({"state_dict": module.state_dict(), "hyper_parameters": dict(module.hparams)}, path)
    return path


def test_the_same_model_passes_and_where_it_starts_does_not_matter(checkpoint: Path):
    require_same_model(checkpoint, SETTINGS)
    require_same_model(checkpoint, SETTINGS | {"bounds": asdict(Bounds(initial=(0.2, 0.2, -1.0)))})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 8}, r"model\.width = 4 and the configuration says 8"),
        ({"decoder": "residual"}, r"model\.decoder = direct"),
        ({"window": 2}, r"model\.window = 1"),
        ({"bounds": asdict(Bounds(force=(-6.0, 0.0)))}, r"model\.bounds\.force = \[-10\.0, 0\.0\]"),
        ({"mechanics": asdict(Mechanics(steps=60, load_steps=10))}, r"model\.mechanics\.steps = 40"),
    ],
)
def test_another_model_is_refused_by_name(checkpoint: Path, change: dict, message: str):
    with pytest.raises(CheckpointError, match=message):
        require_same_model(checkpoint, SETTINGS | change)


def test_unusable_files(checkpoint: Path, tmp_path: Path):
    with pytest.raises(CheckpointError, match="does not exist"):
        read_checkpoint(tmp_path / "nothing.ckpt")
    broken = tmp_path / "broken.ckpt"
    for content in (b"", b"not a checkpoint", checkpoint.read_bytes()[:-1000]):
        broken.write_bytes(content)
        with pytest.raises(CheckpointError, match="not a readable checkpoint"):
            read_checkpoint(broken)
    torch.save({"weights": torch.zeros(2)}, broken)
    with pytest.raises(CheckpointError, match="another program"):
        read_checkpoint(broken)


def test_reading_runs_no_code(tmp_path: Path):
    path = tmp_path / "module.ckpt"
    torch.save({"state_dict": torch.nn.Linear(1, 1), "hyper_parameters": {"bounds": {}}}, path)
    with pytest.raises(CheckpointError, match="not a readable checkpoint"):
        read_checkpoint(path)
