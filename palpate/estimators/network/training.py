"""Trains the contact posterior without labels: amortised variational inference on observed contact motions.

    palpate train fit -c configs/contact.yaml [--contact.contacts 3200 …]

The loss is the evidence bound: the trajectory residual with its σ is the likelihood, the admissible box the prior (a
Gaussian with the box's mean and variance). It reads motions, depth-change sequences and noise levels, never θ; of half
of the presses the instants are unknown, and their delays are marginalised. There are four stages, because a rollout
costs more than the network:
 1. `rough`: rollouts at the network's own mean, with σ raised by a share of the motion: an under-damped response has an
    optimum for every number of swings, and only a wide likelihood leads to the right one.
 2. `fit`: every motion is explained once, by least squares from the network's estimate (or from several starts).
 3. `fine`: the likelihood is linearised at those fits (exact Jacobians), so that noise, rounding and cut-off windows
    are drawn anew for every step without a rollout. The covariance learns to include the network's own error
    (`models.evidence.covering`).
 4. `bound`: a second network learns the size of the Cramér–Rao bound at those fits, by which verdicts are given.
"""

import contextlib
import dataclasses
import itertools
import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from rich.console import Console
from rich.progress import Progress
from torch import Tensor, nn

from palpate.common.ahead import ahead
from palpate.common.command_line import progress_bars
from palpate.common.files import as_json
from palpate.common.output import replacing_own, require_own, write_own
from palpate.common.settings import LARGEST, Checked
from palpate.common.workers import run_tasks
from palpate.data.contact.features import FEATURES, contact_features, contact_surroundings
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES, sequence_features
from palpate.data.depth.normalise import MOST_THREADS
from palpate.data.synthetic.contacts import SimulatedContact
from palpate.data.synthetic.truth import REGIMES
from palpate.estimators.network.fits import (
    BOUNDS,
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
from palpate.models.evidence import bound_loss, box_prior, covering, preconditioned
from palpate.models.posterior import ContactPosterior
from palpate.physics.likelihood import Likelihood, Linearised

WEIGHTS, LOG = "posterior.pt", "training.jsonl"
"""Files of the output folder; the first appears at the end."""
ROUGH_BATCH, ROUGH_RATE = 64, 1e-3
"""Samples a step of the rough stage, and its largest learning rate."""
FINE_BATCH, FINE_RATE = 512, 2e-3
"""Samples a step of the last two stages, and their largest learning rate."""
SCALE_SAMPLES, LEAST_SCALE = 2000, 0.02
"""Samples that set the inputs' centre and scale, and the least scale of the depth-change sequence's inputs."""
BLUR_SHARES = 0.3, 0.03
"""Shares of a contact's largest motion by which σ is raised at the beginning and at the end of the rough stage."""


class TrainingError(ValueError):
    """There is nothing to train on; the message is a sentence."""


@dataclasses.dataclass(frozen=True)
class ContactSettings(Checked):
    """Settings of a training."""

    output: Path
    """Folder for the weights and the log."""
    contacts: Annotated[int, 1, LARGEST] = 3200
    """Number of simulated contacts."""
    rough_steps: Annotated[int, 4, LARGEST] = 800
    fine_steps: Annotated[int, 4, LARGEST] = 16000
    bound_steps: Annotated[int, 4, LARGEST] = 2000
    seed: Annotated[int, 0, LARGEST] = 0
    """Another seed gives other contacts, weights and errors."""
    workers: Annotated[int, 0, MOST_THREADS] | None = None
    """Processes that draw contacts and explain motions; 0 = in this one, None = one a core."""

    def __post_init__(self) -> None:
        if self.output == Path():
            raise ValueError("output is empty or the working folder; name a folder for the training alone.")
        super().__post_init__()


def widened(contact: Interaction, logs: np.ndarray, blur: float) -> Linearised:
    """A contact's likelihood around φ, with σ widened by a share (`blur`) of its largest motion."""
    largest = float(np.linalg.norm(contact.moved, axis=1).max())
    observation = contact.observation.moved(contact.moved, math.hypot(contact.noise, blur * largest))
    return Likelihood(contact.mesh, contact.load, observation, MECHANICS, np.float32).linearise(logs)


class Trainer:
    """The posterior and its training on a fixed set of contacts."""

    def __init__(self, contacts: list[SimulatedContact], within: Sequence[float], seed: int) -> None:
        """
        Args:
            contacts: with depth-change sequences.
            within: largest error of each contact's instants [s].
            seed: another seed gives other weights and errors.
        """
        torch.manual_seed(seed)
        self.contacts, self.within = contacts, within
        self.generator = np.random.default_rng([seed, 17])
        self.surroundings = [contact_surroundings(contact.interaction) for contact in contacts]
        self.posterior = new_posterior()
        sample = [self.draw() for _ in range(SCALE_SAMPLES)]
        self.posterior.standardise(torch.tensor(np.stack([features for _, features in sample])))
        self.threads = ThreadPoolExecutor()

    def draw(self) -> tuple[Interaction, np.ndarray]:
        """A contact with Gaussian noise along the force, and its features."""
        index = int(self.generator.integers(len(self.contacts)))
        contact, noise = self.contacts[index].interaction, math.exp(self.generator.uniform(*np.log(NOISE)))
        error = self.generator.normal(0, noise, len(contact.observation))[:, None] * contact.direction
        observed = contact.having(point=contact.observation.moved(contact.moved + error, noise))
        return observed, self.features(observed, index)

    def features(self, contact: Interaction, index: int) -> np.ndarray:
        """The network's input for a contact in the first two stages, which leave the depth-change sequence out."""
        around = self.surroundings[index]
        more = sequence_features(None, around.spacing, contact.noise, self.within[index])
        return np.concatenate([contact_features(contact, around), more])

    def rough_loss(self, done: float) -> Tensor:
        """The evidence bound by rollouts at the means, a scalar; `done` is the finished share of the stage's steps."""
        blur = BLUR_SHARES[0] * (BLUR_SHARES[1] / BLUR_SHARES[0]) ** done
        batch = [self.draw() for _ in range(ROUGH_BATCH)]
        mean, factor = self.posterior(torch.from_numpy(np.stack([features for _, features in batch])))
        contacts = [contact for contact, _ in batch]
        found = list(self.threads.map(widened, contacts, mean.detach().numpy(), [blur] * len(contacts)))
        gradient, information = (
            torch.from_numpy(np.array([getattr(item, name) for item in found], np.float32))
            for name in ("gradient", "information")
        )
        box = self.posterior.lower, self.posterior.upper
        return preconditioned(mean, factor, gradient, information, *box, whiten=False)

    def fit(self, progress: Progress, workers: int | None = None) -> Fits:
        """Second stage: the parameters that explain every motion; motions without any are left out and counted.

        Args:
            progress: display for the stage's progress bar.
            workers: number of processes; None = one a core, 0 = in this one.

        Raises:
            TrainingError: no motion could be explained.
            WorkerLost: a worker process was killed.
        """
        contacts = [contact.interaction for contact in self.contacts]
        quiet = [
            self.features(item.having(point=item.observation.moved(item.moved, NOISE[0])), index)
            for index, item in enumerate(contacts)
        ]
        with torch.no_grad():
            starts = self.posterior.eval()(torch.from_numpy(np.stack(quiet)))[0].double().numpy()
        self.posterior.train()
        tasks = list(zip(contacts, starts, self.within, strict=True))
        fitted = run_tasks(fit_sequence, tasks, workers, ordered=True)
        found = list(progress.track(fitted, len(tasks), description="fits"))
        kept = [item for item in zip(contacts, found, self.within, strict=True) if item[1].rms <= EXPLAINED]
        print(f"{len(kept)} of {len(found)} motions explained to {EXPLAINED:g}")
        if not kept:
            raise TrainingError("No motion could be explained; give more --contacts.")
        fits = Fits.of(*zip(*kept, strict=True))
        # The first stage had none of the sequence's inputs.
        examples = torch.from_numpy(draw_observed(fits, SCALE_SAMPLES, self.generator).features)
        self.posterior.standardise(examples, least=LEAST_SCALE, first=FEATURES)
        return fits


def new_posterior() -> ContactPosterior:
    """The untrained posterior of a contact's motion and its depth-change sequence."""
    return ContactPosterior(FEATURES + SEQUENCE_FEATURES, torch.tensor(BOUNDS.log_box))


def fine_loss(posterior: ContactPosterior, drawn: Drawn) -> Tensor:
    """`preconditioned` for the means, every likelihood linearised at its own fit, plus `covering`; a scalar."""
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


def expected_loss(posterior: ContactPosterior, drawn: Drawn) -> Tensor:
    """`bound_loss` of the posterior's expected bound, a scalar."""
    return bound_loss(posterior.expected_bound_factor(torch.from_numpy(drawn.features)), drawn.information)


def descend(
    network: nn.Module, loss_of: Callable[[int], Tensor], steps: int, rate: float, decay: float = 1e-4
) -> Iterator[float]:
    """Minimise a network's loss, a function of the step's number; yields the loss of each step."""
    optimizer = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=decay)
    rise = max(0.1, 3 / steps)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=steps, pct_start=rise)
    for step in range(steps):
        loss = loss_of(step)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        yield float(loss.detach())


def make_contacts(
    count: int, seed: int, progress: Progress, workers: int | None = None, within: float = 0.0
) -> list[SimulatedContact]:
    """About `count` contacts of many scenes, the regimes in turn, as in the benchmark.

    Args:
        count: number of contacts.
        seed: another seed gives other scenes.
        progress: display for the progress bar.
        workers: number of processes; None = one a core, 0 = in this one.
        within: as in `draw_contacts`.

    Raises:
        TrainingError: no contact could be drawn.
        WorkerLost: a worker process was killed.
    """
    seeds = np.random.SeedSequence((seed, 0xC0)).generate_state(-(-count // CONTACTS_A_SCENE)).tolist()
    turns = [dataclasses.replace(SCENES, regime=regime) for regime in REGIMES]
    tasks = [(turns[number % len(turns)], scene, within) for number, scene in enumerate(seeds)]
    drawn = run_tasks(scene_contacts, tasks, workers, ordered=True)
    scenes = progress.track(drawn, len(tasks), description="scenes")
    found = [contact for contacts in scenes for contact in contacts]
    if not found:
        raise TrainingError("No contact could be drawn; give more --contacts or another --seed.")
    return found


def train_contact(options: ContactSettings) -> None:
    """Train and save.

    Raises:
        OSError: the output folder can't be written, or a user's file is in the way.
        TrainingError: there is nothing to train on.
        WorkerLost: a worker process was killed.
    """
    options.output.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(max(1, (os.cpu_count() or 1) // 2))
    start = time.time()
    require_own(options.output / WEIGHTS, options.output / LOG)
    rows: list[str] = []
    with progress_bars(Console()) as progress:

        def stage(name: str, network: nn.Module, loss_of: Callable[[int], Tensor], steps: int, rate: float) -> None:
            losses = progress.track(descend(network, loss_of, steps, rate), steps, description=name)
            for step, loss in enumerate(losses, start=1):
                if step % max(1, steps // 10) == 0:
                    row = {"stage": name, "step": step, "seconds": round(time.time() - start), "loss": loss}
                    rows.append(as_json(row) + "\n")
            write_own(options.output / LOG, "".join(rows))

        trainer, steps = _trainer(options, progress), options.rough_steps
        posterior = trainer.posterior
        stage("rough", posterior, lambda step: trainer.rough_loss(step / steps), steps, ROUGH_RATE)
        fits = trainer.fit(progress, options.workers)
        torch.manual_seed(options.seed)
        generator = np.random.default_rng([options.seed, 19])
        draws = (draw_observed(fits, FINE_BATCH, generator) for _ in itertools.count())
        with contextlib.closing(ahead(draws, 1)) as drawn:
            stage("fine", posterior, lambda _: fine_loss(posterior, next(drawn)), options.fine_steps, FINE_RATE)
            bound = posterior.expected_bound
            stage("bound", bound, lambda _: expected_loss(posterior, next(drawn)), options.bound_steps, FINE_RATE)
    with replacing_own(options.output / WEIGHTS) as weights:
        torch.save(posterior.state_dict(), weights)
    print(f"{options.output}/{WEIGHTS} written after {(time.time() - start) / 3600:.2f} h")


def _trainer(options: ContactSettings, progress: Progress) -> Trainer:
    """The trainer, with depth-change sequences on contacts of which half have unknown instants."""
    half = -(-options.contacts // 2)
    # Number added to the seed for contacts whose instants are unknown.
    parts = [
        make_contacts(half, options.seed + offset, progress, options.workers, within)
        for offset, within in ((0, 0.0), (1_000_003, FRAME_S))
    ]
    within = [0.0] * len(parts[0]) + [FRAME_S] * len(parts[1])
    return Trainer([*parts[0], *parts[1]], within, options.seed)
