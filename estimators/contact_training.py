"""Trains the contact posterior without labels: amortised variational inference on observed contact motions.

    python -m estimators.contact_training --output runs/contact [--contacts 8000]

The loss is the evidence bound: the trajectory residual with its σ is the likelihood, the admissible box the prior (a
Gaussian with the box's mean and variance). It reads motions and noise levels, never θ; θ of held-out contacts is read
by the logged evaluation alone. Three stages, because a rollout costs more than the network:
 1. `rough`: rollouts at the network's own mean, with σ raised by a share of the motion: an under-damped response has an
    optimum for every number of swings, and only the wide view shows which is right.
 2. `fit`: every motion is explained once, by least squares from the network's estimate (or from several starts).
 3. `fine`: the likelihood is linearised at those fits (exact Jacobians), so that noise, rounding and cut-off windows
    are drawn anew for every step without a rollout.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from scipy.optimize import least_squares
from torch import Tensor

from data.contact_features import FEATURES, SLOTS, contact_features, contact_surroundings, join_features, slot_times
from data.samples import ContactCase
from data.simulated_contacts import SimulatedContact, draw_contacts
from data.synthetic_settings import SceneSettings
from estimators.contact_network import log_box
from estimators.direct import ContactProblem
from models.posterior import ContactPosterior, evidence_loss
from physics.identifiability import bounds, fisher_information, log_jacobian
from physics.mechanics import Bounds, Mechanics
from physics.msd_kernel import simulate_sensitivities

MECHANICS = Mechanics(time_step=0.005, steps=200, load_steps=0, scheme="dkd", window_error=1e-4)
"""The fitted simulator."""
BOUNDS = Bounds((0.05, 1.0), (0.005, 0.5), (-0.3, -0.01), (0.4, 0.08, -0.1))
"""Admissible box, the prior."""
CONTACTS_A_SCENE = 8
NOISE = (3e-4, 6e-3)
"""σ is drawn log-uniformly from this range [scene units]."""
ROUNDING_SHARE, LEVEL = 0.25, 1 / 255
"""Share of samples whose depth is rounded instead, as 8 bits do, and the rounding's step [scene units]."""
REST_SHARE = 0.15
"""Error of the rest position, in σ: the rest surface is an average of many depths."""
CUT_SHARE = 0.3
"""Share of samples that are cut off before the second is over, as live frames see them."""
BLUR = 0.3, 0.03
"""σ of the rough stage is raised by this share of a contact's largest motion, at its beginning and its end."""
LONGEST_MOVE = 1.0
"""A mean is moved no farther than this at once in any log-parameter: the linearisation reaches no farther."""
PULL = 0.2
"""Weight of the mean's pull against the covariance's; it changes how fast the two are learnt, not where they end."""
EXPLAINED = 2e-4
"""A fit explains a motion without noise where its RMS residual is below this [scene units]."""


def noise_level(case: ContactCase, noise: float) -> ContactCase:
    """The contact as if observed with that noise level, but without the noise."""
    return dataclasses.replace(case, noise=noise)


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


@dataclasses.dataclass(frozen=True)
class Fits:
    """Contacts with what explains their motions, as arrays; N contacts."""

    motion: np.ndarray
    """Motion against the force's direction at the slots, without noise, shape [N, SLOTS] [scene units]."""
    logs: np.ndarray
    """φ that explains it, shape [N, 3]."""
    slopes: np.ndarray
    """Derivatives of the motion by φ there, shape [N, SLOTS, 3] [scene units]."""
    loaded: np.ndarray
    """Whether a slot is under load, shape [N, SLOTS]."""
    around: np.ndarray
    """`Surroundings.vector`, shape [N, 40]."""
    spacing: np.ndarray
    """Shape [N] [scene units]."""


def fit_motion(task: tuple[ContactCase, np.ndarray]) -> tuple[np.ndarray, np.ndarray, float]:
    """φ [3] that explains a motion, its slopes along the force [SLOTS, 3], and the RMS residual [scene units].

    Args:
        task: the contact without noise, and where to start.
    """
    case, start = task
    low, high = log_box(BOUNDS)
    problem = ContactProblem(noise_level(case, 1e-3), MECHANICS, 1e-3)
    starts = [np.clip(start, low + 1e-3, high - 1e-3)]
    best, rms = None, math.inf
    while starts:
        end = least_squares(
            problem.residual, starts.pop(0), problem.jacobian, (low, high), x_scale="jac", ftol=1e-6, max_nfev=30
        )
        residual = 1e-3 * math.sqrt(2 * end.cost / len(case.steps))
        if best is None or residual < rms:
            if best is None and residual > EXPLAINED:
                starts = list(problem.starts(low, high))
            best, rms = end.x, residual
        if rms <= EXPLAINED:
            break
    jacobian = 1e-3 * problem.jacobian(best).reshape(len(case.steps), 3, 3)
    return best, -np.einsum("tdp,d->tp", jacobian, case.direction), rms


class Trainer:
    """The posterior and its training on a fixed set of contacts."""

    def __init__(self, contacts: list[SimulatedContact], seed: int) -> None:
        torch.manual_seed(seed)
        self.contacts = contacts
        self.generator = np.random.default_rng([seed, 17])
        self.surroundings = [contact_surroundings(contact.case) for contact in contacts]
        box = log_box(BOUNDS)
        self.prior_mean = torch.tensor(box.mean(axis=0), dtype=torch.float32)
        self.prior = torch.diag(torch.tensor(12 / (box[1] - box[0]) ** 2, dtype=torch.float32))
        self.posterior = ContactPosterior(FEATURES, torch.tensor(box))
        sample = [self.draw() for _ in range(2000)]
        self.posterior.standardise(torch.tensor(np.stack([features for _, features in sample])))
        self.threads = ThreadPoolExecutor(os.cpu_count())

    def draw(self) -> tuple[ContactCase, np.ndarray]:
        """A contact with Gaussian noise, and its features."""
        index = int(self.generator.integers(len(self.contacts)))
        case = self.contacts[index].case
        noise = math.exp(self.generator.uniform(*np.log(NOISE)))
        error = self.generator.normal(0, noise, len(case.steps))[:, None] * case.direction
        seen = dataclasses.replace(case, displacement=(case.displacement + error).astype(np.float32), noise=noise)
        return seen, contact_features(seen, MECHANICS.time_step, surroundings=self.surroundings[index])

    def rough(self, steps: int, batch_size: int, rate: float, advance: Callable[[int, float], None]) -> None:
        """First stage: `advance(step, loss)` is called after each of its steps."""

        def loss(step: int) -> Tensor:
            blur = BLUR[0] * (BLUR[1] / BLUR[0]) ** (step / steps)
            batch = [self.draw() for _ in range(batch_size)]
            mean, factor = self.posterior(torch.from_numpy(np.stack([features for _, features in batch])))
            cases = [case for case, _ in batch]
            found = list(self.threads.map(linearise, cases, mean.detach().numpy(), [blur] * len(cases)))
            gradient = _tensor([item.gradient for item in found])
            return self._bound(mean, factor, gradient, _tensor([item.information for item in found]), rough=True)

        self._descend(loss, steps, rate, advance)

    def fit(self, progress: Progress) -> Fits:
        """Second stage: what explains every motion; motions that nothing explains are left out and counted."""
        quiet = [contact_features(noise_level(contact.case, 3e-4), MECHANICS.time_step) for contact in self.contacts]
        with torch.no_grad():
            starts = self.posterior.eval()(torch.from_numpy(np.stack(quiet)))[0].double().numpy()
        self.posterior.train()
        cases = [contact.case for contact in self.contacts]
        job = progress.add_task("fits", total=len(cases))
        found = []
        with ProcessPoolExecutor() as pool:
            for result in pool.map(fit_motion, zip(cases, starts, strict=True), chunksize=16):
                found.append(result)
                progress.advance(job)
        kept = [index for index, (_, _, rms) in enumerate(found) if rms <= EXPLAINED]
        print(f"{len(kept)} of {len(found)} motions explained to {EXPLAINED:g}")
        slots = slot_times() + 1e-9
        return Fits(
            motion=np.stack([-(cases[index].displacement @ cases[index].direction) for index in kept]),
            logs=np.stack([found[index][0] for index in kept]),
            slopes=np.stack([found[index][1] for index in kept]),
            loaded=np.stack([slots <= cases[index].load_steps * MECHANICS.time_step + 2e-9 for index in kept]) * 1.0,
            around=np.stack([self.surroundings[index].vector for index in kept]),
            spacing=np.array([self.surroundings[index].spacing for index in kept]),
        )

    def fine(self, fits: Fits, steps: int, batch_size: int, rate: float, advance: Callable[[int, float], None]) -> None:
        """Third stage, on fits: `advance(step, loss)` is called after each of its steps."""

        def loss(_: int) -> Tensor:
            index = self.generator.integers(len(fits.logs), size=batch_size)
            motion = fits.motion[index]
            error, noise = draw_errors(motion, self.generator)
            known = draw_known(batch_size, self.generator)
            along = (motion + error) / fits.spacing[index, None]
            loaded = fits.loaded[index] * known
            features = join_features(along, known, loaded, fits.around[index], fits.spacing[index], noise)
            mean, factor = self.posterior(torch.from_numpy(features))
            slopes = fits.slopes[index] * (known / noise[:, None])[..., None]
            information = np.einsum("btp,btq->bpq", slopes, slopes)
            pull = np.einsum("btp,bt->bp", slopes, error * known / noise[:, None])
            offset = mean.detach() - _tensor(fits.logs[index])
            gradient = torch.einsum("bpq,bq->bp", _tensor(information), offset) - _tensor(pull)
            return self._bound(mean, factor, gradient, _tensor(information))

        self._descend(loss, steps, rate, advance)

    def _bound(
        self, mean: Tensor, factor: Tensor, gradient: Tensor, information: Tensor, *, rough: bool = False
    ) -> Tensor:
        """Evidence loss with the prior added.

        The mean's pull H·move is scaled by the root of H's mean diagonal, or, once the ratios are known, replaced by
        √H·move, which vanishes at the same place: what is known a hundred times better than something else would
        otherwise be learnt ten thousand times faster.
        """
        information = information + self.prior
        gradient = gradient + (mean.detach() - self.prior_mean) @ self.prior
        values, vectors = torch.linalg.eigh(information)
        move = torch.einsum("bpq,bq,brq,br->bp", vectors, 1 / values, vectors, gradient)
        shorter = (LONGEST_MOVE / move.abs().amax(dim=1)).clamp(max=1.0)
        if rough:
            pull = gradient / information.diagonal(dim1=1, dim2=2).mean(dim=1, keepdim=True).sqrt()
        else:
            pull = PULL * torch.einsum("bpq,bq,brq,br->bp", vectors, values.rsqrt(), vectors, gradient)
        return evidence_loss(mean, factor, pull, information, shorter)

    def _descend(self, loss_of, steps: int, rate: float, advance: Callable[[int, float], None]) -> None:
        optimizer = torch.optim.AdamW(self.posterior.parameters(), lr=rate, weight_decay=1e-4)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=steps, pct_start=0.1)
        for step in range(steps):
            loss = loss_of(step)
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(self.posterior.parameters(), 1.0)
            optimizer.step()
            schedule.step()
            advance(step, float(loss.detach()))


def draw_errors(motion: np.ndarray, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Errors of observed motions, shape [B, SLOTS], and the noise level that each is said to have, [B] [scene units].

    A part of the samples is rounded like 8-bit depth, the others have Gaussian noise and an error of the rest position.
    """
    count = len(motion)
    noise = np.exp(generator.uniform(*np.log(NOISE), size=count))
    error = noise[:, None] * (generator.normal(size=motion.shape) + REST_SHARE * generator.normal(size=(count, 1)))
    rounded = generator.random(count) < ROUNDING_SHARE
    place = generator.uniform(0, LEVEL, (count, 1))
    steps = np.rint((motion + place) / LEVEL) * LEVEL - np.rint(place / LEVEL) * LEVEL
    error[rounded] = (steps - motion)[rounded]
    noise[rounded] = LEVEL / math.sqrt(12)
    return error, noise


def draw_known(count: int, generator: np.random.Generator) -> np.ndarray:
    """Which slots are seen, shape [count, SLOTS]: all, or the first few."""
    last = np.where(generator.random(count) < CUT_SHARE, generator.integers(2, SLOTS + 1, count), SLOTS)
    return (np.arange(SLOTS) < last[:, None]).astype(np.float64)


def _tensor(values) -> Tensor:
    return torch.as_tensor(np.asarray(values), dtype=torch.float32)


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
    pick = [limits[:, index] < 0.5 for index in range(3)]
    return {
        "rmse": [float(np.sqrt(np.mean(errors[k, i] ** 2))) for i, k in enumerate(pick)],
        "bound": [float(np.sqrt(np.mean(limits[k, i] ** 2))) for i, k in enumerate(pick)],
        "score": [float(np.sqrt(np.mean(scores[k, i] ** 2))) for i, k in enumerate(pick)],
        "ratio_rmse": [float(np.sqrt(np.mean((errors[:, a] - errors[:, 1]) ** 2))) for a in (0, 2)],
    }


def _scene_contacts(task: tuple[SceneSettings, int, float]) -> list[SimulatedContact]:
    settings, seed, time_step = task
    return draw_contacts(settings, seed, CONTACTS_A_SCENE, time_step)


def make_contacts(count: int, seed: int, progress: Progress) -> list[SimulatedContact]:
    """About `count` contacts of many scenes, drawn on all cores."""
    settings = SceneSettings(width=214, height=120)
    seeds = np.random.SeedSequence((seed, 0xC0)).generate_state(-(-count // CONTACTS_A_SCENE)).tolist()
    tasks = [(settings, scene, MECHANICS.time_step) for scene in seeds]
    found: list[SimulatedContact] = []
    job = progress.add_task("scenes", total=len(tasks))
    with ProcessPoolExecutor() as pool:
        for contacts in pool.map(_scene_contacts, tasks, chunksize=4):
            found += contacts
            progress.advance(job)
    return found


def main() -> None:
    """Train, evaluate, save."""
    parser = argparse.ArgumentParser(prog="python -m estimators.contact_training", description=__doc__.split("\n")[0])
    parser.add_argument("--output", type=Path, required=True, help="folder for posterior.pt and training.jsonl")
    parser.add_argument("--contacts", type=int, default=8000, help="motions to train on (default %(default)s)")
    parser.add_argument("--rough-steps", type=int, default=2250, help="(default %(default)s)")
    parser.add_argument("--fine-steps", type=int, default=12000, help="(default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="(default %(default)s)")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(max(1, os.cpu_count() // 2))
    start = time.time()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns) as progress, (options.output / "training.jsonl").open("w") as log:
        contacts = make_contacts(options.contacts, options.seed, progress)
        held_out = make_contacts(400, options.seed + 1, progress)
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
                    torch.save(trainer.posterior.state_dict(), options.output / "posterior.pt")

            return advance

        if options.rough_steps:
            trainer.rough(options.rough_steps, 64, 1e-3, stage("rough", options.rough_steps))
        fits = trainer.fit(progress)
        trainer.fine(fits, options.fine_steps, 512, 2e-3, stage("fine", options.fine_steps))
    print(f"{options.output}/posterior.pt written after {(time.time() - start) / 3600:.2f} h")


if __name__ == "__main__":
    main()
