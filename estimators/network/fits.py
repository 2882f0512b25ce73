"""Observed contact motions with what explains them: the material of the posterior's fine training stage.

Every motion is explained once by least squares; around that fit its likelihood is a known parabola, whatever noise,
rounding or cut-off window is drawn on top.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from operator import itemgetter

import numpy as np

from data.contact.features import SLOTS, contact_surroundings, join_features, slot_times
from data.contact.interaction import Interaction
from data.synthetic.settings import SceneSettings
from estimators.direct.problem import ContactProblem, find_optimum
from physics.mechanics import RECOMMENDED, Mechanics

MECHANICS = Mechanics(scheme="dkd", window_error=1e-4)
"""The fitted simulator."""
BOUNDS = RECOMMENDED
"""Admissible box, the prior."""
NOISE = (3e-4, 6e-3)
"""σ is drawn log-uniformly from this range [scene units]."""
ROUNDING_SHARE, LEVEL = 0.25, 1 / 255
"""Share of samples whose depth is rounded instead, as 8 bits do, and the rounding's step [scene units]."""
REST_SHARE = 0.1
"""Error of the rest position, in σ: the rest surface is an average of many depths (`benchmarks.tracking_errors`)."""
CUT_SHARE = 0.3
"""Share of samples that are cut off before the second is over, as live frames see them."""
SCENES = SceneSettings(width=214, height=120)
"""What contacts are drawn from."""
EXPLAINED = 2e-4
"""A fit explains a motion without noise where its RMS residual is below this [scene units]."""
NOMINAL = 1e-3
"""σ in which residuals of motions without noise are counted [scene units]."""


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

    @classmethod
    def of(cls, contacts: Sequence[Interaction], logs: Sequence[np.ndarray], slopes: Sequence[np.ndarray]) -> Fits:
        """Contacts without noise, with φ [3] of each and the slopes [SLOTS, 3] there."""
        slots, surroundings = slot_times() + 1e-9, [contact_surroundings(contact) for contact in contacts]
        return cls(
            motion=np.stack([-(contact.moved @ contact.direction) for contact in contacts]).astype(np.float64),
            logs=np.stack(logs),
            slopes=np.stack(slopes),
            loaded=np.stack([slots <= contact.load_seconds + 2e-9 for contact in contacts]) * 1.0,
            around=np.stack([item.vector for item in surroundings]),
            spacing=np.array([item.spacing for item in surroundings]),
        )


def observed_exactly(contact: Interaction) -> ContactProblem:
    """The problem of explaining a motion without noise."""
    return ContactProblem(contact, MECHANICS, NOMINAL)


def motion_slopes(problem: ContactProblem, logs: np.ndarray) -> np.ndarray:
    """Derivatives by φ of the motion against the force's direction, at φ [3], shape [SLOTS, 3] [scene units]."""
    jacobian = NOMINAL * problem.jacobian(logs).reshape(-1, 3, 3)
    return -np.einsum("tdp,d->tp", jacobian, problem.direction)


def fit_motion(task: tuple[Interaction, np.ndarray]) -> tuple[np.ndarray, np.ndarray, float]:
    """φ [3] that explains a motion, its slopes along the force [SLOTS, 3], and the RMS residual [scene units].

    Args:
        task: the contact without noise, and where to start.
    """
    contact, start = task
    low, high = BOUNDS.log_box
    problem = observed_exactly(contact)

    def fitted(begin: np.ndarray) -> tuple[float, np.ndarray]:
        end = find_optimum(problem, begin, low, high)
        return NOMINAL * math.sqrt(2 * end.cost / len(contact.observation)), end.logs

    rms, best = fitted(np.clip(start, low + 1e-3, high - 1e-3))
    for begin in problem.starts(low, high) if rms > EXPLAINED else ():
        rms, best = min((rms, best), fitted(begin), key=itemgetter(0))
        if rms <= EXPLAINED:
            break
    return best, motion_slopes(problem, best), rms


def draw_errors(motion: np.ndarray, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Errors of observed motions, shape [B, SLOTS], and the noise level that each is said to have, [B] [scene units].

    A part of the samples is rounded like 8-bit depth, the others have Gaussian noise. The rest position has an error of
    its own: it is no depth that was rounded once, but comes from a surface through many.
    """
    count = len(motion)
    noise = np.exp(generator.uniform(*np.log(NOISE), size=count))
    rounded = generator.random(count) < ROUNDING_SHARE
    noise[rounded] = LEVEL / math.sqrt(12)
    error = noise[:, None] * generator.normal(size=motion.shape)
    depth = motion + generator.uniform(0, LEVEL, (count, 1))
    error[rounded] = (np.rint(depth / LEVEL) * LEVEL - depth)[rounded]
    return error + noise[:, None] * REST_SHARE * generator.normal(size=(count, 1)), noise


def draw_known(count: int, generator: np.random.Generator) -> np.ndarray:
    """Which slots are seen, shape [count, SLOTS]: all, or the first few."""
    last = np.where(generator.random(count) < CUT_SHARE, generator.integers(2, SLOTS + 1, count), SLOTS)
    return (np.arange(SLOTS) < last[:, None]).astype(np.float64)


@dataclasses.dataclass(frozen=True)
class Drawn:
    """Contacts as they might have been observed, with their likelihood's parabola; B samples."""

    features: np.ndarray
    """What is told of them, shape [B, FEATURES], float32."""
    logs: np.ndarray
    """φ that explains each motion without its errors, shape [B, 3]."""
    information: np.ndarray
    """Fisher information of what was seen, shape [B, 3, 3]."""
    pull: np.ndarray
    """Σ slopes·error/σ² of what was seen, shape [B, 3]: the errors move the likelihood's optimum by its share."""


def draw_observed(
    fits: Fits,
    count: int,
    generator: np.random.Generator,
    seen: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Drawn:
    """Contacts of the fits with new errors.

    Args:
        fits: to draw from.
        count: samples, B.
        generator: draws contacts, errors and what is seen.
        seen: from the slots under load to those that are seen, shapes [B, SLOTS]; none = `draw_known`.
    """
    index = generator.integers(len(fits.logs), size=count)
    motion, loaded, spacing = fits.motion[index], fits.loaded[index], fits.spacing[index]
    error, noise = draw_errors(motion, generator)
    known = draw_known(count, generator) if seen is None else seen(loaded)
    along = (motion + error) / spacing[:, None]
    slopes = fits.slopes[index] * (known / noise[:, None])[..., None]
    return Drawn(
        features=join_features(along, known, loaded * known, fits.around[index], spacing, noise),
        logs=fits.logs[index],
        information=np.einsum("btp,btq->bpq", slopes, slopes),
        pull=np.einsum("btp,bt->bp", slopes, error * known / noise[:, None]),
    )
