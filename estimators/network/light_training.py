"""Trains the posterior of a contact's brightness sequence: neural posterior estimation on simulated presses.

    palpate train fit -c configs/light.yaml [--light.sheets 3000 …]

Sequences are drawn by `estimators.network.light_draws`, from the simulator and the law of light alone: no video, no
rendered picture and no label of real tissue. The network maximises the density of the parameters that the simulator was
given (Papamakarios & Murray 2016). Every step turns and mirrors the sequences anew, adds errors that persist, and cuts
half of them off, as they are before the contact ends.
"""

import dataclasses
import time
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from torch import Tensor

from palpate.common.command_line import LARGEST_NUMBER, progress_bars
from palpate.common.output import replacing_own, require_own
from palpate.common.settings import require_between
from palpate.common.workers import run_tasks
from palpate.data.contact.features import SLOTS
from palpate.data.contact.light_features import LIGHT_FEATURES, SHAPES, LightSlots, turned
from palpate.estimators.estimate import COMBINATIONS, NINETY, REPORTED, SYMBOLS
from palpate.estimators.network.fits import BOUNDS
from palpate.estimators.network.light_draws import LightDraws, draw_light, noise_factors
from palpate.estimators.network.training import LEAST_STEPS, TrainingError, descend, keep, made_by, read_kept
from palpate.models.evidence import density_loss
from palpate.models.posterior import ContactPosterior

WEIGHTS, DRAWN = "light.pt", "drawn.pt"
"""Files of the output folder; at the end the first appears and the second is removed."""
BATCH, RATE, DECAY = 512, 1.5e-3, 3e-2
"""Sequences a step, the largest learning rate, and the weights' decay."""
WIDTH, BLOCKS = 256, 4
HELD_OUT = 12
"""One of so many sequences is not trained on; the loss on them is printed."""
LEAST_SCALE = 0.02
"""Least scale of the inputs."""
FEWEST_SLOTS = 2
ERRORS = 0.002, 0.03
"""Standard deviations of the errors that a step adds [logarithm of light]."""
PERSISTENCE = 0.6, 0.9, 0.97
"""Their correlations from frame to frame."""


@dataclasses.dataclass(frozen=True)
class LightSettings:
    """Settings of a training."""

    output: Path
    """Folder for the weights."""
    sheets: int = 3000
    """Number of sheets on which presses are drawn, 36 sequences each."""
    steps: int = 12000
    seed: int = 0
    """Another seed gives other sequences, weights and errors."""
    workers: int | None = None
    """Processes that draw sequences; 0 = in this one, None = one a core."""

    def __post_init__(self) -> None:
        if self.output == Path():
            raise ValueError("output is empty or the working folder; name a folder for the training alone.")
        least = {"sheets": 1, "steps": LEAST_STEPS, "seed": 0, "workers": 0}
        require_between(self, **{name: (low, LARGEST_NUMBER) for name, low in least.items()})


class Disturbed:
    """Draws batches of sequences, disturbed anew.

    Args:
        draws: sequences.
        seed: another seed gives other disturbances.
    """

    def __init__(self, draws: LightDraws, seed: int) -> None:
        self.draws, self._generator = draws, np.random.default_rng([seed, 23])
        self._factors = np.stack(list(noise_factors()))
        box = BOUNDS.log_box
        self._logs = np.clip(draws.logs, box[0], box[1])

    def __call__(self, count: int) -> tuple[Tensor, Tensor]:
        """Vectors [count, LIGHT_FEATURES] and parameters [count, 3]."""
        generator = self._generator
        some = generator.integers(len(self._logs), size=count)
        slots = self.draws.slots.chosen(some)
        spread = generator.integers(len(self._factors), size=count)
        sd = np.exp(generator.uniform(*np.log(ERRORS), count))
        errors = np.einsum("bij,btj->bti", self._factors[spread], generator.standard_normal((count, SLOTS, SHAPES)))
        kept = np.where(spread > 0, generator.choice(PERSISTENCE, count), 0.0)[:, None]
        for slot in range(1, SLOTS):
            errors[:, slot] = kept * errors[:, slot - 1] + np.sqrt(1 - kept**2) * errors[:, slot]
        amounts = turned(slots.amounts, generator.uniform(0, 2 * np.pi, count), generator.random(count) < 0.5)
        left = np.hypot(slots.left, sd[:, None])
        slots = dataclasses.replace(slots, amounts=amounts + sd[:, None, None] * errors, left=left)
        known = np.where(generator.random(count) < 0.5, SLOTS, generator.integers(FEWEST_SLOTS, SLOTS + 1, count))
        return torch.from_numpy(slots.vectors(known)), torch.from_numpy(self._logs[some].astype(np.float32))


def new_light_posterior() -> ContactPosterior:
    """The untrained posterior of a contact's brightness sequence."""
    return ContactPosterior(LIGHT_FEATURES, torch.tensor(BOUNDS.log_box), WIDTH, BLOCKS)


def light_loss(posterior: ContactPosterior, batch: tuple[Tensor, Tensor]) -> Tensor:
    """`density_loss` of a batch, a scalar."""
    vectors, logs = batch
    return density_loss(*posterior(vectors), logs)


def train_light(options: LightSettings) -> None:
    """Train and save.

    Raises:
        OSError: the output folder can't be written, or a user's file is in the way.
        TrainingError: no press could be drawn.
        WorkerLost: a worker process was killed.
    """
    options.output.mkdir(parents=True, exist_ok=True)
    start = time.time()
    require_own(options.output / WEIGHTS, options.output / DRAWN)
    with progress_bars(Console()) as progress:
        by = made_by(options, "sheets", "seed")
        kept = read_kept(options.output / DRAWN, by)
        if kept is not None:
            logs = kept[0].pop("logs")
            draws = LightDraws(LightSlots(**kept[0]), logs)
        else:
            seeds = np.random.SeedSequence((options.seed, 0x11)).generate_state(options.sheets).tolist()
            drawn = run_tasks(draw_light, seeds, options.workers, ordered=True)
            parts = [part for part in progress.track(drawn, len(seeds), description="sheets") if part is not None]
            if not parts:
                raise TrainingError("No press could be drawn; give more --light.sheets or another --light.seed.")
            draws = LightDraws.joined(parts)
            keep(options.output / DRAWN, by, vars(draws.slots) | {"logs": draws.logs})
        torch.manual_seed(options.seed)
        held_out = len(draws.logs) // HELD_OUT
        batches = Disturbed(draws.chosen(slice(held_out, None)), options.seed)
        posterior = new_light_posterior()
        posterior.standardise(torch.cat([batches(BATCH)[0] for _ in range(8)]), least=LEAST_SCALE)
        losses = descend(posterior, lambda _: light_loss(posterior, batches(BATCH)), options.steps, RATE, DECAY)
        for _ in progress.track(losses, options.steps, description="light"):
            pass
    print(f"{len(draws.logs)} sequences; {_held_out(posterior.eval(), draws.chosen(slice(held_out)))}")
    with replacing_own(options.output / WEIGHTS) as weights:
        torch.save(posterior.state_dict(), weights)
    (options.output / DRAWN).unlink(missing_ok=True)
    print(f"{options.output}/{WEIGHTS} written after {(time.time() - start) / 3600:.2f} h")


@torch.no_grad()
def _held_out(posterior: ContactPosterior, draws: LightDraws) -> str:
    """Median errors of whole sequences that were not trained on, and how often 90 % intervals hold."""
    vectors = torch.from_numpy(draws.slots.vectors(np.full(len(draws.logs), SLOTS)))
    mean, factor = (values.double().numpy() for values in posterior(vectors))
    said = []
    for name in REPORTED:
        powers = np.array(COMBINATIONS[name])
        errors, sds = np.abs((mean - draws.logs) @ powers), np.linalg.norm(powers @ factor, axis=1)
        said.append(f"{SYMBOLS[name]} {np.median(errors):.2f} ({np.mean(errors <= NINETY * sds):.0%} held)")
    return "median errors " + ", ".join(said)
