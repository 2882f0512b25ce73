"""Batches for the training of the contact posterior: new ones in each epoch, made while they are used."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from lightning.pytorch import LightningDataModule

from palpate.common.ahead import ahead


class TrainingError(ValueError):
    """Error: there is nothing to train on; the message is a sentence."""


@dataclass
class Batches:
    """Batches, each made by its number in a thread of its own while the one before is used."""

    make: Callable[[int], Any]
    count: int

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Any]:
        return ahead(map(self.make, range(self.count)), 1)


class ContactData(LightningDataModule):
    """Simulated contacts in stages, one an epoch (`palpate.models.contact_module`).

    Batches need fits of the simulator. Estimators fit, and this package doesn't know them, so a subclass among them
    gives the batches: `palpate.estimators.network.training.SimulatedContacts`.
    """

    trainer: Any
    contact_features: int
    """Length of a contact's vector."""
    stages: Sequence[Batches]
    """Batches of each stage: `features` and `likelihoods` in the first, `features`, `logs`, `information` and `pull` in
    the others, numpy arrays."""

    def begin(self, stage: int) -> None:
        """Prepare a stage."""

    def transfer_batch_to_device(self, batch: Any, device: Any, dataloader_idx: int) -> Any:
        """Leave a batch as it is: the likelihoods run on the CPU."""
        return batch

    def train_dataloader(self) -> Sequence[Any] | Batches:
        """Batches of the epoch's stage."""
        stage = self.trainer.current_epoch
        if stage >= len(self.stages):
            return ()
        self.begin(stage)
        return self.stages[stage]
