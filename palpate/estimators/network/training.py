"""Simulated contacts for the training of the contact posterior, and the fits that explain them.

The stages of the training stand in `palpate.models.contact_module`.
"""

import dataclasses
import math
from collections.abc import Callable
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from rich.console import Console

from palpate.common.command_line import progress_bars
from palpate.common.settings import LARGEST, Checked
from palpate.common.workers import run_tasks
from palpate.data.contact.features import FEATURES, Surroundings, contact_features, contact_surroundings
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES, sequence_features
from palpate.data.depth.normalise import MOST_THREADS
from palpate.data.synthetic.contacts import SimulatedContact
from palpate.data.synthetic.truth import REGIMES
from palpate.data.training.contacts import Batches, ContactData, TrainingError
from palpate.estimators.network import fits
from palpate.physics.likelihood import Likelihood

ROUGH_BATCH, FINE_BATCH = 64, 512
"""Samples a step of the first stage, and of the others."""


class Made(NamedTuple):
    """A contact without noise, with its depth-change sequence."""

    contact: Interaction
    around: Surroundings
    within: float
    """Largest error of its instants [s]."""

    def observed(self, moved: np.ndarray, noise: float) -> tuple[Interaction, np.ndarray]:
        """Return the contact with another motion [N, 3] and σ, and the network's input, without the depth-change
        sequence."""
        contact = self.contact.having(point=self.contact.observation.moved(moved, noise))
        more = sequence_features(None, self.around.spacing, noise, self.within)
        return contact, np.concatenate([contact_features(contact, self.around), more])


class Rough(NamedTuple):
    """A batch of the first stage."""

    features: np.ndarray
    """Input of the network, shape [B, FEATURES + SEQUENCE_FEATURES], float32."""
    likelihoods: list[Likelihood]
    """Likelihoods of φ with a raised σ."""


@dataclasses.dataclass(frozen=True)
class ContactSettings(Checked):
    """Settings of a training."""

    contacts: Annotated[int, 1, LARGEST] = 3200
    """Number of simulated contacts."""
    rough_steps: Annotated[int, 4, LARGEST] = 800
    fine_steps: Annotated[int, 4, LARGEST] = 16000
    bound_steps: Annotated[int, 4, LARGEST] = 2000
    seed: Annotated[int, 0, LARGEST] = 0
    """Another seed gives other contacts and errors; the weights follow seed_everything."""
    workers: Annotated[int, 0, MOST_THREADS] | None = None
    """Processes that draw contacts and explain motions; 0 = in this one, None = one a core."""


class SimulatedContacts(ContactData):
    """Contacts of many scenes, of half of which the instants are known to a frame only.

    Args:
        settings: the fields of ContactSettings.
    """

    contact_features = FEATURES + SEQUENCE_FEATURES
    scale_samples = 2000
    """Number of samples that set the inputs' centre and scale."""

    def __init__(self, **settings: Any) -> None:
        super().__init__()
        # jsonargparse reads this call: every field of ContactSettings is an option.
        self.settings = chosen = ContactSettings(**settings)
        steps = chosen.rough_steps, chosen.fine_steps, chosen.bound_steps
        self.stages = [Batches(*each) for each in zip((self.rough, self.fine, self.fine), steps, strict=True)]
        self.first, self.later = (np.random.default_rng([chosen.seed, part]) for part in (17, 19))
        self.explanations: Any = None

    @cached_property
    def made(self) -> list[Made]:
        """Contacts of both kinds."""
        chosen, half = self.settings, -(-self.settings.contacts // 2)
        # Number added to the seed for contacts whose instants are unknown.
        parts = ((chosen.seed, 0.0), (chosen.seed + 1_000_003, fits.FRAME_S))
        drawn = [(make_contacts(half, seed, chosen.workers, within), within) for seed, within in parts]
        found = [(contact.interaction, within) for contacts, within in drawn for contact in contacts]
        return [Made(contact, contact_surroundings(contact), within) for contact, within in found]

    def begin(self, stage: int) -> None:
        """Set the inputs' scale, and explain the motions from the network's estimates before the second stage.

        Raises:
            TrainingError: no contact could be drawn, or no motion explained.
            WorkerLost: a worker process was killed.
        """
        posterior = self.trainer.lightning_module.posterior
        if stage == 0:
            posterior.standardise(torch.tensor(np.stack([self.draw()[1] for _ in range(self.scale_samples)])))
        if stage and self.explanations is None:
            quiet = np.stack([made.observed(made.contact.moved, fits.NOISE[0])[1] for made in self.made])
            with torch.no_grad():
                starts = posterior(torch.from_numpy(quiet))[0].double().numpy()
            self.explanations = self.explained(starts)
        if stage == 1:  # the first stage had none of the sequence's inputs
            examples = torch.from_numpy(fits.draw_observed(self.explanations, self.scale_samples, self.first).features)
            posterior.standardise(examples, least=0.02, first=FEATURES)

    def rough(self, step: int) -> Rough:
        """Return a batch of the first stage by its number."""
        # σ is raised by a share of the largest motion, at the end of the stage by a tenth of the first one.
        blur = 0.3 * 0.1 ** (step / self.settings.rough_steps)
        batch = [self.draw() for _ in range(ROUGH_BATCH)]
        return Rough(np.stack([features for _, features in batch]), [widened(contact, blur) for contact, _ in batch])

    def fine(self, step: int) -> fits.Drawn:
        """Return a batch of the other stages."""
        return fits.draw_observed(self.explanations, FINE_BATCH, self.later)

    def draw(self) -> tuple[Interaction, np.ndarray]:
        """Draw a contact with Gaussian noise along the force, and its features."""
        made = self.made[int(self.first.integers(len(self.made)))]
        contact, noise = made.contact, math.exp(self.first.uniform(*np.log(fits.NOISE)))
        error = self.first.normal(0, noise, len(contact.observation))[:, None] * contact.direction
        return made.observed(contact.moved + error, noise)

    def explained(self, starts: np.ndarray) -> fits.Fits:
        """Fit the motions from starts [N, 3]; motions that no parameters explain are left out."""
        tasks = [(made.contact, start, made.within) for made, start in zip(self.made, starts, strict=True)]
        found = run_shown(fits.fit_sequence, tasks, self.settings.workers, "fits")
        both = zip(self.made, found, strict=True)
        kept = [(made.contact, fit, made.within) for made, fit in both if fit.rms <= fits.EXPLAINED]
        print(f"{len(kept)} of {len(found)} motions explained to {fits.EXPLAINED:g}")
        if not kept:
            raise TrainingError("No motion could be explained; give more --data.contacts.")
        return fits.Fits.of(*zip(*kept, strict=True))


def run_shown(function: Callable[[Any], Any], tasks: list, workers: int | None, name: str) -> list:
    """Run tasks with a progress bar; return their results in order."""
    with progress_bars(Console()) as progress:
        return list(progress.track(run_tasks(function, tasks, workers, ordered=True), len(tasks), description=name))


def widened(contact: Interaction, blur: float) -> Likelihood:
    """Return a contact's likelihood, with σ widened by a share (`blur`) of its largest motion."""
    largest = float(np.linalg.norm(contact.moved, axis=1).max())
    observation = contact.observation.moved(contact.moved, math.hypot(contact.noise, blur * largest))
    return Likelihood(contact.mesh, contact.load, observation, fits.MECHANICS, np.float32)


def make_contacts(count: int, seed: int, workers: int | None = None, within: float = 0.0) -> list[SimulatedContact]:
    """Simulate about `count` contacts of many scenes, the regimes in turn, as in the benchmark.

    Args:
        count: number of contacts.
        seed: another seed gives other scenes.
        workers: number of processes; None = one a core, 0 = in this one.
        within: as in `draw_contacts`.

    Raises:
        TrainingError: no contact could be drawn.
        WorkerLost: a worker process was killed.
    """
    seeds = np.random.SeedSequence((seed, 0xC0)).generate_state(-(-count // fits.CONTACTS_A_SCENE)).tolist()
    turns = [dataclasses.replace(fits.SCENES, regime=regime) for regime in REGIMES]
    tasks = [(turns[number % len(turns)], scene, within) for number, scene in enumerate(seeds)]
    found = [contact for contacts in run_shown(fits.scene_contacts, tasks, workers, "scenes") for contact in contacts]
    if not found:
        raise TrainingError("No contact could be drawn; give more --data.contacts or another --data.seed.")
    return found
