"""Contact motions with the parameters that explain them: the data of the posterior's fine training stage.

Every motion is explained once by least squares. Around that fit its log likelihood is a known parabola, whatever noise,
rounding or window is drawn in addition, so these cost no rollout.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from operator import itemgetter
from typing import NamedTuple, Self

import numpy as np

from palpate.data.contact.features import FRAME_RATE, SLOTS, contact_surroundings, join_features, slot_times
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.sequence_features import (
    ROUNDED,
    SHAPES,
    dent_shapes,
    join_sequence_features,
    motion_in_sequence,
    shape_amounts,
)
from palpate.data.synthetic.contacts import SimulatedContact, draw_contacts
from palpate.data.synthetic.settings import SceneSettings
from palpate.estimators.direct.motion import PressMotion
from palpate.estimators.direct.problem import chosen_starts, dent_problem, find_optimum
from palpate.observations.base import JointLikelihood
from palpate.observations.point import PointObservation
from palpate.physics.depth import smooth_errors
from palpate.physics.mechanics import RECOMMENDED, Mechanics
from palpate.physics.observation import CommonErrors

MECHANICS = Mechanics(scheme="dkd", window_error=1e-4)
"""The simulator of the fits."""
FRAME_S = 1 / FRAME_RATE
"""Largest distance of the press's beginning and end from their time stamps, where they aren't known [s]."""
SCENES = SceneSettings(width=214, height=120)
"""Settings of the scenes from which contacts are drawn."""
EXPLAINED = 2e-4
"""A fit explains a motion without noise where its RMS residual is below this [scene units]."""
PARAMETERS = 5
"""Number of parameters: φ and both delays."""
NOMINAL_NOISE = 1e-3
"""σ by which residuals of motions without noise are divided [scene units]."""


@dataclasses.dataclass(frozen=True)
class DepthSequences:
    """Depth-change sequences without noise of N contacts, P pixels each, as arrays."""

    change: np.ndarray
    """Depth change, shape [N, SLOTS, P], float16 [scene units]; not a number where the tool is."""
    amounts: np.ndarray
    """Amounts of the dent's shapes in the change, shape [N, SLOTS, SHAPES] [scene units]."""
    amount_slopes: np.ndarray
    """Derivatives of the amounts by the parameters, shape [N, SLOTS, SHAPES, D]."""
    factors: np.ndarray
    """Factors of the amounts' error covariances, as `shape_amounts` gives them, shape [N, SLOTS, SHAPES, SHAPES]."""
    middle: np.ndarray
    """The contact's motion in its own pixel, as in `Fits.motion`, shape [N, SLOTS] [scene units]."""


class Fitted(NamedTuple):
    """Parameters that explain one contact; other arrays as in `Fits`, without N."""

    logs: np.ndarray
    slopes: np.ndarray
    rms: float
    """Root mean square residual [scene units]."""
    change: np.ndarray
    amounts: np.ndarray
    amount_slopes: np.ndarray
    factors: np.ndarray
    middle: np.ndarray


@dataclasses.dataclass(frozen=True)
class Fits(DepthSequences):
    """Arrays of N contacts with the PARAMETERS D that explain their motions."""

    motion: np.ndarray
    """Motion against the force's direction at the slots, without noise, shape [N, SLOTS] [scene units]."""
    logs: np.ndarray
    """Parameters that explain the motion, shape [N, D]."""
    slopes: np.ndarray
    """Derivatives of the motion by these parameters at the slots, shape [N, SLOTS, D] [scene units]."""
    loaded: np.ndarray
    """Mask of the slots under load by the time stamps, shape [N, SLOTS]."""
    around: np.ndarray
    """`Surroundings.vector`, shape [N, 40]."""
    spacing: np.ndarray
    """Spacing of the mesh at the contact, shape [N] [scene units]."""
    within: np.ndarray
    """Largest delay of the press's instants, shape [N] [s]; where it is 0 the delays are 0 and have no derivatives."""

    @classmethod
    def of(cls, contacts: Sequence[Interaction], fitted: Sequence[Fitted], within: Sequence[float]) -> Self:
        """Make the arrays from contacts without noise, the fit of each, and the largest delay of its instants [s]."""
        slots, surroundings = slot_times() + 1e-9, [contact_surroundings(contact) for contact in contacts]
        found = {name: np.stack([getattr(fit, name) for fit in fitted]) for name in Fitted._fields if name != "rms"}
        found["motion"] = np.stack([-(contact.moved @ contact.direction) for contact in contacts]).astype(np.float64)
        found["loaded"] = np.stack([slots <= contact.load_seconds + 2e-9 for contact in contacts]) * 1.0
        found["around"] = np.stack([item.vector for item in surroundings])
        spacing = np.array([item.spacing for item in surroundings])
        return cls(spacing=spacing, within=np.asarray(within, np.float64), **found)


def point_problem(contact: Interaction, within: float = 0.0) -> JointLikelihood:
    """Return the motion of a contact's point under all parameters of a press; `within` as in `PressMotion`."""
    motion = functools.partial(PressMotion, contact, MECHANICS, within=within)
    return JointLikelihood([PointObservation(contact, NOMINAL_NOISE)], motion)


def motion_slopes(problem: JointLikelihood, logs: np.ndarray) -> np.ndarray:
    """Return derivatives of the motion against the force's direction by its parameters [D], shape [SLOTS, D] [scene
    units]."""
    jacobian = NOMINAL_NOISE * problem.jacobian(logs).reshape(-1, 3, len(logs))
    return -np.einsum("tdp,d->tp", jacobian, problem.first.contact.direction)


def _explained(problem: JointLikelihood, start: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit a motion from a start [3] or, where that fails, from several; return the parameters and the RMS residual."""
    low, high = box = problem.motion.box(RECOMMENDED.log_box)

    def fitted(begin: np.ndarray) -> tuple[float, np.ndarray]:
        end = find_optimum(problem, begin, box)
        return NOMINAL_NOISE * math.sqrt(2 * end.cost / len(problem.first.times)), end.logs

    begin = np.concatenate([start, np.zeros(len(low) - len(start))])
    rms, best = fitted(np.clip(begin, low + 1e-3, high - 1e-3))
    for begin in chosen_starts(problem, box) if rms > EXPLAINED else ():
        rms, best = min((rms, best), fitted(begin), key=itemgetter(0))
        if rms <= EXPLAINED:
            break
    return best, rms


CONTACTS_A_SCENE = 8


def scene_contacts(task: tuple[SceneSettings, int, float]) -> list[SimulatedContact]:
    """Draw contacts of a scene by its settings, seed and `within`; here, where worker processes load no torch."""
    settings, seed, within = task
    return draw_contacts(settings, seed, CONTACTS_A_SCENE, MECHANICS.time_step, within, sequence=True)


def fit_sequence(task: tuple[Interaction, np.ndarray, float]) -> Fitted:
    """Explain a contact with a depth-change sequence, whose instants may be unknown.

    Args:
        task: the contact without noise, the start of the fit [3], and the largest delay of its instants [s].
    """
    contact, start, within = task
    problem = point_problem(contact, within)
    best, rms = _explained(problem, start)
    field = dent_problem(contact, MECHANICS, within, NOMINAL_NOISE)
    field.look(best)
    depth = field.first
    tangent = np.where(depth.seen[..., None], depth.tangent(*field.motion.at(best)), 0.0)
    change = np.where(depth.seen, depth.observed, np.nan)
    amounts, factors = shape_amounts(change)
    slopes = np.einsum("tij,tkj,pk,tpd->tid", factors, factors, dent_shapes(), tangent)
    middle = -(motion_in_sequence(contact).astype(np.float64) @ contact.direction)
    by_parameters = _padded(best), _padded(motion_slopes(problem, best))
    return Fitted(*by_parameters, rms, change.astype(np.float16), amounts, _padded(slopes), factors, middle)


def _padded(values: np.ndarray) -> np.ndarray:
    """Return values [..., 3] padded by zeros for known delays, or values [..., 5] as they are, shape [..., 5]."""
    return np.concatenate([values, np.zeros((*values.shape[:-1], PARAMETERS - values.shape[-1]))], axis=-1)


NOISE = (3e-4, 6e-3)
"""σ is drawn log-uniformly from this range [scene units]."""
LEVEL = 1 / 255
"""Step of depth that is rounded to 8 bits [scene units]."""
ROUNDING_NOISE = LEVEL / math.sqrt(12)
"""Standard deviation of the rounding error [scene units]."""
REST_SHARE = 0.1
"""Error of the rest position, in σ: the rest surface is an average of many depths (`physics.depth`)."""
CUT_SHARES = 0.5, 0.2
"""Shares of samples that end under the tool, as in live frames, and anywhere before the second is over."""
DELAY_RANGE = 2.0
"""Width of every delay's range, from -1 to 1, in units of `within`."""


def draw_errors(motion: np.ndarray, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw errors of observed motions, shape [B, SLOTS], and the stated noise level of each, [B] [scene units].

    A part of the samples is rounded like 8-bit depth, the others have Gaussian noise. The rest position has an error of
    its own: it is no single rounded depth, but comes from a surface through many.
    """
    count = len(motion)
    noise = np.exp(generator.uniform(*np.log(NOISE), size=count))
    rounded = generator.random(count) < 0.25  # share of the samples
    noise[rounded] = ROUNDING_NOISE
    error = noise[:, None] * generator.normal(size=motion.shape)
    depth = motion + generator.uniform(0, LEVEL, (count, 1))
    error[rounded] = (np.rint(depth / LEVEL) * LEVEL - depth)[rounded]
    return error + noise[:, None] * REST_SHARE * generator.normal(size=(count, 1)), noise


def draw_known(loaded: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Draw which slots are observed, shape [B, SLOTS]: all, those up to one under the tool, or the first few.

    Args:
        loaded: whether a slot is under load, shape [B, SLOTS].
    """
    count = len(loaded)
    under = generator.integers(2, np.maximum(loaded.sum(axis=1), 2).astype(int) + 1)
    kind = np.searchsorted(np.cumsum(CUT_SHARES), generator.random(count), side="right")
    last = np.choose(kind, [under, generator.integers(2, SLOTS + 1, count), np.full(count, SLOTS)])
    return (np.arange(SLOTS) < last[:, None]).astype(np.float64)


@dataclasses.dataclass(frozen=True)
class Drawn:
    """Simulated observations of contacts, with the parabola of their log likelihood; B samples."""

    features: np.ndarray
    """Input of the network, shape [B, FEATURES + SEQUENCE_FEATURES], float32."""
    logs: np.ndarray
    """φ that explains each motion without its errors, shape [B, 3]."""
    information: np.ndarray
    """Fisher information of the observations, shape [B, 3, 3]."""
    pull: np.ndarray
    """Σ slopes·error/σ² of the observations, shape [B, 3]; by it the errors move the likelihood's optimum."""


def draw_observed(fits: Fits, count: int, generator: np.random.Generator) -> Drawn:
    """Draw contacts of the fits with new errors.

    Args:
        fits: contacts with the parameters that explain them.
        count: number of samples, B.
        generator: draws contacts, errors and observed slots.
    """
    index = generator.integers(len(fits.logs), size=count)
    motion, loaded, spacing = fits.motion[index], fits.loaded[index], fits.spacing[index]
    error, noise = draw_errors(motion, generator)
    known = draw_known(loaded, generator)
    slopes = fits.slopes[index] * (known / noise[:, None])[..., None]
    information = np.einsum("btp,btq->bpq", slopes, slopes)
    pull = np.einsum("btp,bt->bp", slopes, error * known / noise[:, None])
    # Share of samples whose features include the depth-change sequence.
    with_sequence = generator.random(count) < 0.85
    amount_errors, middle_errors = draw_sequence_errors(fits, index, noise, generator)
    # The contact's own pixel belongs to the depth-change sequence: it has the sequence's error, and may show
    # neighbouring tissue as well.
    error[with_sequence] = (fits.middle[index] - motion + middle_errors)[with_sequence]
    noise = np.where(with_sequence & (noise == ROUNDING_NOISE), ROUNDED * noise, noise)
    more, pulled = sequence_information(fits.amount_slopes[index], fits.factors[index], amount_errors, noise, known)
    information[with_sequence], pull[with_sequence] = more[with_sequence], pulled[with_sequence]
    within = fits.within[index]
    along = (motion + error) / spacing[:, None]
    amounts = (fits.amounts[index] + amount_errors) * known[..., None]
    point_features = join_features(along, known, loaded * known, fits.around[index], spacing, noise)
    sequence = join_sequence_features(amounts, spacing, noise, within, with_sequence)
    logs = fits.logs[index]
    information, pull = without_delays(information, pull, logs[:, 3:])
    return Drawn(np.concatenate([point_features, sequence], axis=1), logs[:, :3], information, pull)


def draw_sequence_errors(
    sequences: DepthSequences, index: np.ndarray, noise: np.ndarray, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draw errors of depth-change sequences: noise, or rounding where the noise is that of rounding, and the rest
    surface's.

    Args:
        sequences: all depth-change sequences.
        index: indices of the sequences to draw for, shape [B].
        noise: standard deviation of every pixel, shape [B] [scene units].

    Returns:
        Errors of the shapes' amounts, shape [B, SLOTS, SHAPES], and of the middle pixel, shape [B, SLOTS]
        [scene units].
    """
    shapes, factors = dent_shapes(), sequences.factors[index]
    middle = shapes[len(shapes) // 2]
    # The middle pixel's error is jointly normal with the amounts' errors: their share of it, and an independent rest.
    normal = generator.standard_normal((len(index), SLOTS, SHAPES), dtype=np.float32)
    amounts = (factors @ normal[..., None])[..., 0]
    share = middle @ factors
    rest = np.sqrt(np.maximum(1 - np.square(share).sum(axis=2), 0))
    alone = amounts @ middle + rest * generator.standard_normal(rest.shape, dtype=np.float32)
    amounts, alone = noise[:, None, None] * amounts, noise[:, None] * alone
    rounded = np.flatnonzero(noise == ROUNDING_NOISE)
    if len(rounded):
        change = sequences.change[index[rounded]].astype(np.float32)
        side = math.isqrt(change.shape[2])
        # Largest slope of the resting tissue whose depth is rounded [scene units a pixel].
        slopes = generator.uniform(-1, 1, (2, len(rounded), 1)).astype(np.float32) * 0.004
        level, places = np.float32(LEVEL), np.mgrid[:side, :side].reshape(2, 1, -1)
        offset = level * generator.random((len(rounded), 1)) + (slopes * places).sum(axis=0)
        depth = change + offset[:, None]
        error = np.nan_to_num(np.rint(depth / level) * level - depth)
        part = factors[rounded]
        mixed = (error @ shapes.astype(np.float32))[..., None]
        amounts[rounded] = (part @ (part.transpose(0, 1, 3, 2) @ mixed))[..., 0]
        alone[rounded] = error[:, :, side * side // 2]
    still = noise[:, None] * (generator.standard_normal((len(index), SHAPES)) @ smooth_share().T)
    return amounts + still[:, None], alone + (still @ middle)[:, None]


@functools.cache
def smooth_share() -> np.ndarray:
    """Return the factor of the covariance that the rest surface's error has in the shapes' amounts, [SHAPES, SHAPES]
    [σ]."""
    smooth = dent_shapes().T @ smooth_errors()
    return np.linalg.cholesky(smooth @ smooth.T + 1e-12 * np.eye(SHAPES))


def sequence_information(
    slopes: np.ndarray, factors: np.ndarray, errors: np.ndarray, noise: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the information [B, D, D] and pull [B, D] of depth-change sequences; slots share the rest surface's error
    only.

    Args:
        slopes, factors: those of `DepthSequences`, of B sequences.
        errors: errors of the amounts, shape [B, SLOTS, SHAPES] [scene units].
        noise: standard deviation of every pixel, shape [B] [scene units].
        known: whether a slot is observed, shape [B, SLOTS].
    """
    whiten = np.linalg.inv(factors) * (known / noise[:, None])[..., None, None]
    parts, count = np.concatenate([slopes, errors[..., None]], axis=-1), slopes.shape[-1]
    still = whiten @ (noise[:, None, None, None] * smooth_share())
    columns, common = (each.reshape(len(known), -1, each.shape[-1]) for each in (whiten @ parts, still))
    found = CommonErrors(common).marginalised(columns)
    products = found.swapaxes(1, 2) @ found
    return products[:, :count, :count], products[:, :count, count]


def without_delays(information: np.ndarray, pull: np.ndarray, delays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the information [B, 3, 3] and pull [B, 3] of φ where the delays are unknown within their range.

    Args:
        information, pull: those of all parameters, shapes [B, D, D] and [B, D].
        delays: the delays that explain the motions, shape [B, D - 3]; their prior is centred at 0.
    """
    count = delays.shape[1]
    prior = 12 / DELAY_RANGE**2
    cross = np.linalg.solve(information[:, 3:, 3:] + prior * np.eye(count), information[:, 3:, :3])
    left = information[:, :3, :3] - np.einsum("bdp,bdq->bpq", information[:, 3:, :3], cross)
    return left, pull[:, :3] - np.einsum("bdp,bd->bp", cross, pull[:, 3:] - prior * delays)
