"""What an observation is worth, and what the system's parts are: the same training without them, row by row.

    python -m evaluation.ablations --output runs/ablations --weights runs/contact/posterior.pt [--rows K=4 final …]
    python -m evaluation.ablations --output runs/terms --clips CLIPS [--rows full no-gan …] [--seeds 3]

With --weights: contact posteriors trained on fewer of the frames after the onset, all equally long. Every row trains a
new network by the `fine` stage of `estimators.network.training` on the same fits; only what is seen of a motion
differs, in the features as in the likelihood. It is judged on held-out contacts with Gaussian noise against the bound
of their whole first second, so that all rows are divided by the same number. Writes what `evaluation.benchmark` writes,
with the row as estimator; finished rows are kept in DIR, and the same command continues.

The row `supervised` has the same network, contacts and steps, but descends the negative log density of the true log θ:
what training without labels could reach at best. Nothing else here trains on a true θ, and nothing is shipped from it.

With --clips, a folder of python -m data.synthetic: generators trained without one term of the loss, the picture or the
carried map (`evaluation.terms`). Writes table.csv, and prints it; trained and judged ones are kept in DIR as well.
"""

from __future__ import annotations

from physics.doors import INTERRUPTED, enter_door, interruptible, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
from dataclasses import dataclass

import numpy as np
import torch
from rich.console import Console

from data.command_line import path_option, progress_bars, say, whole_number
from data.contact.features import FEATURES, SLOTS, join_features
from data.contact.interaction import CONTACT
from data.synthetic.contacts import SimulatedContact
from data.synthetic.truth import damping_ratio, regime_of
from estimators.network.draws import Drawn, draw_observed
from estimators.network.fits import BOUNDS, MECHANICS, Fits, motion_slopes, observed_exactly
from estimators.network.training import (
    FINE_BATCH,
    FINE_RATE,
    LEAST_STEPS,
    Trainer,
    TrainingError,
    descend,
    fine_loss,
    make_contacts,
)
from estimators.worker_pool import WorkerLost
from evaluation import terms
from evaluation.recovery.evaluate import Recovery
from evaluation.recovery.output import finish
from evaluation.recovery.scores import Bound
from evaluation.recovery.store import RecoveryStore, replace_text
from evaluation.recovery.suites import CLEAN_NOISE
from evaluation.tables import to_cell, to_csv, to_markdown
from models.checkpoint import CheckpointError, load_posterior
from models.posterior import ContactPosterior
from physics.identifiability import fisher_information
from physics.mechanics import theta_of
from results.record import sha256_of
from results.store import OutputError

SUITE = "held-out"
"""In the column of suites: simulated contacts that no row is trained on."""
SUPERVISED = "supervised"
"""The row that is told the truth."""
ROWS = {
    **{f"K={frames}": f"the first {frames} after the onset" for frames in (1, 2, 4, 8, 16, SLOTS)},
    "release": "only the frame at the end of the load",
    "final": "only the last frame of the second",
    SUPERVISED: f"as K={SLOTS}, but told the true θ of its simulated contacts: an upper bound",
}
"""Rows in the order of tables, and the frames that each sees."""
EXAMPLES = 4000
"""Samples that the inputs' centre and scale are taken from."""
LEAST_SPREAD = 0.3
"""An input that hardly varies in a row, such as a slot that is never seen, is not blown up."""


def seen_slots(row: str, loaded: np.ndarray) -> np.ndarray:
    """What a row sees.

    Args:
        row: one of ROWS.
        loaded: whether a slot is under load, shape [B, SLOTS].

    Returns:
        Shape [B, SLOTS], 1 where seen, else 0.
    """
    slots = np.arange(SLOTS)
    if row == "release":
        # A press shorter than a frame has its first slot.
        return (slots == np.maximum(loaded.sum(axis=1, keepdims=True) - 1, 0)).astype(np.float64)
    count = int(row.removeprefix("K=")) if row.startswith("K=") else SLOTS
    seen = slots == SLOTS - 1 if row == "final" else slots < count
    return np.broadcast_to(seen, loaded.shape).astype(np.float64)


@dataclass(frozen=True)
class Material:
    """What all rows are trained and judged on."""

    fits: Fits
    """Training contacts around what explains them."""
    labelled: Fits
    """The same, and those that nothing explains, around their truth: the row `supervised` alone reads them."""
    held_out: Fits
    """Other contacts, around their truth: evaluation alone reads them."""


def make_material(options: argparse.Namespace, console: Console) -> Material:
    """The same for the same options.

    Raises:
        CheckpointError: the weights can't be used.
        TrainingError: there is nothing to train on.
        WorkerLost: a process was killed.
    """
    with progress_bars(console) as progress:
        drawn = make_contacts(options.contacts, options.seed, progress, options.workers)
        trainer = Trainer(drawn, options.seed)
        load_posterior(trainer.posterior, options.weights)
        fits = trainer.fit(progress, options.workers)
        held_out = make_contacts(options.held_out, options.seed + 1, progress, options.workers)
        return Material(fits, around_truth(drawn), around_truth(held_out))


def around_truth(contacts: list[SimulatedContact]) -> Fits:
    """Contacts with their true φ, and the motion's slopes there."""
    seen = [contact.interaction for contact in contacts]
    logs = [np.log(np.abs(contact.theta)) for contact in contacts]
    slopes = [motion_slopes(observed_exactly(contact), at) for contact, at in zip(seen, logs, strict=True)]
    return Fits.of(seen, logs, slopes)


def train_row(row: str, material: Material, steps: int, seed: int) -> ContactPosterior:
    """A posterior trained on what a row sees."""
    fits, loss_of = (material.labelled, label_loss) if row == SUPERVISED else (material.fits, fine_loss)
    torch.manual_seed(seed)
    generator = np.random.default_rng([seed, 23])
    posterior = ContactPosterior(FEATURES, torch.tensor(BOUNDS.log_box))

    def draw(count: int) -> Drawn:
        return draw_observed(fits, count, generator, lambda loaded: seen_slots(row, loaded))

    posterior.standardise(torch.from_numpy(draw(EXAMPLES).features), least=LEAST_SPREAD)
    for _ in descend(posterior, lambda _: loss_of(posterior, draw(FINE_BATCH)), steps, FINE_RATE):
        pass
    return posterior.eval()


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
def judge(posterior: ContactPosterior, row: str, held: Fits, seed: int) -> list[Recovery]:
    """A row's estimates of held-out contacts, whose noise is the same in every row, beside the truth."""
    errors = np.random.default_rng([seed, 29]).normal(0, CLEAN_NOISE, held.motion.shape)
    known = seen_slots(row, held.loaded)
    along, noise = (held.motion + errors) / held.spacing[:, None], np.full(len(held.logs), CLEAN_NOISE)
    features = join_features(along, known, held.loaded * known, held.around, held.spacing, noise)
    means, factors = (values.double().numpy() for values in posterior(torch.from_numpy(features)))
    found = []
    for index, (mean, factor, error) in enumerate(zip(means, factors, errors, strict=True)):
        theta = theta_of(held.logs[index])
        found.append(
            Recovery(
                suite=SUITE,
                index=index,
                estimator=row,
                seed=seed,
                regime=regime_of(damping_ratio(theta[0], theta[1], MECHANICS.mass)),
                theta=theta,
                information=np.pad(fisher_information(held.slopes[index], 1.0), (0, 2)),
                tracking=error,
                estimate=theta_of(mean),
                covariance=factor @ factor.T,
                noise=CLEAN_NOISE,
            )
        )
    return found


def measure(left: list[str], options: argparse.Namespace, store: RecoveryStore, console: Console) -> None:
    """Train and judge the rows that are left."""
    if not left:
        return
    material = make_material(options, console)
    for row in left:
        posterior = train_row(row, material, options.steps, options.seed)
        # The first contact comes last: a row that has it was written to its end.
        store.append(reversed(judge(posterior, row, material.held_out, options.seed)))
        say(console, f"{row}: done")


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m evaluation.ablations",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="rows with --weights:\n"
        + "\n".join(f"  {name:20s}{what}" for name, what in ROWS.items())
        + "\n\nrows with --clips:\n"
        + "\n".join(f"  {name:20s}{what}" for name, (what, _) in terms.ROWS.items())
        + "\n\nExit status: 0 done; 1 failed; 2 wrong usage; 130 interrupted.",
    )
    add = parser.add_argument
    text = "posterior.pt of estimators.network.training, from whose estimates the fits begin"
    add("--output", type=path_option, required=True, metavar="DIR", help="folder of the results")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--weights", type=path_option, metavar="FILE", help=text)
    text = "clips with truth that generators are trained on"
    source.add_argument("--clips", type=path_option, metavar="DIR", help=text)
    known = [*ROWS, *terms.ROWS]
    add("--rows", nargs="+", action="extend", choices=known, metavar="ROW", help="rows (default: all there are)")
    numbers = (
        ("workers", 2, 0, "processes that make the contacts; 0 = in this one"),
        ("seed", 0, 0, "another seed gives other contacts, or judged clips"),
        ("contacts", 4000, 1, "simulated contacts to train on, with --weights"),
        ("seeds", 3, 1, "trainings of every row, with --clips"),
    )
    for name, default, least, text in numbers:
        kind = whole_number(least)
        add(f"--{name}", type=kind, default=default, metavar="N", help=f"{text} (default %(default)s)")
    text = "simulated contacts, or clips of each suite, to judge on (default 600, or 15)"
    add("--held-out", type=whole_number(1), metavar="N", help=text)
    text = "steps of every row's training (default 3000, or 50)"
    add("--steps", type=whole_number(LEAST_STEPS), metavar="N", help=text)
    return parser


def compare_terms(options: argparse.Namespace, console: Console) -> int:
    """Train and judge generators, and print what their parts are worth; returns the exit status."""
    found, status = {}, 0
    asked = options.rows, options.seeds, options.clips, options.steps, options.held_out, options.seed, options.output
    try:
        with interruptible():
            for row, seed, judged in terms.measure(*asked):
                found[row, seed] = judged
                say(console, f"{row}, seed {seed}: done")
    except KeyboardInterrupt:
        say(console, "Interrupted; finished rows are kept, and the same command continues.", "yellow")
        status = INTERRUPTED
    except (CheckpointError, OutputError, TrainingError) as error:
        say(console, f"{error} Finished rows are kept.", "red")
        status = 1
    rows = terms.table(found)
    if not rows:
        return status
    print(to_markdown(terms.COLUMNS, [[to_cell(row.get(name), ".3g") for name in terms.COLUMNS] for row in rows]))
    try:
        replace_text(options.output / "table.csv", to_csv(rows, terms.COLUMNS, ".4g"))
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    return status


def main(arguments: list[str] | None = None) -> int:
    """Run the ablations that the command line asks for; returns the exit status."""
    console, parser = Console(stderr=True), build_parser()
    options = parser.parse_args(arguments)
    family, held_out, steps = (ROWS, 600, 3000) if options.clips is None else (terms.ROWS, 15, 50)
    options.held_out, options.steps = options.held_out or held_out, options.steps or steps
    strange = [name for name in options.rows or () if name not in family]
    if strange:
        parser.error(f"{strange[0]} is no row with {'--weights' if options.clips is None else '--clips'}; see --help.")
    options.rows = [name for name in family if options.rows is None or name in options.rows]
    if options.clips is not None:
        if not options.clips.is_dir():
            parser.error(f"{options.clips} is not a folder; give clips of python -m data.synthetic as --clips.")
        return compare_terms(options, console)
    if not options.weights.is_file():
        parser.error(f"{options.weights} is not a file; give posterior.pt of estimators.network.training as --weights.")
    wanted = {name: getattr(options, name) for name in ("seed", "contacts", "held_out", "steps")}
    try:
        store = RecoveryStore(options.output, wanted | {"weights": sha256_of(options.weights)})
    except OutputError as error:
        say(console, str(error), "red")
        return 2
    rows = options.rows
    left = [name for name in rows if (SUITE, 0, name) not in store.done]
    status = 0
    try:
        with interruptible():
            measure(left, options, store, console)
    except KeyboardInterrupt:
        say(console, "Interrupted; finished rows are kept, and the same command continues.", "yellow")
        status = INTERRUPTED
    except (CheckpointError, OutputError, TrainingError, WorkerLost) as error:
        say(console, f"{error} Finished rows are kept.", "red")
        status = 1
    results = [result for result in store.rows if result.estimator in rows]
    return finish(
        sorted(results, key=lambda result: rows.index(result.estimator)),
        options.output,
        console,
        status,
        Bound(CONTACT),
    )


if __name__ == "__main__":
    run_door(main)
