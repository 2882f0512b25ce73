"""Pictures that train and validate the instrument network."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from lightning.pytorch import LightningDataModule
from torch.utils.data import DataLoader, TensorDataset

from palpate.data.training.instruments.composites import InstrumentPictures, RealPictures


class InstrumentData(LightningDataModule):
    """Composites drawn on the fly and real pictures; a fixed set of composites validates.

    Args:
        real: a folder, or folders, of real pictures, with outlines NAME_tool.png beside them or without instruments.
        real_share: share of labelled real pictures in a batch.
        batch_size: pictures in a batch.
        workers: processes that draw; two cores draw as fast as one trains.
        validation: number of pictures that validate.
        size: height and width of the pictures that validate [px], at which the exported network runs.
        seed: seed of all random numbers.
    """

    def __init__(
        self,
        real: list[Path] | Path | None = None,
        real_share: float = 0.25,
        batch_size: int = 16,
        workers: int = 1,
        validation: int = 64,
        size: tuple[int, int] = (224, 384),
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.save_hyperparameters()
        self.real_pictures = RealPictures.read([real] if isinstance(real, Path) else real or [])

    def train_dataloader(self) -> DataLoader:
        """Endless batches."""
        settings = self.hparams
        pictures = InstrumentPictures(self.real_pictures, settings["seed"], settings["real_share"])
        count, size = settings["workers"], settings["batch_size"]
        # Forked workers hang where OpenCV has begun threads before.
        how: dict[str, Any] = {"multiprocessing_context": "spawn", "prefetch_factor": 4} if count else {}
        return DataLoader(pictures, size, num_workers=count, worker_init_fn=_one_thread, **how)

    def val_dataloader(self) -> DataLoader:
        """Composites of a seed of their own."""
        settings = self.hparams
        source = InstrumentPictures(self.real_pictures, real_share=0.0, size=settings["size"])
        rng = np.random.default_rng([settings["seed"], 7])
        drawn = zip(*(source.draw(rng) for _ in range(settings["validation"])), strict=True)
        pictures, tool = (torch.from_numpy(np.stack(each)) for each in drawn)
        return DataLoader(TensorDataset(pictures.permute(0, 3, 1, 2), tool.long()), settings["batch_size"])


def _one_thread(worker: int) -> None:
    cv2.setNumThreads(1)
