"""What is observed, ablated: the contact posterior alone, trained on fewer of the frames after the onset.

Every row trains a new network by the `fine` stage of `estimators.network.training` on the same fits, equally long; only
what is seen of a motion differs, in the features as in the likelihood. Judged on held-out contacts with Gaussian noise
against the bound of their whole first second, so that all rows are divided by the same number.

The row `supervised` has the same network, contacts and steps, but descends the negative log density of the true log θ:
what training without labels could reach at best. Nothing else here trains on a true θ, and nothing is shipped from it.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import torch
from rich.progress import Progress

from data.contact.features import FEATURES, SLOTS, join_features
from data.synthetic.contacts import SimulatedContact
from estimators.network.fits import BOUNDS, Drawn, Fits, draw_observed, motion_slopes, observed_exactly
from estimators.network.training import FINE_BATCH, FINE_RATE, Trainer, descend, fine_loss, make_contacts
from evaluation.ablations.scores import numbers
from evaluation.recovery.scores import TO_QUANTITIES, deviations
from evaluation.recovery.suites import CLEAN_NOISE
from models.checkpoint import load_posterior
from models.posterior import ContactPosterior
from physics.files import replacing
from physics.identifiability import covariance, fisher_information

SUPERVISED = "supervised"
"""The row that is told the truth."""

EXAMPLES = 4000
"""Samples that the inputs' centre and scale are taken from."""
LEAST_SPREAD = 0.3
"""An input that hardly varies in a row, such as a slot that is never seen, is not blown up."""


def seen_slots(row: str, loaded: np.ndarray) -> np.ndarray:
    """What a row sees: `release` the last slot under load, `final` the last of the second, a number that many frames,
    `supervised` all.

    Args:
        row: name of the observation.
        loaded: whether a slot is under load, shape [B, SLOTS].

    Returns:
        Shape [B, SLOTS], 1 where seen, else 0.
    """
    slots = np.arange(SLOTS)
    if row == "release":
        # A press shorter than a frame has its first slot.
        return (slots == np.maximum(loaded.sum(axis=1, keepdims=True) - 1, 0)).astype(np.float64)
    seen = slots == SLOTS - 1 if row == "final" else slots < (SLOTS if row == SUPERVISED else int(row))
    return np.broadcast_to(seen, loaded.shape).astype(np.float64)


@dataclasses.dataclass(frozen=True)
class Material:
    """What all rows are trained and judged on."""

    fits: Fits
    """Training contacts around what explains them."""
    labelled: Fits
    """The same, and those that nothing explains, around their truth: the row `supervised` alone reads them."""
    held_out: Fits
    """Other contacts, around their truth: evaluation alone reads them."""


def write_material(
    path: Path, weights: Path, contacts: int, held_out: int, seed: int, progress: Progress, workers: int
) -> None:
    """Make the material once; it appears under its name only when complete.

    Args:
        path: file to write.
        weights: contact posterior whose estimates the fits begin from.
        contacts, held_out: about how many of either kind.
        seed: another seed gives other contacts.
        progress: gets a bar for each stage.
        workers: processes; 0 = in this one.
    """
    drawn = make_contacts(contacts, seed, progress, workers)
    trainer = Trainer(drawn, seed)
    load_posterior(trainer.posterior, weights)
    parts = {
        "fits": trainer.fit(progress, workers),
        "labelled": around_truth(drawn),
        "held_out": around_truth(make_contacts(held_out, seed + 1, progress, workers)),
    }
    arrays = {
        f"{part}_{field.name}": getattr(fits, field.name)
        for part, fits in parts.items()
        for field in dataclasses.fields(Fits)
    }
    with replacing(path) as partial:
        np.savez(partial, **arrays)


def read_material(path: Path) -> Material:
    """Back from `write_material`; reading it runs no code."""
    with np.load(path, allow_pickle=False) as stored:
        names = [field.name for field in dataclasses.fields(Fits)]
        parts = [field.name for field in dataclasses.fields(Material)]
        return Material(**{part: Fits(**{name: stored[f"{part}_{name}"] for name in names}) for part in parts})


def around_truth(contacts: list[SimulatedContact]) -> Fits:
    """Contacts with their true φ, and the motion's slopes there."""
    seen = [contact.interaction for contact in contacts]
    logs = [np.log(np.abs(contact.theta)) for contact in contacts]
    slopes = [motion_slopes(observed_exactly(contact), at) for contact, at in zip(seen, logs, strict=True)]
    return Fits.of(seen, logs, slopes)


def train_row(row: str, material: Material, steps: int, seed: int) -> dict[str, float | None]:
    """Train on what a row sees, and judge it; returns the row's numbers."""
    fits, loss_of = (material.labelled, label_loss) if row == SUPERVISED else (material.fits, fine_loss)
    torch.manual_seed(seed)
    generator = np.random.default_rng([seed, 23])
    posterior = ContactPosterior(FEATURES, torch.tensor(BOUNDS.log_box))

    def draw(count: int) -> Drawn:
        return draw_observed(fits, count, generator, lambda loaded: seen_slots(row, loaded))

    posterior.standardise(torch.from_numpy(draw(EXAMPLES).features), least=LEAST_SPREAD)
    for _ in descend(posterior, lambda _: loss_of(posterior, draw(FINE_BATCH)), steps, FINE_RATE):
        pass
    return judge(posterior.eval(), row, material, seed)


def label_loss(posterior: ContactPosterior, drawn: Drawn) -> torch.Tensor:
    """Negative log density of the true φ, a scalar without the constant 3/2·log 2π.

    Args:
        posterior: that is trained.
        drawn: samples whose φ is the truth.
    """
    mean, factor = posterior(torch.from_numpy(drawn.features))
    error = torch.from_numpy(drawn.logs).to(mean) - mean
    scaled = torch.linalg.solve_triangular(factor, error[..., None], upper=False)[..., 0]
    return (0.5 * scaled.square().sum(1) + torch.log(factor.diagonal(dim1=1, dim2=2)).sum(1)).mean()


@torch.no_grad()
def judge(posterior: ContactPosterior, row: str, material: Material, seed: int) -> dict[str, float | None]:
    """A row's numbers on the held-out contacts, whose noise is the same in every row."""
    held = material.held_out
    error = np.random.default_rng([seed, 29]).normal(0, CLEAN_NOISE, held.motion.shape)
    known = seen_slots(row, held.loaded)
    along, noise = (held.motion + error) / held.spacing[:, None], np.full(len(held.logs), CLEAN_NOISE)
    features = join_features(along, known, held.loaded * known, held.around, held.spacing, noise)
    mean, factor = (values.double().numpy() for values in posterior(torch.from_numpy(features)))
    limits = np.stack([covariance(fisher_information(slopes, CLEAN_NOISE)) for slopes in held.slopes])
    truth = held.logs @ TO_QUANTITIES.T
    constant = material.fits.logs.mean(axis=0) @ TO_QUANTITIES.T
    spread = deviations(factor @ factor.transpose(0, 2, 1))
    return numbers(mean @ TO_QUANTITIES.T - truth, constant - truth, deviations(limits), spread)
