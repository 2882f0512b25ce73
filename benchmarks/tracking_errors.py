"""What the constants of `estimators.direct.error_model` claim of tracked contacts, measured where truth is known.

    python -m benchmarks.tracking_errors [--clips 80]

Synthetic clips of the validation split, each in the suites `clean`, `8bit` and `noisy`. An error is the observed minus
the simulated displacement at the true θ, on the mesh and under the load that were observed, wrong as they may be. It
counts in units of the σ that the clip was told to have. After ± stands the standard error over clips (jackknife).
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.optimize import curve_fit
from scipy.special import ndtr

from data.contact.interaction import Interaction
from data.synthetic.clip import draw_truth, synthetic_clip
from data.synthetic.scene import Scene, SceneError
from data.synthetic.source import open_synthetic
from data.synthetic.truth import Motion
from estimators.contract import ClipInfo
from estimators.direct import error_model as noise
from estimators.direct.error_model import BLUR, REST, STEP, TRACKING, sawtooth
from estimators.worker_pool import WorkerLost, run_tasks
from evaluation.recovery.evaluate import MECHANICS, PREPARE, observed_contacts
from evaluation.recovery.suites import SUITES, suite_clip_seed
from physics.likelihood import Likelihood

NAMES = ("clean", "8bit", "noisy")
"""Suites, which observe the same truth; the noise of `clean` and `noisy` differs in its size alone."""
SPLIT, SEED = "validation", 777
LEAST = 3
"""Clips without which there is no standard error."""
PARTS = (0, 0.06, 0.15, 0.3, 0.5, 0.7, 1)
"""Ends of the bins of u, by which part of a rounding step two depths differ beyond whole steps."""
WHOLE = range(11)
"""Whole rounding steps between two depths, each with half a step on either side."""
BLURS = (0.04, 0.08, 0.12, 0.16, 0.2)
EDGE = math.hypot(BLUR, REST)
"""Standard deviation of where the end of a step lies for one error [σ]."""
BEYOND = STEP / 2 + EDGE * np.arange(-1, 5)
"""Sizes of errors around half a step, beyond which rounding doesn't reach [σ]."""
VARIANCE = 1 + TRACKING**2 + REST**2
"""Of an error, as it is assumed [σ²]."""
Row = tuple[str, np.ndarray | tuple[float, float], float, str]
"""What it is, its measured value and standard error, what is assumed (not a number: nothing), a remark."""


@dataclass(frozen=True)
class ClipErrors:
    """Errors of one tracked contact."""

    along: np.ndarray
    """Along the force, which is the line of sight within a degree, shape [M] [σ]."""
    across: np.ndarray
    """Along two axes perpendicular to it, shape [M, 2] [σ]."""
    simulated: np.ndarray
    """True motion along the force, shape [M] [σ]."""
    frames: np.ndarray
    """Frames since the onset, shape [M], int."""
    rest: float
    """Error of the rest position along the force [σ]."""
    sigma: float
    """Told over true σ."""


def measure_clip(task: tuple[int, int]) -> dict[str, ClipErrors]:
    """Errors of the clip of an index and a seed by suite, less suites where its contact was not found at its onset."""
    index, seed = task
    try:
        scene, motion = draw_truth(SUITES[NAMES[0]].settings(index), seed)
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


def compare(contact: Interaction, scene: Scene, motion: Motion) -> ClipErrors:
    """Errors of a contact that was observed from its true onset on."""
    settings, direction, noise = scene.settings, contact.direction.astype(np.float64), contact.noise
    likelihood = Likelihood(contact.mesh, contact.load, contact.observation, MECHANICS)
    logs = np.log(np.abs(motion.theta))
    simulated = likelihood.simulated(logs).reshape(-1, 3)
    errors = -likelihood.residual(logs).reshape(-1, 3)
    # Vertices of both meshes are pixels of one grid and the camera stands still, so one pixel is one piece of tissue.
    same = (scene.mesh.pixels == contact.mesh.pixels[contact.vertex]).all(axis=1)
    rest = contact.mesh.vertices[contact.vertex] - scene.mesh.vertices[np.flatnonzero(same)[0]]
    return ClipErrors(
        along=errors @ direction,
        across=errors @ np.linalg.svd(direction[None])[2][1:].T,
        simulated=simulated @ direction / noise,
        frames=np.rint(contact.observation.times * settings.fps).astype(int),
        rest=float(rest @ direction / noise),
        sigma=noise / (1 / 255 / STEP if settings.depth_bits == 8 else settings.depth_noise),
    )


def jackknife(statistic: Callable[[Sequence[Any]], Any], clips: Sequence[Any]) -> np.ndarray:
    """A statistic of clips beside its standard error, shape [2], or [n, 2] for n statistics."""
    without = np.array([statistic([*clips[:index], *clips[index + 1 :]]) for index in range(len(clips))])
    return np.stack([statistic(clips), np.sqrt((len(clips) - 1) * without.var(axis=0))], axis=-1)


def spread(errors: Sequence[np.ndarray]) -> float:
    """Standard deviation of errors [M] or [M, axes] within clips, which count alike."""
    return math.sqrt(np.mean([each.var(axis=0, ddof=1).mean() for each in errors]))


def common_variance(clips: Sequence[ClipErrors], rounded: bool) -> float:
    """Variance over clips of the error that all frames share [σ²]; chance can make it negative.

    Less what independent errors, or those of rounding, leave in the mean over a clip's frames.
    """
    left = [clip.along.var(ddof=1) / len(clip.along) for clip in clips]
    if rounded:
        left = [sawtooth((clip.simulated[:, None] - clip.simulated) / STEP).mean() for clip in clips]
    return float(np.var([clip.along.mean() for clip in clips], ddof=1) - np.mean(left))


def frame_pairs(clip: ClipErrors) -> np.ndarray:
    """All pairs of frames of a clip: frames and rounding steps between them, and both errors [σ], shape [4, P]."""
    one, other = np.triu_indices(len(clip.along), 1)
    steps = np.abs(clip.simulated[other] - clip.simulated[one]) / STEP
    return np.stack([clip.frames[other] - clip.frames[one], steps, clip.along[one], clip.along[other]])


def of_pairs(statistic: Callable[[np.ndarray], Any], clips: Sequence[ClipErrors]) -> np.ndarray:
    """A statistic of the pairs [4, P] of all clips beside its standard error over clips."""
    return jackknife(lambda some: statistic(np.concatenate(some, axis=1)), [frame_pairs(clip) for clip in clips])


def correlation(pairs: np.ndarray) -> float:
    """Correlation, around 0, of the errors of pairs [4, P]; not a number where there are none."""
    one, other = pairs[2:]
    return float(one @ other / math.sqrt((one @ one) * (other @ other))) if len(one) else math.nan


def part_bins(pairs: np.ndarray) -> list[np.ndarray]:
    """Pairs of consecutive frames in each bin of PARTS, shape [4, P] each."""
    bins = np.digitize(pairs[1] % 1, PARTS) - 1
    return [pairs[:, (pairs[0] == 1) & (bins == place)] for place in range(len(PARTS) - 1)]


def amplitudes(pairs: np.ndarray) -> list[float]:
    """Covariance of the errors of pairs [4, P] as a multiple of the sawtooth [σ²], for each of WHOLE."""
    theory, products = sawtooth(pairs[1]), pairs[2] * pairs[3]
    near = [np.abs(pairs[1] - whole) <= 0.5 for whole in WHOLE]
    return [products[some] @ theory[some] / (theory[some] @ theory[some]) if some.any() else math.nan for some in near]


def fitted_fall(pairs: np.ndarray) -> tuple[float, float]:
    """INDEPENDENT and REACH that fit the products of the errors of pairs [4, P] best."""
    (share, fall), _ = curve_fit(
        lambda steps, share, fall: share * sawtooth(steps) * np.exp(-0.5 * np.square(fall * steps)),
        pairs[1], pairs[2] * pairs[3], (0.8, 0.3), bounds=(0, math.inf),
    )  # fmt: skip
    return 1 - share, 1 / max(fall, 1e-3)


def assumed_covariance(steps: np.ndarray) -> np.ndarray:
    """Covariance that is assumed of rounding errors whose depths differ by steps [P], shape [P] [σ²]."""
    return noise.rounding_covariance(STEP * np.stack([np.zeros_like(steps), steps], axis=1))[:, 0, 1]


def shares_beyond(clips: Sequence[ClipErrors]) -> np.ndarray:
    """Share of the errors that are larger than each of BEYOND."""
    return (np.abs(np.concatenate([clip.along for clip in clips]))[:, None] > BEYOND).mean(axis=0)


def assumed_beyond() -> np.ndarray:
    """The same as it is assumed."""
    even = STEP * ((np.arange(1000) + 0.5) / 1000 - 0.5)
    blurred = 2 * ndtr((even - BEYOND[:, None]) / EDGE).mean(axis=1)
    return (1 - noise.ASTRAY) * blurred + noise.ASTRAY * 2 * ndtr(-BEYOND / noise.WANDER)


def log_density(clip: ClipErrors, blur: float) -> float:
    """Log-density of bounded errors at the true motion, were BLUR so large."""
    return float(noise.bounded_log_density(clip.along[None], blur)[0])


def rounding_evidence(clip: ClipErrors) -> float:
    """Log evidence of the true motion for rounded against noisy depth, without the odds before."""
    noisy, alike = noise.log_likelihoods(clip.simulated + clip.along, clip.simulated[None])[1][0]
    return float(alike - noisy - math.log(noise.ROUNDED_ODDS))


def noise_rows(clips: Sequence[ClipErrors], rounded: bool) -> Iterator[Row]:
    """Table of one suite."""

    def over_clips(statistic: Callable[..., Any], name: str) -> np.ndarray:
        return jackknife(lambda some: statistic([getattr(clip, name) for clip in some]), clips)

    yield "told over true σ", over_clips(np.mean, "sigma"), 1, ""
    yield "its spread", over_clips(np.std, "sigma"), math.sqrt(0.5 / noise.SIGMA_FREEDOM), "√(0.5/SIGMA_FREEDOM)"
    along = math.nan if rounded else math.hypot(1, TRACKING)
    yield "spread along the force", over_clips(spread, "along"), along, "" if rounded else "√(1 + TRACKING²)"
    yield "spread across it", over_clips(spread, "across"), math.nan, ""
    yield "rest position against the true mesh", over_clips(np.std, "rest"), REST, "REST"
    common = jackknife(lambda some: common_variance(some, rounded), clips)
    yield "variance that all frames share", common, REST**2, "REST²"
    lags = of_pairs(lambda pairs: [correlation(pairs[:, pairs[0] == lag]) for lag in (1, 2, 3, 4)], clips)
    for lag, found in enumerate(lags, 1):
        yield f"correlation, lag {lag}", found, math.nan if rounded else REST**2 / VARIANCE, ""
    evidence = [rounding_evidence(clip) for clip in clips]
    for percent in (5, 50, 95):
        remark = f"odds before: {math.log(noise.ROUNDED_ODDS):.1f}"
        yield f"log evidence for rounding, {percent} %", (np.percentile(evidence, percent), math.nan), math.nan, remark


def rounding_rows(clips: Sequence[ClipErrors]) -> Iterator[Row]:
    """Table of how the errors of `8bit` correlate."""
    pairs = np.concatenate([frame_pairs(clip) for clip in clips], axis=1)
    parts = of_pairs(lambda pairs: [correlation(some) for some in part_bins(pairs)], clips)
    for some, found in zip(part_bins(pairs), parts, strict=True):
        if some.size:
            u, assumed = np.mean(some[1] % 1), (assumed_covariance(some[1]).mean() + REST**2) / VARIANCE
            remark = f"1 - 6u(1 - u) = {sawtooth(u):.3f}, {some.shape[1]} pairs"
            yield f"correlation of consecutive frames, u = {u:.2f}", found, assumed, remark
    assumed = amplitudes(np.stack([*pairs[:2], assumed_covariance(pairs[1]), np.ones_like(pairs[1])]))
    for whole, *row in zip(WHOLE, of_pairs(amplitudes, clips), assumed, strict=True):
        yield f"covariance over 1 - 6u(1 - u), {whole} steps apart", *row, "all pairs of frames, σ²"  # ty: ignore[invalid-yield]  two each
    independent, reach = of_pairs(fitted_fall, clips)
    yield "independent share that fits best", independent, noise.INDEPENDENT, "INDEPENDENT"
    yield "reach that fits best, steps", reach, noise.REACH, "REACH"


def bound_rows(clips: Sequence[ClipErrors]) -> Iterator[Row]:
    """Table of how far the errors of `8bit` lie outside a step, and how likely they are with BLURS."""
    shares = jackknife(shares_beyond, clips)
    for place, end, *row in zip(range(-1, 5), BEYOND, 100 * shares, 100 * assumed_beyond(), strict=True):
        yield f"errors beyond {end:.2f} σ, %", *row, f"half a step {place:+d} · √(BLUR² + REST²)"
    astray = 100 * shares[-1] / (2 * ndtr(-BEYOND[-1] / noise.WANDER))
    remark = f"ASTRAY, of {sum(len(clip.along) for clip in clips)} errors"
    yield "errors astray by the last, %", astray, 100 * noise.ASTRAY, remark
    densities = np.array([[log_density(clip, blur) for clip in clips] for blur in (BLUR, *BLURS)])
    for blur, found in zip(BLURS, densities[1:], strict=True):
        gain, error = jackknife(np.mean, found - densities[0])
        remark = f"{gain:+.3f} ± {error:.3f} over BLUR {BLUR}"
        yield f"log-density of a clip, blur {blur}", jackknife(np.mean, found), math.nan, remark


def show(title: str, rows: Iterator[Row], console: Console) -> None:
    """Print a table."""
    table = Table("", "measured", "assumed", "", title=title)
    for what, (value, error), assumed, remark in rows:
        figure = "–" if math.isnan(value) else f"{value:.3f}" + (f" ± {error:.3f}" if error > 0 else "")
        table.add_row(what, figure, "" if math.isnan(assumed) else f"{assumed:.3f}", remark)
    console.print(table)


def main(arguments: list[str] | None = None) -> int:
    """Measure and print the tables; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=80, help="clips of each suite (default %(default)s)")
    options = parser.parse_args(arguments)
    if options.clips < LEAST:
        parser.error(f"--clips takes {LEAST} or more.")
    messages, console = Console(stderr=True), Console(width=130)
    found: dict[str, list[ClipErrors]] = {name: [] for name in NAMES}
    tasks = [(index, suite_clip_seed(SPLIT, SEED, index)) for index in range(options.clips)]
    try:
        for errors in track(run_tasks(measure_clip, tasks, None), "clips", len(tasks), console=messages):
            for name, each in errors.items():
                found[name].append(each)
    except WorkerLost as error:
        messages.print(str(error), style="red")
        return 1
    if min(map(len, found.values())) < LEAST:
        messages.print("Too few contacts were found; give more --clips.", style="red")
        return 1
    for name, clips in found.items():
        show(f"{name}: {len(clips)} of {options.clips} clips, errors in σ", noise_rows(clips, name == "8bit"), console)
    show("8bit: how rounding errors of two frames belong together", rounding_rows(found["8bit"]), console)
    show("8bit: bounded errors at the true motion", bound_rows(found["8bit"]), console)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
