"""Batches for the training of the contact posterior: those of a stage in each epoch."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from lightning.pytorch import LightningDataModule

from palpate.common.ahead import ahead


class TrainingError(ValueError):
    """There is nothing to train on; the message is a sentence."""


class ContactSource(ABC):
    """Simulated contacts with noise, and what explains each.

    An explanation is a fit of the simulator, which belongs to the estimators; this package doesn't know them.
    """

    features: int
    """Length of a contact's vector, F."""
    steps: tuple[int, int, int]
    """Batches of each stage."""

    @abstractmethod
    def rough(self, step: int) -> Any:
        """A batch of the first stage by its number: `features` [B, F] and `likelihoods`, numpy arrays."""

    @abstractmethod
    def explain(self, estimate: Callable[[np.ndarray], np.ndarray]) -> None:
        """Explain every motion, from estimates [N, 3] of φ by vectors [N, F]; done once."""

    @abstractmethod
    def fine(self, step: int) -> Any:
        """A batch of the other stages: `features`, `logs`, `information` and `pull`, numpy arrays."""

    @abstractmethod
    def standardise(self, stage: int, set_scale: Callable[..., None]) -> None:
        """Give the examples, by which a stage's inputs are standardised, to `ContactPosterior.standardise`."""


@dataclass
class Batches:
    """So many batches, each made in a thread of its own while the one before is used."""

    make: Callable[[int], Any]
    count: int

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Any]:
        return ahead(map(self.make, range(self.count)), 1)


class ContactData(LightningDataModule):
    """Contacts in three stages (`palpate.models.contact_module`).

    Args:
        source: contacts, and how they are explained.
    """

    def __init__(self, source: ContactSource) -> None:
        super().__init__()
        self.source = source

    @property
    def contact_features(self) -> int:
        """Length of a contact's vector."""
        return self.source.features

    def transfer_batch_to_device(self, batch: Any, device: torch.device, dataloader_idx: int) -> Any:
        """Leave a batch as it is: the likelihoods run on the CPU."""
        return batch

    def train_dataloader(self) -> Batches:
        """Batches of the epoch's stage; from the second on contacts are explained first.

        Raises:
            TrainingError: no contact could be drawn, or no motion explained.
            WorkerLost: a worker process was killed.
        """
        stage, source = self.trainer.current_epoch, self.source
        if stage >= len(source.steps):
            return Batches(source.fine, 0)
        posterior = self.trainer.lightning_module.posterior

        def estimate(features: np.ndarray) -> np.ndarray:
            with torch.no_grad():
                return posterior(torch.from_numpy(features))[0].double().numpy()

        if stage:
            source.explain(estimate)
        source.standardise(stage, lambda given, **how: posterior.standardise(torch.from_numpy(given), **how))
        return Batches(source.fine if stage else source.rough, source.steps[stage])
