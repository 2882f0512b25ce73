"""Checkpoints as `train.py fit` writes them, of generators that do what is known."""

from pathlib import Path
from typing import Literal

import torch
import yaml

from palpate.data.contact.features import FEATURES
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES
from palpate.models.checkpoint import load_posterior
from palpate.models.module import PhysicsInformedGAN
from palpate.models.onnx_session import SHIPPED
from palpate.physics.mechanics import RECOMMENDED, Mechanics


def write_checkpoint(path: Path, decoder: Literal["direct", "residual", "physics"] = "physics") -> Path:
    """Of a generator with the shipped head whose decoder's layers add nothing, four frames ahead."""
    told = {"contact_features": FEATURES + SEQUENCE_FEATURES, "bounds": RECOMMENDED}
    told |= {"mechanics": Mechanics(scheme="dkd", window_error=1e-4), "decoder": decoder, "head": "posterior"}
    module = PhysicsInformedGAN(window=2, width=4, residual_blocks=1, **told)
    load_posterior(module.generator_ab.posterior, SHIPPED)
    with torch.no_grad():
        for parameter in module.generator_ab.decoder.output.parameters():
            parameter.zero_()
    configuration = yaml.safe_dump({"data": {"samples": {"horizon": 4}}})
    written = {"state_dict": module.state_dict(), "hyper_parameters": dict(module.hparams)}
    torch.save(written | {"configuration": configuration}, path)
    return path
