"""Checkpoints of the training: reads them safely, and compares configurations with them."""

import json
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch

from palpate.models.onnx_session import METADATA_KEY
from palpate.models.posterior import ContactPosterior
from palpate.physics.mechanics import Bounds, Mechanics

WRITER = "train.py fit -c configs/contact.yaml"
"""The command that writes pretrained posteriors, for messages."""
VERSION = "pytorch-lightning_version"
"""Name of Lightning's version in a checkpoint."""


class CheckpointError(ValueError):
    """Error: a checkpoint can't be used; the message is a sentence with the remedy."""


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Contents of a checkpoint that `train.py fit` wrote, on the CPU; reading it runs no code.

    Raises:
        CheckpointError: no such file, or not such a checkpoint.
    """
    checkpoint = _read(path, "train.py fit")
    kinds = {"hyper_parameters": dict, "state_dict": dict, "callbacks": dict, VERSION: str}
    if not all(isinstance(checkpoint.get(name), kind) for name, kind in kinds.items()):
        raise CheckpointError(f"{path} is a checkpoint of another program; give one that train.py fit wrote.")
    return checkpoint


def require_same_model(path: Path, configured: Mapping[str, Any]) -> None:
    """Refuse a configuration of another network than the checkpoint's.

    Args:
        path: checkpoint.
        configured: arguments of `PhysicsInformedGAN` as nested plain values.

    Raises:
        CheckpointError: the checkpoint can't be read, or the network's shape or the meaning of its θ differs; the
            message names the setting.
    """
    trained = read_checkpoint(path)["hyper_parameters"]
    shape = ("window", "width", "residual_blocks", "decoder", "head")
    meaning = ("bounds.stiffness", "bounds.damping", "bounds.force")
    for name in (*shape, *meaning, *(f"mechanics.{field.name}" for field in fields(Mechanics))):
        was, now = _field(trained, name), _field(configured, name)
        if was != now:
            problem = f"{path} was trained with model.{name} = {was} and the configuration says {now};"
            raise CheckpointError(f"{problem} give the configuration it was trained with.")


def require_same_weights(path: Path, model: Any, command: str) -> None:
    """Refuse a checkpoint that a network can't take over, although the settings agree.

    Args:
        path: checkpoint.
        model: LightningModule with its optimisers.
        command: fit (which resumes a training), validate, test or export.

    Raises:
        CheckpointError: weights of other names or shapes, or no state to resume from.
    """
    checkpoint = read_checkpoint(path)
    here = {name: value.shape for name, value in model.state_dict().items()}
    there = {name: getattr(value, "shape", None) for name, value in checkpoint["state_dict"].items()}
    other = [name for name in {**here, **there} if here.get(name) != there.get(name)]
    if other:
        problem = f"{path} holds other weights than this network has, {len(other)} of them, such as {other[0]};"
        raise CheckpointError(f"{problem} give the configuration it was trained with.")
    try:
        if command == "fit":
            found = model.configure_optimizers()
            optimizers = found[0] if isinstance(found, tuple) else found
            for optimizer, state in zip(optimizers, checkpoint["optimizer_states"], strict=True):
                optimizer.load_state_dict(state)
        if command != "export":
            dict(**checkpoint["loops"][f"{command}_loop"])
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        problem = "holds no state of a training to go on from; give the last.ckpt of a run folder"
        raise CheckpointError(f"{path} {problem}.") from error


def load_posterior(posterior: ContactPosterior, path: Path) -> None:
    """Load the weights of a file that WRITER wrote, or of an exported file, into a posterior; reading it runs no code.

    The posterior's own projection of picture features stays, as files have none. An exported calibration is left out.

    Raises:
        CheckpointError: no such file, not such a file, or one of another network or box.
    """
    weights = _exported(path) if path.suffix == ".onnx" else _read(path, WRITER)
    own = {name: value.cpu() for name, value in posterior.state_dict().items() if not name.startswith("picture.")}
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


def _exported(path: Path) -> dict[str, torch.Tensor]:
    """Weights of an exported contact posterior by their names in torch."""
    import onnx  # heavy, and seldom wanted

    try:
        model = onnx.load(path)
        graph, metadata = model.graph, {entry.key: entry.value for entry in model.metadata_props}
        weights = {
            name: torch.from_numpy(onnx.numpy_helper.to_array(item).copy())
            for item in graph.initializer
            if (name := item.name.removeprefix("network.")) != item.name
        }
        box = Bounds(**json.loads(metadata[METADATA_KEY])["bounds"]).log_box
    except OSError as error:
        raise CheckpointError(f"{path} can't be read ({error.strerror}); give a file that {WRITER} wrote.") from error
    except Exception as error:  # protobuf's, JSON's, and those of missing entries
        raise CheckpointError(f"{path} is no exported contact posterior; give one, or what {WRITER} wrote.") from error
    # The exporter keeps the box in another form, so it is restored from the metadata.
    return weights | dict(zip(("lower", "upper"), torch.tensor(box, dtype=torch.float32), strict=True))


def _read(path: Path, writer: str) -> dict[str, Any]:
    """A dictionary that torch saved, on the CPU, without running code."""
    if not path.is_file():
        raise CheckpointError(f"{path} does not exist; give a file that {writer} wrote.")
    unreadable = f"{path} is not a readable checkpoint; give one that {writer} wrote."
    if not zipfile.is_zipfile(path):  # not a checkpoint at all, or cut short
        raise CheckpointError(unreadable)
    try:
        with warnings.catch_warnings(action="ignore"):  # torch warns of pickles that it did not write
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # zip, pickle or number readers fail, depending on the damage
        raise CheckpointError(unreadable) from error
    if not isinstance(content, dict):
        raise CheckpointError(unreadable)
    return content


def _field(settings: Mapping[str, Any], name: str) -> Any:
    """A nested setting by its dotted name, or None; tuples become lists, for comparison."""
    value: Any = settings
    for part in name.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return list(value) if isinstance(value, tuple) else value
