"""Checkpoints of the training: reading them safely, and whether a configuration still fits them."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch

from models.posterior import ContactPosterior
from physics.mechanics import Mechanics

FIXED = (
    *("window", "width", "residual_blocks", "decoder", "head", "bounds.stiffness", "bounds.damping", "bounds.force"),
    *(f"mechanics.{field.name}" for field in fields(Mechanics)),
)
"""Model settings that a trained network can't change any more: its shape, and what its θ means."""

WRITER = "python -m estimators.network.training"
"""What writes pretrained posteriors."""
EXPECTED_BOUND = ".expected_bound."
"""In the names of weights by which verdicts are given."""
SINCE = {"head": "parameters"}
"""What settings were that checkpoints of earlier versions don't name."""


class CheckpointError(ValueError):
    """A checkpoint that can't be used, in one sentence with the remedy."""


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Contents of a checkpoint of ours, on the CPU; reading it runs no code.

    Raises:
        CheckpointError: no such file, or not such a checkpoint.
    """
    checkpoint = _read(path, "train.py fit")
    settings, weights = (checkpoint.get(name) for name in ("hyper_parameters", "state_dict"))
    if not (isinstance(settings, dict) and isinstance(weights, dict) and "bounds" in settings):
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
    checkpoint = read_checkpoint(path)
    trained = SINCE | checkpoint["hyper_parameters"]
    for name in FIXED:
        was, now = _field(trained, name), _field(configured, name)
        if was != now:
            raise CheckpointError(
                f"{path} was trained with model.{name} = {was} and the configuration says {now}; "
                "give the configuration it was trained with."
            )
    if trained["head"] == "posterior" and not any(EXPECTED_BOUND in name for name in checkpoint["state_dict"]):
        raise CheckpointError(f"{path} knows no expected bounds, as earlier versions did not; train it again.")


def load_posterior(posterior: ContactPosterior, path: Path) -> None:
    """Give a contact posterior the weights of a file of ours; reading it runs no code.

    The file knows no pictures: that projection stays as it is.

    Raises:
        CheckpointError: no such file, not such a file, or one of another network or box.
    """
    weights = _read(path, WRITER)
    own = {name: value for name, value in posterior.state_dict().items() if not name.startswith("picture.")}
    shapes = {name: getattr(value, "shape", None) for name, value in weights.items()}
    if shapes != {name: value.shape for name, value in own.items()}:
        raise CheckpointError(f"{path} holds no contact posterior of this version; give a file that {WRITER} wrote.")
    for name in ("lower", "upper"):
        if not torch.allclose(weights[name], own[name], atol=1e-4):
            there, here = ([f"{number:.4g}" for number in box[name].exp().tolist()] for box in (weights, own))
            raise CheckpointError(
                f"{path} was trained with {name} bounds of k_s, k_d and |F| of {', '.join(there)}, and model.bounds "
                f"say {', '.join(here)}; give the same bounds, or leave model.pretrained out."
            )
    posterior.load_state_dict(weights, strict=False)


def posterior_features(path: Path) -> int:
    """Length of the vector that a contact posterior of a file of ours is told; reading it runs no code.

    Raises:
        CheckpointError: no such file, or not such a file.
    """
    entry = _read(path, WRITER).get("entry.weight")
    if not isinstance(entry, torch.Tensor) or entry.ndim != 2:
        raise CheckpointError(f"{path} holds no contact posterior of this version; give a file that {WRITER} wrote.")
    return entry.shape[1]


def _read(path: Path, writer: str) -> dict[str, Any]:
    """A dictionary that torch saved, on the CPU, without running code."""
    if not path.is_file():
        raise CheckpointError(f"{path} does not exist; give a file that {writer} wrote.")
    unreadable = f"{path} is not a readable checkpoint; give one that {writer} wrote."
    if not zipfile.is_zipfile(path):  # not a checkpoint at all, or cut short
        raise CheckpointError(unreadable)
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # by where a file is damaged, readers of zip files, pickles or numbers give up
        raise CheckpointError(unreadable) from error
    if not isinstance(content, dict):
        raise CheckpointError(unreadable)
    return content


def _field(settings: Mapping[str, Any], name: str) -> Any:
    """A nested setting by its dotted name, None where there is none; tuples as lists, so that they compare."""
    value: Any = settings
    for part in name.split("."):
        value = value.get(part)
    return list(value) if isinstance(value, tuple) else value
