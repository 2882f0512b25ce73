"""Trains the contact posterior without labels: amortised variational inference on observed contact motions.

    python -m estimators.network.training --output runs/contact [--contacts 8000]

The loss is the evidence bound: the trajectory residual with its σ is the likelihood, the admissible box the prior (a
Gaussian with the box's mean and variance). It reads motions and noise levels, never θ. Four stages, because a rollout
costs more than the network:
 1. `rough`: rollouts at the network's own mean, with σ raised by a share of the motion: an under-damped response has an
    optimum for every number of swings, and only the wide view shows which is right.
 2. `fit`: every motion is explained once, by least squares from the network's estimate (or from several starts).
 3. `fine`: the likelihood is linearised at those fits (exact Jacobians), so that noise, rounding and cut-off windows
    are drawn anew for every step without a rollout.
 4. `bound`: a network of its own learns how large the Cramér–Rao bound is at those fits; verdicts go by it.
"""

from __future__ import annotations

from physics.doors import INTERRUPTED, enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import dataclasses
import json
import math
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from rich.console import Console
from rich.progress import Progress
from torch import Tensor, nn

from data.command_line import path_option, progress_bars, say, whole_number
from data.contact.features import FEATURES, contact_features, contact_surroundings
from data.contact.interaction import Interaction
from data.synthetic.contacts import SimulatedContact, draw_contacts
from data.synthetic.settings import SceneSettings
from data.synthetic.truth import REGIMES
from estimators.network.fits import (
    BOUNDS,
    EXPLAINED,
    MECHANICS,
    NOISE,
    SCENES,
    Drawn,
    Fits,
    draw_observed,
    fit_motion,
)
from estimators.worker_pool import WorkerLost, run_tasks
from models.evidence import preconditioned
from models.expected_bound import bound_loss
from models.posterior import ContactPosterior
from physics.files import replacing
from physics.likelihood import Likelihood, Linearised

WEIGHTS, LOG = "posterior.pt", "training.jsonl"
"""Files of the output folder; the first appears when all is done."""
CONTACTS_A_SCENE = 8
LEAST_STEPS = 4
"""A stage's learning rate rises over three steps, and falls."""
ROUGH_BATCH, ROUGH_RATE = 64, 1e-3
"""Samples a step of the rough stage, and its largest learning rate."""
FINE_BATCH, FINE_RATE = 512, 2e-3
"""The same of the last two stages."""
BLUR = 0.3, 0.03
"""σ of the rough stage is raised by this share of a contact's largest motion, at its beginning and its end."""


class TrainingError(ValueError):
    """There is nothing to train on; the message is a sentence."""


def widened(contact: Interaction, logs: np.ndarray, blur: float) -> Linearised:
    """A contact's likelihood around φ, with σ widened by a share (`blur`) of its largest motion."""
    largest = float(np.linalg.norm(contact.moved, axis=1).max())
    observation = contact.observation.moved(contact.moved, math.hypot(contact.noise, blur * largest))
    return Likelihood(contact.mesh, contact.load, observation, MECHANICS, np.float32).linearise(logs)


class Trainer:
    """The posterior and its training on a fixed set of contacts."""

    def __init__(self, contacts: list[SimulatedContact], seed: int) -> None:
        torch.manual_seed(seed)
        self.contacts = contacts
        self.generator = np.random.default_rng([seed, 17])
        self.surroundings = [contact_surroundings(contact.interaction) for contact in contacts]
        self.posterior = ContactPosterior(FEATURES, torch.tensor(BOUNDS.log_box))
        sample = [self.draw() for _ in range(2000)]
        self.posterior.standardise(torch.tensor(np.stack([features for _, features in sample])))
        self.threads = ThreadPoolExecutor()

    def draw(self) -> tuple[Interaction, np.ndarray]:
        """A contact with Gaussian noise along the force, and its features."""
        index = int(self.generator.integers(len(self.contacts)))
        contact, noise = self.contacts[index].interaction, math.exp(self.generator.uniform(*np.log(NOISE)))
        error = self.generator.normal(0, noise, len(contact.observation))[:, None] * contact.direction
        seen = dataclasses.replace(contact, observation=contact.observation.moved(contact.moved + error, noise))
        return seen, contact_features(seen, self.surroundings[index])

    def rough_loss(self, done: float) -> Tensor:
        """The evidence bound by rollouts at the means, a scalar; `done` is the share of the stage's steps before."""
        blur = BLUR[0] * (BLUR[1] / BLUR[0]) ** done
        batch = [self.draw() for _ in range(ROUGH_BATCH)]
        mean, factor = self.posterior(torch.from_numpy(np.stack([features for _, features in batch])))
        contacts = [contact for contact, _ in batch]
        found = list(self.threads.map(widened, contacts, mean.detach().numpy(), [blur] * len(contacts)))
        gradient, information = (
            _tensor([getattr(item, name) for item in found]) for name in ("gradient", "information")
        )
        box = self.posterior.lower, self.posterior.upper
        return preconditioned(mean, factor, gradient, information, *box, whiten=False)

    def fit(self, progress: Progress, workers: int | None = None) -> Fits:
        """Second stage: what explains every motion; motions that nothing explains are left out and counted.

        Args:
            progress: gets a bar.
            workers: processes; None = one a core, 0 = in this one.

        Raises:
            TrainingError: nothing explains any motion.
            WorkerLost: a process was killed.
        """
        contacts = [contact.interaction for contact in self.contacts]
        quiet = [
            contact_features(dataclasses.replace(item, observation=item.observation.moved(item.moved, NOISE[0])))
            for item in contacts
        ]
        with torch.no_grad():
            starts = self.posterior.eval()(torch.from_numpy(np.stack(quiet)))[0].double().numpy()
        self.posterior.train()
        tasks = list(zip(contacts, starts, strict=True))
        fitted = run_tasks(fit_motion, tasks, workers, ordered=True)
        found = list(progress.track(fitted, len(tasks), description="fits"))
        explained = [
            (contact, logs, slopes)
            for contact, (logs, slopes, rms) in zip(contacts, found, strict=True)
            if rms <= EXPLAINED
        ]
        print(f"{len(explained)} of {len(found)} motions explained to {EXPLAINED:g}")
        if not explained:
            raise TrainingError("No motion could be explained; give more --contacts.")
        return Fits.of(*zip(*explained, strict=True))


def fine_loss(posterior: ContactPosterior, drawn: Drawn) -> Tensor:
    """The evidence bound with every likelihood linearised at its own fit, a scalar."""
    mean, factor = posterior(torch.from_numpy(drawn.features))
    information = _tensor(drawn.information)
    offset = mean.detach() - _tensor(drawn.logs)
    gradient = torch.einsum("bpq,bq->bp", information, offset) - _tensor(drawn.pull)
    return preconditioned(mean, factor, gradient, information, posterior.lower, posterior.upper)


def expected_loss(posterior: ContactPosterior, drawn: Drawn) -> Tensor:
    """`bound_loss` of what the posterior expects, a scalar."""
    return bound_loss(posterior.expected_bound_factor(torch.from_numpy(drawn.features)), drawn.information)


def descend(network: nn.Module, loss_of: Callable[[int], Tensor], steps: int, rate: float) -> Iterator[float]:
    """Descend a network's loss, a function of the step's number; gives it after each step."""
    optimizer = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=1e-4)
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


def _tensor(values) -> Tensor:
    return torch.as_tensor(np.asarray(values), dtype=torch.float32)


def _scene_contacts(task: tuple[SceneSettings, int, float]) -> list[SimulatedContact]:
    settings, seed, time_step = task
    return draw_contacts(settings, seed, CONTACTS_A_SCENE, time_step)


def make_contacts(count: int, seed: int, progress: Progress, workers: int | None = None) -> list[SimulatedContact]:
    """About `count` contacts of many scenes, the regimes in turn, as in the benchmark.

    Args:
        count: contacts.
        seed: another seed gives other scenes.
        progress: gets a bar.
        workers: processes; None = one a core, 0 = in this one.

    Raises:
        TrainingError: none could be drawn.
        WorkerLost: a process was killed.
    """
    seeds = np.random.SeedSequence((seed, 0xC0)).generate_state(-(-count // CONTACTS_A_SCENE)).tolist()
    turns = [dataclasses.replace(SCENES, regime=regime) for regime in REGIMES]
    tasks = [(turns[number % len(turns)], scene, MECHANICS.time_step) for number, scene in enumerate(seeds)]
    drawn = run_tasks(_scene_contacts, tasks, workers, ordered=True)
    scenes = progress.track(drawn, len(tasks), description="scenes")
    found = [contact for contacts in scenes for contact in contacts]
    if not found:
        raise TrainingError("No contact could be drawn; give more --contacts or another --seed.")
    return found


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m estimators.network.training",
        description=__doc__.split("\n")[0],
        epilog="Exit status: 0 done; 1 failed; 2 wrong usage; 130 interrupted.",
    )
    add = parser.add_argument
    add("--output", type=path_option, required=True, help=f"folder for {WEIGHTS} and {LOG}")
    add("--contacts", type=whole_number(1), default=8000, help="motions to train on (default %(default)s)")
    steps = whole_number(LEAST_STEPS)
    add("--rough-steps", type=steps, default=2250, help="(default %(default)s)")
    add("--fine-steps", type=steps, default=12000, help="(default %(default)s)")
    add("--bound-steps", type=steps, default=4000, help="(default %(default)s)")
    add("--seed", type=whole_number(0), default=0, help="(default %(default)s)")
    text = "processes that draw contacts and explain motions; 0 = in this one (default: one a core)"
    add("--workers", type=whole_number(0), default=os.cpu_count(), help=text)
    return parser


def train(options: argparse.Namespace) -> None:
    """Train and save.

    Raises:
        OSError: the output folder can't be written.
        TrainingError: there is nothing to train on.
        WorkerLost: a process was killed.
    """
    options.output.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(max(1, (os.cpu_count() or 1) // 2))
    start = time.time()
    with progress_bars(Console()) as progress, (options.output / LOG).open("w") as log:
        trainer = Trainer(make_contacts(options.contacts, options.seed, progress, options.workers), options.seed)
        posterior = trainer.posterior

        def stage(name: str, network: nn.Module, loss_of: Callable[[int], Tensor], steps: int, rate: float) -> None:
            losses = progress.track(descend(network, loss_of, steps, rate), steps, description=name)
            for step, loss in enumerate(losses, start=1):
                if step % max(1, steps // 10) == 0:
                    row = {"stage": name, "step": step, "seconds": round(time.time() - start), "loss": loss}
                    log.write(json.dumps(row) + "\n")
                    log.flush()

        def drawn() -> Drawn:
            return draw_observed(fits, FINE_BATCH, trainer.generator)

        steps = options.rough_steps
        stage("rough", posterior, lambda step: trainer.rough_loss(step / steps), steps, ROUGH_RATE)
        fits = trainer.fit(progress, options.workers)
        stage("fine", posterior, lambda _: fine_loss(posterior, drawn()), options.fine_steps, FINE_RATE)
        bound = posterior.expected_bound
        stage("bound", bound, lambda _: expected_loss(posterior, drawn()), options.bound_steps, FINE_RATE)
    with replacing(options.output / WEIGHTS) as weights:
        torch.save(posterior.state_dict(), weights)
    print(f"{options.output}/{WEIGHTS} written after {(time.time() - start) / 3600:.2f} h")


def main(arguments: list[str] | None = None) -> int:
    """Train as the command line asks for; returns the exit status."""
    console, options = Console(stderr=True), build_parser().parse_args(arguments)
    if (options.output / WEIGHTS).exists():
        text = f"{options.output} holds a finished training; give another --output, or remove that folder."
        say(console, text, "red")
        return 2
    try:
        train(options)
    except KeyboardInterrupt:
        text = f"Interrupted; {options.output} holds no {WEIGHTS}, and the same command starts anew."
        say(console, text, "yellow")
        return INTERRUPTED
    except (OSError, TrainingError, WorkerLost) as error:
        say(console, str(error), "red")
        return 1
    return 0


if __name__ == "__main__":
    run_door(main)
