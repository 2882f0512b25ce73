"""Trains the contact posterior without labels: amortised variational inference on observed contact motions.

    python -m estimators.contact_training --output runs/contact [--contacts 24000] [--steps 8000]

The loss is the evidence bound: the trajectory residual with its σ is the likelihood, the admissible box the prior (a
Gaussian with the box's mean and variance). It reads motions and noise levels, never θ; θ of held-out contacts is read by
the printed evaluation alone. Training starts with a large σ, which is lowered to the true one: an under-damped response
has an optimum for every number of swings, and only the wide view shows which is right.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor

from data.contact_features import FEATURES, contact_features, contact_surroundings
from data.samples import ContactCase
from data.simulated_contacts import SimulatedContact, draw_contacts
from data.synthetic_settings import SceneSettings
from estimators.direct import DirectSettings
from models.posterior import ContactPosterior, evidence_loss
from physics.identifiability import bounds, fisher_information, log_jacobian
from physics.mechanics import Mechanics
from physics.msd_kernel import simulate_sensitivities

MECHANICS = Mechanics(time_step=0.005, steps=200, load_steps=0, scheme="dkd", window_error=1e-4)
"""The fitted simulator; θ and the motions' own simulator stay apart from it."""
CONTACTS_A_SCENE = 8
NOISE = (3e-4, 6e-3)
"""σ is drawn log-uniformly from this range [scene units]."""
ROUNDING_SHARE, LEVEL = 0.25, 1 / 255
"""Share of samples whose depth is rounded instead, as 8 bits do, and the rounding's step [scene units]."""
REST_SHARE = 0.15
"""Error of the rest position, in σ: the rest surface is an average of many depths."""
CUT_SHARE = 0.4
"""Share of samples that are cut off before the second is over, as live frames see them."""
FIRST_BLUR = 0.3
"""Training starts with σ raised by this share of the contact's largest motion."""
LONGEST_MOVE = 1.0
"""A mean is moved no farther than this at once in any log-parameter: the linearisation reaches no farther."""


def observed(contact: SimulatedContact, generator: np.random.Generator) -> ContactCase:
    """The contact as it would be seen: with noise or rounding, and perhaps only its beginning."""
    case, shape = contact.case, contact.case.displacement.shape
    if generator.random() < ROUNDING_SHARE:
        noise = LEVEL / math.sqrt(12)
        place = generator.uniform(0, LEVEL)
        along = case.displacement @ case.direction
        rounded = np.rint((along + place) / LEVEL) * LEVEL - np.rint(place / LEVEL) * LEVEL
        error = (rounded - along)[:, None] * case.direction
    else:
        noise = math.exp(generator.uniform(*np.log(NOISE)))
        values = generator.normal(0, noise, shape[0]) + generator.normal(0, REST_SHARE * noise)
        error = values[:, None] * case.direction
    count = shape[0]
    if generator.random() < CUT_SHARE:
        count = int(generator.integers(3, count + 1))
    return dataclasses.replace(
        case,
        steps=case.steps[:count],
        displacement=(case.displacement + error)[:count].astype(np.float32),
        weight=case.weight[:count],
        load_steps=min(case.load_steps, int(case.steps[count - 1]) + 1),
        noise=noise,
    )


@dataclasses.dataclass(frozen=True)
class Linearised:
    """A contact's misfit around one φ."""

    gradient: np.ndarray
    """Jᵀr/σ², shape [3]."""
    information: np.ndarray
    """JᵀJ/σ², shape [3, 3]."""


def linearise(case: ContactCase, logs: np.ndarray, blur: float) -> Linearised:
    """Gradient and Fisher information of a contact's misfit at φ; `blur` widens σ by a share of the largest motion."""
    theta = np.exp(logs.astype(np.float64)) * (1.0, 1.0, -1.0)
    steps = int(case.steps[-1]) + 1
    mechanics = dataclasses.replace(MECHANICS, steps=steps)
    path, slopes = simulate_sensitivities(
        theta, case.mesh, case.vertex, case.direction, mechanics, load_steps=min(case.load_steps, steps)
    )
    largest = float(np.linalg.norm(case.displacement, axis=1).max())
    sigma = math.hypot(case.noise, blur * largest)
    residual = (path[case.steps] - case.displacement).astype(np.float64).ravel()
    jacobian = log_jacobian(slopes[case.steps].astype(np.float64), theta).reshape(-1, 3)
    return Linearised(jacobian.T @ residual / sigma**2, fisher_information(jacobian, sigma))


class Trainer:
    """The posterior and its training on a fixed set of contacts."""

    def __init__(self, contacts: list[SimulatedContact], settings: DirectSettings, seed: int) -> None:
        torch.manual_seed(seed)
        self.contacts = contacts
        self.generator = np.random.default_rng([seed, 17])
        self.surroundings = [contact_surroundings(contact.case) for contact in contacts]
        box = settings.box
        self.prior_mean = torch.tensor(box.mean(axis=0), dtype=torch.float32)
        self.prior = torch.diag(torch.tensor(12 / (box[1] - box[0]) ** 2, dtype=torch.float32))
        self.posterior = ContactPosterior(FEATURES, torch.tensor(box))
        sample = [self.draw() for _ in range(2000)]
        self.posterior.standardise(torch.tensor(np.stack([features for _, features in sample])))
        self.threads = ThreadPoolExecutor(os.cpu_count())

    def draw(self) -> tuple[ContactCase, np.ndarray]:
        """A contact as seen, and its features."""
        index = self.generator.integers(len(self.contacts))
        case = observed(self.contacts[index], self.generator)
        return case, contact_features(case, MECHANICS.time_step, surroundings=self.surroundings[index])

    def loss(self, batch: list[tuple[ContactCase, np.ndarray]], blur: float) -> tuple[Tensor, Tensor]:
        """Evidence loss of a batch, and its mean misfit in σ."""
        mean, factor = self.posterior(torch.from_numpy(np.stack([features for _, features in batch])))
        logs = mean.detach().numpy()
        cases = [case for case, _ in batch]
        found = list(self.threads.map(linearise, cases, logs, [blur] * len(cases)))
        gradient = torch.tensor(np.stack([item.gradient for item in found]), dtype=torch.float32)
        information = torch.tensor(np.stack([item.information for item in found]), dtype=torch.float32) + self.prior
        gradient = gradient + (mean.detach() - self.prior_mean) @ self.prior
        move = torch.linalg.solve(information, gradient)
        shorter = (LONGEST_MOVE / move.abs().amax(dim=1)).clamp(max=1.0)
        weight = shorter / information.diagonal(dim1=1, dim2=2).mean(1).sqrt()
        return evidence_loss(mean, factor, gradient, information, weight), move.abs().mean()

    def fit(self, steps: int, batch_size: int, rate: float, advance) -> None:
        """Train for a number of steps; `advance(step, loss, move)` is called after each."""
        optimizer = torch.optim.AdamW(self.posterior.parameters(), lr=rate, weight_decay=1e-4)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=steps, pct_start=0.05)
        for step in range(steps):
            share = min(1.0, 2 * step / steps)
            blur = FIRST_BLUR * (0.01**share) if share < 1 else 0.0
            loss, move = self.loss([self.draw() for _ in range(batch_size)], blur)
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(self.posterior.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            advance(step, float(loss.detach()), float(move))


@torch.no_grad()
def evaluate(posterior: ContactPosterior, contacts: list[SimulatedContact], noise: float, seed: int) -> dict[str, list]:
    """Root mean square log errors against bounds on held-out contacts, where the bounds are below 0.5."""
    generator = np.random.default_rng(seed)
    errors, limits, scores = [], [], []
    for contact in contacts:
        values = generator.normal(0, noise, len(contact.case.steps))[:, None] * contact.case.direction
        moved = (contact.case.displacement + values).astype(np.float32)
        case = dataclasses.replace(contact.case, displacement=moved, noise=noise)
        truth = np.log(np.abs(contact.theta))
        mean, factor = posterior(torch.from_numpy(contact_features(case, MECHANICS.time_step))[None])
        error = mean[0].double().numpy() - truth
        errors.append(error)
        limits.append(bounds(linearise(case, truth, 0.0).information))
        scores.append(error / (factor[0] @ factor[0].T).diagonal().sqrt().double().numpy())
    errors, limits, scores = np.array(errors), np.array(limits), np.array(scores)
    known = limits < 0.5
    pick = [known[:, index] for index in range(3)]
    return {
        "rmse": [float(np.sqrt(np.mean(errors[k, i] ** 2))) for i, k in enumerate(pick)],
        "bound": [float(np.sqrt(np.mean(limits[k, i] ** 2))) for i, k in enumerate(pick)],
        "score": [float(np.sqrt(np.mean(scores[k, i] ** 2))) for i, k in enumerate(pick)],
        "ratio_error": [float(np.sqrt(np.mean((errors[:, a] - errors[:, 1]) ** 2))) for a in (0, 2)],
    }


def _scene_contacts(task: tuple[SceneSettings, int, float]) -> list[SimulatedContact]:
    settings, seed, time_step = task
    return draw_contacts(settings, seed, CONTACTS_A_SCENE, time_step)


def make_contacts(count: int, seed: int) -> list[SimulatedContact]:
    """At least `count` contacts of many scenes, drawn on all cores."""
    settings = SceneSettings(width=214, height=120)
    seeds = np.random.SeedSequence((seed, 0xC0)).generate_state(-(-count // CONTACTS_A_SCENE)).tolist()
    tasks = [(settings, scene, MECHANICS.time_step) for scene in seeds]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    found: list[SimulatedContact] = []
    with ProcessPoolExecutor() as pool, Progress(*columns) as progress:
        job = progress.add_task("scenes", total=len(tasks))
        for contacts in pool.map(_scene_contacts, tasks, chunksize=4):
            found += contacts
            progress.advance(job)
    return found


def main() -> None:
    """Train, evaluate, save."""
    parser = argparse.ArgumentParser(prog="python -m estimators.contact_training", description=__doc__.split("\n")[0])
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--contacts", type=int, default=24000)
    parser.add_argument("--steps", type=int, default=8000)
    parser.add_argument("--batch", type=int, default=96)
    parser.add_argument("--rate", type=float, default=1e-3)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    start = time.time()
    contacts = make_contacts(options.contacts, options.seed)
    held_out = make_contacts(400, options.seed + 1)
    trainer = Trainer(contacts, DirectSettings(), options.seed)
    print(f"{len(contacts)} contacts in {time.time() - start:.0f} s")

    def advance(step: int, loss: float, move: float) -> None:
        if (step + 1) % 250 == 0 or step + 1 == options.steps:
            report = evaluate(trainer.posterior.eval(), held_out, 1e-3, 3)
            trainer.posterior.train()
            print(json.dumps({"step": step + 1, "s": round(time.time() - start), "loss": round(loss, 3),
                              "move": round(move, 3)} | {k: np.round(v, 3).tolist() for k, v in report.items()}), flush=True)
            torch.save(trainer.posterior.state_dict(), options.output / "posterior.pt")

    trainer.fit(options.steps, options.batch, options.rate, advance)


if __name__ == "__main__":
    main()
