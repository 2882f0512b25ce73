"""Simulated contacts for the training of the contact posterior, and the fits that explain them.

The stages of the training stand in `palpate.models.contact_module`.
"""

import dataclasses
import math
from collections.abc import Callable
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
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
from palpate.data.training.contacts import ContactSource, TrainingError
from palpate.estimators.network.fits import (
    CONTACTS_A_SCENE,
    EXPLAINED,
    FRAME_S,
    MECHANICS,
    NOISE,
    SCENES,
    Drawn,
    Fits,
    draw_observed,
    fit_sequence,
    scene_contacts,
)
from palpate.physics.likelihood import Likelihood

ROUGH_BATCH, FINE_BATCH = 64, 512
"""Samples a step of the first stage, and of the others."""
SCALE_SAMPLES, LEAST_SCALE = 2000, 0.02
"""Samples that set the inputs' centre and scale, and the least scale of the depth-change sequence's inputs."""
BLUR_SHARES = 0.3, 0.03
"""Shares of a contact's largest motion by which σ is raised at the beginning and at the end of the rough stage."""


class Made(NamedTuple):
    """A contact without noise, with its depth-change sequence."""

    contact: Interaction
    around: Surroundings
    within: float
    """Largest error of its instants [s]."""

    def observed(self, moved: np.ndarray, noise: float) -> tuple[Interaction, np.ndarray]:
        """The contact with another motion [N, 3] and σ, and the network's input, without the depth-change sequence."""
        observation = self.contact.observation.moved(moved, noise)
        contact = dataclasses.replace(self.contact, observation=observation)
        more = sequence_features(None, self.around.spacing, noise, self.within)
        return contact, np.concatenate([contact_features(contact, self.around), more])


class Rough(NamedTuple):
    """A batch of the first stage."""

    features: np.ndarray
    """Input of the network, shape [B, FEATURES + SEQUENCE_FEATURES], float32."""
    likelihoods: list[Likelihood]
    """Likelihoods of φ with a raised σ."""


@dataclasses.dataclass(frozen=True)
class SimulatedContacts(Checked, ContactSource):
    """Contacts of many scenes, of half of which the instants are known to a frame only."""

    contacts: Annotated[int, 1, LARGEST] = 3200
    """Number of simulated contacts."""
    rough_steps: Annotated[int, 4, LARGEST] = 800
    fine_steps: Annotated[int, 4, LARGEST] = 16000
    bound_steps: Annotated[int, 4, LARGEST] = 2000
    seed: Annotated[int, 0, LARGEST] = 0
    """Another seed gives other contacts and errors; the weights follow seed_everything."""
    workers: Annotated[int, 0, MOST_THREADS] | None = None
    """Processes that draw contacts and explain motions; 0 = in this one, None = one a core."""

    features = FEATURES + SEQUENCE_FEATURES

    @property
    def steps(self) -> tuple[int, int, int]:
        """Batches of each stage."""
        return self.rough_steps, self.fine_steps, self.bound_steps

    @cached_property
    def made(self) -> list[Made]:
        """Contacts of both kinds."""
        half = -(-self.contacts // 2)
        # Number added to the seed for contacts whose instants are unknown.
        parts = ((self.seed, 0.0), (self.seed + 1_000_003, FRAME_S))
        drawn = [(make_contacts(half, seed, self.workers, within), within) for seed, within in parts]
        found = [(contact.interaction, within) for contacts, within in drawn for contact in contacts]
        return [Made(contact, contact_surroundings(contact), within) for contact, within in found]

    @cached_property
    def generators(self) -> tuple[np.random.Generator, np.random.Generator]:
        """What the first stage and the scales are drawn by, and what the others are."""
        return np.random.default_rng([self.seed, 17]), np.random.default_rng([self.seed, 19])

    @cached_property
    def fits(self) -> list[Fits]:
        """The explained contacts, once there are any."""
        return []

    def rough(self, step: int) -> Rough:
        blur = BLUR_SHARES[0] * (BLUR_SHARES[1] / BLUR_SHARES[0]) ** (step / self.rough_steps)
        batch = [self.draw() for _ in range(ROUGH_BATCH)]
        return Rough(np.stack([features for _, features in batch]), [widened(contact, blur) for contact, _ in batch])

    def fine(self, step: int) -> Drawn:
        return draw_observed(self.fits[0], FINE_BATCH, self.generators[1])

    def standardise(self, stage: int, set_scale: Callable[..., None]) -> None:
        if stage == 0:
            set_scale(np.stack([self.draw()[1] for _ in range(SCALE_SAMPLES)]))
        elif stage == 1:  # the first stage had none of the sequence's inputs
            examples = draw_observed(self.fits[0], SCALE_SAMPLES, self.generators[0])
            set_scale(examples.features, least=LEAST_SCALE, first=FEATURES)

    def draw(self) -> tuple[Interaction, np.ndarray]:
        """A contact with Gaussian noise along the force, and its features."""
        generator = self.generators[0]
        made = self.made[int(generator.integers(len(self.made)))]
        contact, noise = made.contact, math.exp(generator.uniform(*np.log(NOISE)))
        error = generator.normal(0, noise, len(contact.observation))[:, None] * contact.direction
        return made.observed(contact.moved + error, noise)

    def explain(self, estimate: Callable[[np.ndarray], np.ndarray]) -> None:
        """Explain every motion; motions that no parameters explain are left out and counted.

        Raises:
            TrainingError: no motion could be explained.
            WorkerLost: a worker process was killed.
        """
        if self.fits:
            return
        starts = estimate(np.stack([made.observed(made.contact.moved, NOISE[0])[1] for made in self.made]))
        tasks = [(made.contact, start, made.within) for made, start in zip(self.made, starts, strict=True)]
        with progress_bars(Console()) as progress:
            fitted = run_tasks(fit_sequence, tasks, self.workers, ordered=True)
            found = list(progress.track(fitted, len(tasks), description="fits"))
        both = zip(self.made, found, strict=True)
        kept = [(made.contact, fit, made.within) for made, fit in both if fit.rms <= EXPLAINED]
        print(f"{len(kept)} of {len(found)} motions explained to {EXPLAINED:g}")
        if not kept:
            raise TrainingError("No motion could be explained; give more --data.source.contacts.")
        self.fits.append(Fits.of(*zip(*kept, strict=True)))


def widened(contact: Interaction, blur: float) -> Likelihood:
    """A contact's likelihood, with σ widened by a share (`blur`) of its largest motion."""
    largest = float(np.linalg.norm(contact.moved, axis=1).max())
    observation = contact.observation.moved(contact.moved, math.hypot(contact.noise, blur * largest))
    return Likelihood(contact.mesh, contact.load, observation, MECHANICS, np.float32)


def make_contacts(count: int, seed: int, workers: int | None = None, within: float = 0.0) -> list[SimulatedContact]:
    """About `count` contacts of many scenes, the regimes in turn, as in the benchmark.

    Args:
        count: number of contacts.
        seed: another seed gives other scenes.
        workers: number of processes; None = one a core, 0 = in this one.
        within: as in `draw_contacts`.

    Raises:
        TrainingError: no contact could be drawn.
        WorkerLost: a worker process was killed.
    """
    seeds = np.random.SeedSequence((seed, 0xC0)).generate_state(-(-count // CONTACTS_A_SCENE)).tolist()
    turns = [dataclasses.replace(SCENES, regime=regime) for regime in REGIMES]
    tasks = [(turns[number % len(turns)], scene, within) for number, scene in enumerate(seeds)]
    with progress_bars(Console()) as progress:
        drawn = run_tasks(scene_contacts, tasks, workers, ordered=True)
        found = [
            contact for contacts in progress.track(drawn, len(tasks), description="scenes") for contact in contacts
        ]
    if not found:
        raise TrainingError(
            "No contact could be drawn; give more --data.source.contacts or another --data.source.seed."
        )
    return found
