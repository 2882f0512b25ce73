"""Training of the contact posterior without labels: amortised variational inference on observed contact motions.

    palpate train fit -c configs/contact.yaml [--data.contacts 3200 …]

The loss is the evidence bound. Its likelihood is that of the trajectory residual with its σ, its prior a Gaussian with
the mean and variance of the admissible box. It reads motions, depth-change sequences and noise levels, never θ. The
instants of half of the presses are unknown, and their delays are marginalised. As a rollout costs more than the
network, each epoch is a stage:
 1. `rough`: rollouts at the network's own mean, with σ raised by a share of the motion. An under-damped response has an
    optimum for every number of swings, and only a wide likelihood leads to the right one.
 2. `fine`: least squares explain every motion once, from the network's estimate or from several starts, and the
    likelihood is linearised there (exact Jacobians). Noise, rounding and cut-off windows are then drawn anew for every
    step without a rollout. The covariance learns to include the network's own error (`models.evidence.covering`).
 3. `bound`: a second network learns the size of the Cramér–Rao bound at those fits, by which verdicts are given.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from lightning.pytorch import LightningModule
from torch import Tensor

from palpate.common.output import replacing_own
from palpate.models.evidence import bound_loss, box_prior, covering, preconditioned
from palpate.models.posterior import ContactPosterior
from palpate.physics.mechanics import RECOMMENDED

STAGES = "rough", "fine", "bound"
"""Names of the epochs."""


class AmortisedPosterior(LightningModule):
    """Trains a `ContactPosterior` on the batches of `palpate.estimators.network.training.SimulatedContacts`.

    Args:
        contact_features: length of the contact's vector; train.py takes it from the data.
        rough_rate: largest learning rate of the first stage.
        fine_rate: largest learning rate of the other two.
        weight_decay: weight decay of AdamW.
    """

    EXPORTED: ClassVar[str] = "posterior.pt"
    """File that a training leaves in its run folder."""
    REFUSED: ClassVar[dict[str, tuple[tuple, str]]] = {
        "accelerator": (("cpu",), "rollouts cost more than the network; give cpu"),
        "max_epochs": ((3,), "each epoch is a stage of the training; give 3"),
        "reload_dataloaders_every_n_epochs": ((1,), "each stage has batches of its own; give 1"),
        "gradient_clip_val": ((None, 0), "every stage clips gradients to a norm of 1; leave it out"),
        "accumulate_grad_batches": ((1,), "each stage steps by hand; leave it out"),
        "precision": ((None, "32", 32, "32-true"), "the likelihood is in 32 bits; give 32-true"),
    }
    """Allowed values of the trainer's options, and the reason."""

    def __init__(
        self, contact_features: int, rough_rate: float = 1e-3, fine_rate: float = 2e-3, weight_decay: float = 1e-4
    ) -> None:
        super().__init__()
        self.save_hyperparameters()
        self.automatic_optimization = False
        self.posterior = ContactPosterior(contact_features, torch.tensor(RECOMMENDED.log_box))

    def on_fit_start(self) -> None:
        torch.set_num_threads(max(1, (os.cpu_count() or 1) // 2))  # rollouts have threads of their own

    def configure_optimizers(self) -> Any:
        """One AdamW a stage, whose rate rises and falls within it."""
        trainer: Any = self.trainer
        rates = [self.hparams["rough_rate"], self.hparams["fine_rate"], self.hparams["fine_rate"]]
        networks = self.posterior, self.posterior, self.posterior.expected_bound
        optimizers, schedules = [], []
        for network, rate, batches in zip(networks, rates, trainer.datamodule.stages, strict=True):
            steps = len(batches)
            optimizer = torch.optim.AdamW(network.parameters(), rate, weight_decay=self.hparams["weight_decay"])
            optimizers.append(optimizer)
            rise = max(0.1, 3 / steps)
            schedules.append(torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=steps, pct_start=rise))
        return optimizers, schedules

    def training_step(self, batch: Any, index: int) -> None:
        """One step of the epoch's stage."""
        stage = self.current_epoch
        optimizers: Any = self.optimizers()
        schedules: Any = self.lr_schedulers()
        optimizer = optimizers[stage]
        loss = (rough_loss, fine_loss, expected_loss)[stage](self.posterior, batch)
        optimizer.zero_grad()
        self.manual_backward(loss)
        self.clip_gradients(optimizer, gradient_clip_val=1.0, gradient_clip_algorithm="norm")
        optimizer.step()
        schedules[stage].step()
        self.log(f"{STAGES[stage]}/loss", loss.detach(), prog_bar=True, batch_size=1)

    def export(self, output: Path, datamodule: Any, configuration: str = "") -> str:
        """Write the weights, which `palpate.estimators.network.calibration` exports and calibrates.

        Args:
            output: the file.
            datamodule, configuration: not needed; other modules' files hold them.
        """
        with replacing_own(output) as partial:
            torch.save(self.posterior.state_dict(), partial)
        return f"{output}: written"


def rough_loss(posterior: ContactPosterior, batch: Any) -> Tensor:
    """The evidence bound by rollouts at the means, a scalar.

    Args:
        posterior: the network.
        batch: `features` [B, F], and the `likelihoods` of the contacts.
    """
    mean, factor = posterior(torch.from_numpy(batch.features))
    with ThreadPoolExecutor() as threads:
        pairs = batch.likelihoods, mean.detach().numpy()
        found = list(threads.map(lambda likelihood, logs: likelihood.linearise(logs), *pairs))
    gradient, information = (
        torch.from_numpy(np.array([getattr(item, name) for item in found], np.float32))
        for name in ("gradient", "information")
    )
    return preconditioned(mean, factor, gradient, information, posterior.lower, posterior.upper, whiten=False)


def fine_loss(posterior: ContactPosterior, drawn: Any) -> Tensor:
    """`preconditioned` for the means, every likelihood linearised at its own fit, plus `covering`; a scalar.

    Args:
        posterior: the network.
        drawn: `features` [B, F], `logs` [B, 3], `information` [B, 3, 3] and `pull` [B, 3].
    """
    mean, factor = posterior(torch.from_numpy(drawn.features))
    box = posterior.lower, posterior.upper
    information, logs = torch.from_numpy(drawn.information), torch.from_numpy(drawn.logs)
    pull, offset = torch.from_numpy(drawn.pull), mean.detach() - logs
    gradient = torch.einsum("bpq,bq->bp", information, offset) - pull
    moved = preconditioned(mean, factor.detach(), gradient.to(mean), information.to(mean), *box, whiten=True)
    prior, middle = (values.double() for values in box_prior(*box))
    whole = information + prior
    best = logs + torch.linalg.solve(whole, pull - (logs - middle) @ prior)
    # Weight of the covariance's loss relative to the means'; the two share the network, and nothing else.
    return moved + 0.3 * covering(mean.detach(), factor, best.to(mean), whole)


def expected_loss(posterior: ContactPosterior, drawn: Any) -> Tensor:
    """`bound_loss` of the posterior's expected bound, a scalar."""
    return bound_loss(posterior.expected_bound_factor(torch.from_numpy(drawn.features)), drawn.information)
