"""Trains the contact posterior without labels: amortised variational inference on observed contact motions.

    python -m estimators.network.training --output runs/contact [--contacts 8000]

The loss is the evidence bound: the trajectory residual with its σ is the likelihood, the admissible box the prior (a
Gaussian with the box's mean and variance). It reads motions and noise levels, never θ; θ of held-out contacts is read
by the logged evaluation alone. Four stages, because a rollout costs more than the network:
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
from collections.abc import Callable
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
from physics.identifiability import bounds
from physics.likelihood import Likelihood, Linearised

WEIGHTS, UNFINISHED, LOG = "posterior.pt", "unfinished.pt", "training.jsonl"
"""Files of the output folder; the second becomes the first when all is done."""
CONTACTS_A_SCENE = 8
HELD_OUT = 400
"""Contacts that the logged evaluation reads."""
LEAST_STEPS = 4
"""A stage's learning rate rises over three steps, and falls."""
FINE_BATCH, FINE_RATE = 512, 2e-3
"""Samples a step of the last two stages, and their largest learning rate."""
BLUR = 0.3, 0.03
"""σ of the rough stage is raised by this share of a contact's largest motion, at its beginning and its end."""


class TrainingError(ValueError):
    """There is nothing to train on; the message is a sentence."""


def widened(contact: Interaction, logs: np.ndarray, blur: float) -> Linearised:
    """A contact's likelihood around φ, with σ widened by a share (`blur`) of its largest motion."""
    largest = float(np.linalg.norm(contact.moved, axis=1).max())
    observation = contact.observation.moved(contact.moved, math.hypot(contact.noise, blur * largest))
    return Likelihood(contact.mesh, contact.load, observation, MECHANICS, np.float32).linearise(logs)


def noisy(contact: Interaction, noise: float, generator: np.random.Generator) -> Interaction:
    """A contact without noise as it might have been observed, its errors along the force."""
    error = generator.normal(0, noise, len(contact.observation))[:, None] * contact.direction
    return dataclasses.replace(contact, observation=contact.observation.moved(contact.moved + error, noise))


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
        """A contact with Gaussian noise, and its features."""
        index = int(self.generator.integers(len(self.contacts)))
        noise = math.exp(self.generator.uniform(*np.log(NOISE)))
        seen = noisy(self.contacts[index].interaction, noise, self.generator)
        return seen, contact_features(seen, self.surroundings[index])

    def rough(self, steps: int, batch_size: int, rate: float, advance: Callable[[int, float], None]) -> None:
        """First stage: `advance(step, loss)` is called after each of its steps."""

        def loss(step: int) -> Tensor:
            blur = BLUR[0] * (BLUR[1] / BLUR[0]) ** (step / steps)
            batch = [self.draw() for _ in range(batch_size)]
            mean, factor = self.posterior(torch.from_numpy(np.stack([features for _, features in batch])))
            contacts = [contact for contact, _ in batch]
            found = list(self.threads.map(widened, contacts, mean.detach().numpy(), [blur] * len(contacts)))
            gradient, information = (
                _tensor([getattr(item, name) for item in found]) for name in ("gradient", "information")
            )
            box = self.posterior.lower, self.posterior.upper
            return preconditioned(mean, factor, gradient, information, *box, whiten=False)

        descend(self.posterior, loss, steps, rate, advance)

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
        job = progress.add_task("fits", total=len(contacts))
        found = []
        tasks = list(zip(contacts, starts, strict=True))
        for result in run_tasks(fit_motion, tasks, workers, ordered=True):
            found.append(result)
            progress.advance(job)
        kept = [index for index, (_, _, rms) in enumerate(found) if rms <= EXPLAINED]
        print(f"{len(kept)} of {len(found)} motions explained to {EXPLAINED:g}")
        if not kept:
            raise TrainingError("No motion could be explained; give more --contacts.")
        return Fits.of(
            [contacts[index] for index in kept],
            [self.surroundings[index] for index in kept],
            [found[index][0] for index in kept],
            [found[index][1] for index in kept],
        )

    def fine(self, fits: Fits, steps: int, batch_size: int, rate: float, advance: Callable[[int, float], None]) -> None:
        """Third stage, on fits: `advance(step, loss)` is called after each of its steps."""

        def loss(_: int) -> Tensor:
            return fine_loss(self.posterior, draw_observed(fits, batch_size, self.generator))

        descend(self.posterior, loss, steps, rate, advance)

    def learn_bound(
        self, fits: Fits, steps: int, batch_size: int, rate: float, advance: Callable[[int, float], None]
    ) -> None:
        """Last stage, on fits: `advance(step, loss)` is called after each of its steps."""

        def loss(_: int) -> Tensor:
            drawn = draw_observed(fits, batch_size, self.generator)
            return bound_loss(self.posterior.expected_bound_factor(torch.from_numpy(drawn.features)), drawn.information)

        descend(self.posterior.expected_bound, loss, steps, rate, advance)


def fine_loss(posterior: ContactPosterior, drawn: Drawn) -> Tensor:
    """The evidence bound with every likelihood linearised at its own fit, a scalar."""
    mean, factor = posterior(torch.from_numpy(drawn.features))
    information = _tensor(drawn.information)
    offset = mean.detach() - _tensor(drawn.logs)
    gradient = torch.einsum("bpq,bq->bp", information, offset) - _tensor(drawn.pull)
    return preconditioned(mean, factor, gradient, information, posterior.lower, posterior.upper)


def descend(
    network: nn.Module,
    loss_of: Callable[[int], Tensor],
    steps: int,
    rate: float,
    advance: Callable[[int, float], None],
) -> None:
    """Descend a network's loss, a function of the step's number; `advance(step, loss)` is called after each step."""
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
        advance(step, float(loss.detach()))


def _tensor(values) -> Tensor:
    return torch.as_tensor(np.asarray(values), dtype=torch.float32)


@torch.no_grad()
def evaluate(posterior: ContactPosterior, contacts: list[SimulatedContact], noise: float, seed: int) -> dict[str, list]:
    """Root mean square log errors against bounds on held-out contacts, where the bounds are below 0.5.

    And `expected`: the median of |log expected bound / bound|, where the bounds are below that as well.
    """
    generator = np.random.default_rng(seed)
    errors, limits, scores, expected = [], [], [], []
    for contact in contacts:
        seen, truth = noisy(contact.interaction, noise, generator), np.log(np.abs(contact.theta))
        features = torch.from_numpy(contact_features(seen))[None]
        mean, factor = posterior(features)
        expected.append(posterior.expected_bound_factor(features)[0].norm(dim=1).double().numpy())
        error = mean[0].double().numpy() - truth
        errors.append(error)
        limits.append(bounds(widened(seen, truth, 0.0).information))
        scores.append(error / (factor[0] @ factor[0].T).diagonal().sqrt().double().numpy())
    errors, limits, scores, expected = (np.array(values) for values in (errors, limits, scores, expected))
    pick = [limits[:, index] < 0.5 for index in range(3)]
    return {
        "rmse": [float(np.sqrt(np.mean(errors[k, i] ** 2))) for i, k in enumerate(pick)],
        "bound": [float(np.sqrt(np.mean(limits[k, i] ** 2))) for i, k in enumerate(pick)],
        "score": [float(np.sqrt(np.mean(scores[k, i] ** 2))) for i, k in enumerate(pick)],
        "expected": [float(np.median(np.abs(np.log(expected[k, i] / limits[k, i])))) for i, k in enumerate(pick)],
        "ratio_rmse": [float(np.sqrt(np.mean((errors[:, a] - errors[:, 1]) ** 2))) for a in (0, 2)],
    }


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
    found: list[SimulatedContact] = []
    job = progress.add_task("scenes", total=len(tasks))
    for contacts in run_tasks(_scene_contacts, tasks, workers, ordered=True):
        found += contacts
        progress.advance(job)
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
    text = f"folder for {WEIGHTS} ({UNFINISHED} until all is done) and {LOG}"
    add("--output", type=path_option, required=True, help=text)
    add("--contacts", type=whole_number(1), default=8000, help="motions to train on (default %(default)s)")
    steps, maybe = whole_number(LEAST_STEPS), whole_number(LEAST_STEPS, or_zero=True)
    add("--rough-steps", type=maybe, default=2250, help="0 = none (default %(default)s)")
    add("--fine-steps", type=steps, default=12000, help="(default %(default)s)")
    add("--bound-steps", type=steps, default=4000, help="(default %(default)s)")
    add("--seed", type=whole_number(0), default=0, help="(default %(default)s)")
    text = "processes that draw contacts and explain motions; 0 = in this one (default: one a core)"
    add("--workers", type=whole_number(0), default=os.cpu_count(), help=text)
    return parser


def train(options: argparse.Namespace) -> None:
    """Train, evaluate, save.

    Raises:
        OSError: the output folder can't be written.
        TrainingError: there is nothing to train on.
        WorkerLost: a process was killed.
    """
    options.output.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(max(1, (os.cpu_count() or 1) // 2))
    start, unfinished = time.time(), options.output / UNFINISHED
    with progress_bars(Console()) as progress, (options.output / LOG).open("w") as log:
        contacts = make_contacts(options.contacts, options.seed, progress, options.workers)
        held_out = make_contacts(HELD_OUT, options.seed + 1, progress, options.workers)
        trainer = Trainer(contacts, options.seed)

        def stage(name: str, steps: int) -> Callable[[int, float], None]:
            job = progress.add_task(name, total=steps)

            def advance(step: int, loss: float) -> None:
                progress.advance(job)
                if (step + 1) % max(1, steps // 10) == 0:
                    report = evaluate(trainer.posterior.eval(), held_out, 1e-3, 3)
                    trainer.posterior.train()
                    row = {"stage": name, "step": step + 1, "seconds": round(time.time() - start), "loss": loss}
                    log.write(json.dumps(row | report) + "\n")
                    log.flush()
                    torch.save(trainer.posterior.state_dict(), unfinished)

            return advance

        if options.rough_steps:
            trainer.rough(options.rough_steps, 64, 1e-3, stage("rough", options.rough_steps))
        fits = trainer.fit(progress, options.workers)
        trainer.fine(fits, options.fine_steps, FINE_BATCH, FINE_RATE, stage("fine", options.fine_steps))
        trainer.learn_bound(fits, options.bound_steps, FINE_BATCH, FINE_RATE, stage("bound", options.bound_steps))
    with replacing(options.output / WEIGHTS) as weights:
        torch.save(trainer.posterior.state_dict(), weights)
    unfinished.unlink(missing_ok=True)
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
