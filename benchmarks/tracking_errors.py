"""What the constants of `estimators.direct.error_model` claim of tracked contacts, measured where truth is known.

    python -m benchmarks.tracking_errors

Synthetic clips of the validation split, each in the suites `clean`, `8bit` and `noisy`. An error is the observed minus
the simulated displacement at the true θ, on the mesh and under the load that were observed, wrong as they may be. It
counts in units of the σ that was stated for the clip.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from rich.progress import track

from palpate.benchmarks.shared import command_line, machine, print_table
from palpate.common.workers import run_tasks
from palpate.data.contact.interaction import Interaction
from palpate.data.synthetic.clip import draw_press, synthetic_clip
from palpate.data.synthetic.scene import Scene, SceneError
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.data.synthetic.truth import PressedMotion
from palpate.estimators.contract import ClipInfo
from palpate.estimators.direct import error_model
from palpate.estimators.direct.error_model import STEP, sawtooth
from palpate.evaluation.recovery.bounds import MECHANICS
from palpate.evaluation.recovery.suites import SUITES, suite_clip_seed
from palpate.evaluation.recovery.trial import observed_contacts
from palpate.physics.likelihood import Likelihood

NAMES = ("clean", "8bit", "noisy")
"""Suites, which observe the same truth; the noise of `clean` and `noisy` differs in its size alone."""
CLIPS, SEED = 240, 777
FRAMES = 25
"""Of a motion: a second."""
PARTS = (0, 0.06, 0.15, 0.3, 0.5, 0.7, 1)
"""Ends of the bins of u, by which part of a rounding step two depths differ beyond whole steps."""


class ClipErrors(NamedTuple):
    """Errors of one tracked contact; F frames since its onset, NaN where the tissue was not followed."""

    along: np.ndarray
    """Along the force, which is the line of sight within a degree, shape [F] [σ]."""
    across: np.ndarray
    """Along two axes perpendicular to it, shape [F, 2] [σ]."""
    simulated: np.ndarray
    """True motion along the force, shape [F] [σ]."""
    rest: np.ndarray | float
    """Error of the rest position along the force [σ]."""
    sigma: np.ndarray | float
    """Told over true σ."""


def measure_clip(task: tuple[int, int]) -> dict[str, ClipErrors]:
    """Errors of the clip of an index and a seed by suite, less suites where its contact was not found at its onset."""
    index, seed = task
    try:
        scene, motion = draw_press(SUITES[NAMES[0]].settings(index), seed)
    except SceneError:
        return {}
    found = {}
    for name in NAMES:
        observed = dataclasses.replace(scene, settings=SUITES[name].settings(index))
        clip = open_synthetic(synthetic_clip(observed, motion, seed), PREPARE)
        contacts = observed_contacts(list(clip), ClipInfo.of(clip))
        if motion.onset_frame in contacts:
            found[name] = compare(contacts[motion.onset_frame], observed, motion)
    return found


def stacked(clips: Sequence[ClipErrors]) -> ClipErrors:
    """Errors of many contacts, with an axis of clips in front."""
    return ClipErrors(*map(np.stack, zip(*clips, strict=True)))


def compare(contact: Interaction, scene: Scene, motion: PressedMotion) -> ClipErrors:
    """Errors of a contact that was observed from its true onset on."""
    settings, direction, noise = scene.settings, contact.direction.astype(np.float64), contact.noise
    likelihood = Likelihood(contact.mesh, contact.load, contact.observation, MECHANICS)
    logs = np.log(np.abs(motion.theta))
    errors, simulated = np.full((2, FRAMES, 3), np.nan)
    frames = np.rint(contact.observation.times * settings.fps).astype(int) - 1
    errors[frames] = -likelihood.residual(logs).reshape(-1, 3)
    simulated[frames] = likelihood.simulated(logs).reshape(-1, 3) / noise
    # Vertices of both meshes are pixels of one grid and the camera stands still, so one pixel is one piece of tissue.
    same = (scene.mesh.pixels == contact.mesh.pixels[contact.vertex]).all(axis=1)
    rest = contact.mesh.vertices[contact.vertex] - scene.mesh.vertices[np.flatnonzero(same)[0]]
    return ClipErrors(
        along=errors @ direction,
        across=errors @ np.linalg.svd(direction[None])[2][1:].T,
        simulated=simulated @ direction,
        rest=float(rest @ direction / noise),
        sigma=noise / (1 / 255 / STEP if settings.depth_bits == 8 else settings.depth_noise),
    )


def spread(errors: np.ndarray) -> float:
    """Standard deviation of errors [clips, F, …] within clips, each of which counts the same."""
    return float(np.sqrt(np.nanvar(errors, axis=1, ddof=1).mean()))


def correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Correlation, around 0, of errors of one shape."""
    both = np.isfinite(one * other)
    return float(one[both] @ other[both] / math.sqrt(np.square(one[both]).sum() * np.square(other[both]).sum()))


def rounding_evidence(along: np.ndarray, simulated: np.ndarray) -> float:
    """Log evidence of one true motion for rounded against noisy depth, without the odds before."""
    along, simulated = along[np.isfinite(along)], simulated[np.isfinite(along)]
    noisy, rounded = error_model.log_likelihoods(simulated + along, simulated[None])[1][0]
    return float(rounded - noisy - math.log(error_model.ROUNDED_ODDS))


def statistics(errors: ClipErrors) -> dict[str, float]:
    """What is printed of one suite; every field has an axis of clips in front."""
    along = errors.along
    evidence = [rounding_evidence(*each) for each in zip(along, errors.simulated, strict=True)]
    return {
        "contacts": len(along),
        "told over true σ": np.mean(errors.sigma),
        "its spread": np.std(errors.sigma),
        "spread along the force": spread(along),
        "spread across it": spread(errors.across),
        "spread of the rest position's error": np.std(errors.rest),
        **{f"correlation, {lag} frames apart": correlation(along[:, lag:], along[:, :-lag]) for lag in (1, 2, 3, 4)},
        **{f"log evidence for rounding, {share} %": np.percentile(evidence, share) for share in (5, 50, 95)},
    }


def rounding_rows(errors: ClipErrors) -> list[list[str]]:
    """How errors of rounding in consecutive frames correlate, by u, and the theory's."""
    part = np.abs(np.diff(errors.simulated, axis=1)) / STEP % 1
    bins = np.digitize(part, PARTS)
    rows = []
    for some in (bins == place for place in range(1, len(PARTS))):
        u, found = part[some].mean(), correlation(errors.along[:, 1:][some], errors.along[:, :-1][some])
        rows.append([f"{value:.2f}" for value in (u, sawtooth(u), found)])
    return rows


def main() -> None:
    """Measure and print the tables."""
    command_line(__doc__).parse_args()
    tasks = [(index, suite_clip_seed("validation", SEED, index)) for index in range(CLIPS)]
    found = list(track(run_tasks(measure_clip, tasks, None), "clips", CLIPS))
    suites = {name: stacked([errors[name] for errors in found if name in errors]) for name in NAMES}
    columns = [statistics(errors) for errors in suites.values()]
    print(f"{machine()}; errors in σ\n")
    print_table(("", *NAMES), ([name, *(f"{column[name]:.3g}" for column in columns)] for name in columns[0]))
    print("\n8bit, consecutive frames\n")
    print_table(("u", "1 - 6u(1 - u)", "correlation"), rounding_rows(suites["8bit"]))


if __name__ == "__main__":
    run_door(main)
