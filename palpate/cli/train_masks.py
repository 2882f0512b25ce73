"""Trains the network that outlines instruments, and exports it.

    palpate train fit -c configs/masks.yaml [--data.real DIR] [--output FILE.onnx] [--ckpt_path last]

Lightning's command line; the run folder (`trainer.default_root_dir`) gets log and checkpoints.
"""

from pathlib import Path
from typing import Any

import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI
from lightning.pytorch.loggers import CSVLogger

from palpate.data.source.layout import InputError

EVERY = 200
"""Steps from checkpoint to checkpoint."""


class MasksCLI(LightningCLI):
    """Command line of the training."""

    @staticmethod
    def subcommands() -> dict[str, set[str]]:
        loaders = {"model", "dataloaders", "train_dataloaders", "val_dataloaders", "datamodule", "weights_only"}
        return {"fit": loaders, "validate": loaders}

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        parser.add_argument("--output", type=Path | None, default=None, help="ONNX file; by default in the run folder.")

    def instantiate_trainer(self, **kwargs: Any) -> Any:
        folder = Path(self._get(self.config_init, "trainer.default_root_dir"))
        saved = ModelCheckpoint(folder, every_n_train_steps=EVERY, save_last=True, save_top_k=0)
        return super().instantiate_trainer(
            **kwargs, logger=CSVLogger(folder, name="log"), callbacks=[saved], use_distributed_sampler=False
        )

    def before_fit(self) -> None:
        """Refuse to begin beside the checkpoints of another training.

        Raises:
            InputError: there are some.
        """
        config = self.config["fit"]
        folder = config.trainer.default_root_dir
        if config.ckpt_path is None and any(Path(folder).glob("*.ckpt")):
            other = "add --ckpt_path last to go on with it, or give another --trainer.default_root_dir"
            raise InputError(f"{folder} holds a training already; {other}.")

    def after_fit(self) -> None:
        """Export the averaged network."""
        config = self.config["fit"]
        output = config.output or Path(config.trainer.default_root_dir) / "instruments.onnx"
        pictures = torch.cat([batch[0] for batch in self.datamodule.val_dataloader()])
        difference = self.model.export(output, pictures)
        print(f"{output}: written in 8-bit numbers, which decide {difference:.1%} of pixels otherwise")
