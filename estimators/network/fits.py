"""Contact motions with the parameters that explain them: the data of the posterior's fine training stage.

Every motion is explained once by least squares; around that fit its log likelihood is a known parabola, whatever noise,
rounding or cut-off window is drawn in addition (`estimators.network.draws`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from palpate.data.contact.features import FRAME_RATE, contact_surroundings, slot_times
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.sequence_features import dent_shapes, motion_in_sequence, shape_amounts
from palpate.data.synthetic.settings import SceneSettings
from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.problem import ContactProblem, find_optimum
from palpate.physics.mechanics import RECOMMENDED, Mechanics

MECHANICS = Mechanics(scheme="dkd", window_error=1e-4)
"""The simulator of the fits."""
BOUNDS = RECOMMENDED
"""Admissible box of θ, and so the prior."""
FRAME_S = 1 / FRAME_RATE
"""Where instants aren't known, a press begins and ends at most this long before or after the time stamps [s]."""
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


@dataclasses.dataclass(frozen=True)
class Fits(DepthSequences):
    """N contacts with the PARAMETERS D that explain their motions, as arrays."""

    motion: np.ndarray
    """Motion against the force's direction at the slots, without noise, shape [N, SLOTS] [scene units]."""
    logs: np.ndarray
    """Parameters that explain the motion, shape [N, D]."""
    slopes: np.ndarray
    """Derivatives of the motion by these parameters at the slots, shape [N, SLOTS, D] [scene units]."""
    loaded: np.ndarray
    """Whether a slot is under load by the time stamps, shape [N, SLOTS]."""
    around: np.ndarray
    """`Surroundings.vector`, shape [N, 40]."""
    spacing: np.ndarray
    """Spacing of the mesh at the contact, shape [N] [scene units]."""
    within: np.ndarray
    """Largest delay of the press's instants, shape [N] [s]; where it is 0 the delays are 0 and have no derivatives."""

    @classmethod
    def of(cls, contacts: Sequence[Interaction], fitted: Sequence[Fitted], within: Sequence[float]) -> Fits:
        """Make the arrays from contacts without noise, the fit of each, and the largest delay of its instants [s]."""
        slots, surroundings = slot_times() + 1e-9, [contact_surroundings(contact) for contact in contacts]
        names = [name for name in Fitted._fields if name != "rms"]
        return cls(
            motion=np.stack([-(contact.moved @ contact.direction) for contact in contacts]).astype(np.float64),
            loaded=np.stack([slots <= contact.load_seconds + 2e-9 for contact in contacts]) * 1.0,
            around=np.stack([item.vector for item in surroundings]),
            spacing=np.array([item.spacing for item in surroundings]),
            within=np.asarray(within, np.float64),
            **{name: np.stack([getattr(fit, name) for fit in fitted]) for name in names},
        )


class Fitted(NamedTuple):
    """What explains one contact; other arrays as of `Fits`, without N."""

    logs: np.ndarray
    slopes: np.ndarray
    rms: float
    """Root mean square residual [scene units]."""
    change: np.ndarray
    amounts: np.ndarray
    amount_slopes: np.ndarray
    factors: np.ndarray
    middle: np.ndarray


def motion_slopes(problem: ContactProblem, logs: np.ndarray) -> np.ndarray:
    """Derivatives of the motion against the force's direction by its parameters [D], shape [SLOTS, D] [scene units]."""
    jacobian = NOMINAL_NOISE * problem.jacobian(logs).reshape(-1, 3, len(logs))
    return -np.einsum("tdp,d->tp", jacobian, problem.direction)


def _explained(problem: ContactProblem, start: np.ndarray) -> tuple[np.ndarray, float]:
    """Parameters that explain a motion, from a start [3] or, where that fails, from several; and the RMS residual."""
    low, high = problem.motion.box(BOUNDS.log_box)

    def fitted(begin: np.ndarray) -> tuple[float, np.ndarray]:
        end = find_optimum(problem, begin, low, high)
        return NOMINAL_NOISE * math.sqrt(2 * end.cost / len(problem.moved)), end.logs

    begin = np.concatenate([start, np.zeros(len(low) - len(start))])
    rms, best = fitted(np.clip(begin, low + 1e-3, high - 1e-3))
    for begin in problem.starts(low, high) if rms > EXPLAINED else ():
        rms, best = min((rms, best), fitted(begin), key=itemgetter(0))
        if rms <= EXPLAINED:
            break
    return best, rms


def fit_sequence(task: tuple[Interaction, np.ndarray, float]) -> Fitted:
    """Explain a contact with a depth-change sequence, whose instants may be unknown.

    Args:
        task: the contact without noise, the start of the fit [3], and the largest delay of its instants [s].
    """
    contact, start, within = task
    problem = ContactProblem(contact, MECHANICS, NOMINAL_NOISE, within)
    best, rms = _explained(problem, start)
    field = SequenceProblem.of_press(contact, MECHANICS, within, NOMINAL_NOISE)
    field.look(best)
    tangent = np.where(field.seen[..., None], field.tangent(best)[1], 0.0)
    change = np.where(field.seen, field.observed, np.nan)
    amounts, factors = shape_amounts(change)
    slopes = np.einsum("tij,tkj,pk,tpd->tid", factors, factors, dent_shapes(), tangent)
    middle = -(motion_in_sequence(contact).astype(np.float64) @ contact.direction)
    by_parameters = _padded(best), _padded(motion_slopes(problem, best))
    return Fitted(*by_parameters, rms, change.astype(np.float16), amounts, _padded(slopes), factors, middle)


def _padded(values: np.ndarray) -> np.ndarray:
    """Values [..., 3] padded by zeros for known delays, or values [..., 5] as they are, shape [..., 5]."""
    return np.concatenate([values, np.zeros((*values.shape[:-1], PARAMETERS - values.shape[-1]))], axis=-1)
