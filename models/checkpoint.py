"""Checkpoints of the training: reading them safely, and whether a configuration still fits them."""

from __future__ import annotations

import pickle
import zipfile
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch

from physics.mechanics import Mechanics

FIXED = (
    *("window", "width", "residual_blocks", "decoder", "bounds.stiffness", "bounds.damping", "bounds.force"),
    *(f"mechanics.{field.name}" for field in fields(Mechanics)),
)
"""Model settings that a trained network can't change any more: its shape, and what its θ means."""


class CheckpointError(ValueError):
    """A checkpoint that can't be used, in one sentence with the remedy."""


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Contents of a checkpoint of ours, on the CPU; reading it runs no code.

    Raises:
        CheckpointError: no such file, or not such a checkpoint.
    """
    if not path.is_file():
        raise CheckpointError(f"{path} does not exist; give a checkpoint that train.py fit wrote.")
    unreadable = f"{path} is not a readable checkpoint; give one that train.py fit wrote."
    if not zipfile.is_zipfile(path):  # not a checkpoint at all, or cut short
        raise CheckpointError(unreadable)
    try:
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError) as error:
        raise CheckpointError(unreadable) from error
    if "bounds" not in checkpoint.get("hyper_parameters", {}) or "state_dict" not in checkpoint:
        raise CheckpointError(f"{path} is a checkpoint of another program; give one that train.py fit wrote.")
    return checkpoint


def require_same_model(path: Path, configured: Mapping[str, Any]) -> None:
    """Refuse a configuration of another network than the checkpoint's.

    Args:
        path: checkpoint.
        configured: arguments of `PhysicsInformedGAN`, nested plain values.

    Raises:
        CheckpointError: the checkpoint can't be read, or one of `FIXED` differs; the message names it.
    """
    trained = read_checkpoint(path)["hyper_parameters"]
    for name in FIXED:
        was, now = _field(trained, name), _field(configured, name)
        if was != now:
            raise CheckpointError(
                f"{path} was trained with model.{name} = {was} and the configuration says {now}; "
                "give the configuration it was trained with."
            )


def _field(settings: Mapping[str, Any], name: str) -> Any:
    """A nested setting by its dotted name, None where there is none; tuples as lists, so that they compare."""
    value: Any = settings
    for part in name.split("."):
        value = value.get(part)
    return list(value) if isinstance(value, tuple) else value
