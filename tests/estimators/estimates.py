"""A contact, and estimates of it, for what tells, draws and stores them."""

from typing import Any

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.estimators.estimate import PressResult
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.physics.identifiability import NINETY
from palpate.physics.load import Press, held
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import contact_normal
from palpate.physics.observation import Observation
from tests.physics.sheets import sheet

MECHANICS = Mechanics(time_step=0.0025, steps=400, scheme="dkd")
LOAD_STEPS = 64
MESH = sheet(9, 9)
PRESS = Press.at(40, contact_normal(MESH, 40), held(LOAD_STEPS, MECHANICS.steps))
SEEN = Observation.of_point(40, 0.04 * np.arange(1, 9), np.zeros((8, 3)), 0.001)
CONTACT = Interaction(MESH, PRESS, {"point": SEEN}, MECHANICS.time_step)
THETA, COVARIANCE, INFORMATION = np.array([0.5, 0.06, -0.1]), np.diag([0.01, 0.04, 0.0025]), np.diag([100.0, 25, 400])
ESTIMATE = PressResult(THETA, COVARIANCE, information=INFORMATION, noise=0.001, misfit=1.1, largest_misfit=1.5)
GOOD = InteractionEstimate(7, 7, 0.28, 0.16, CONTACT, ESTIMATE, (np.array([0.0, 0.32]), np.array([0.0, -0.02])))
NONE = InteractionEstimate(1, 1, 0.0, detail="Because.")


def frame_in_contact(
    verdict: str,
    theta: tuple[float, float, float],
    factors: tuple[float, float, float] | None = None,
    *,
    number: int = 7,
    time_s: float = 0.28,
    **told: Any,
) -> FrameEstimate:
    """A frame with parameters.

    Args:
        factors: by which the ends of the 90 % intervals lie above and below θ; None = the estimator gives none.
    """
    covariance = None if factors is None else np.diag(np.square(np.log(factors) / NINETY))
    estimate = PressResult(np.array(theta), covariance, given_verdict="" if covariance is not None else "undetermined")
    return FrameEstimate(number, time_s, "ok", estimate=estimate, verdict=verdict, **told)
