"""A contact's brightness as a least-squares problem: light against the simulator and the law of light.

Besides φ and the delays (`estimators.direct.motion`) the parameters are where the dent's middle lies, the tilt of the
plane that the tissue is taken to be, how far its surface is rounded off, the camera's response as a power, and the
share of light that reaches tissue whatever its tilt. All of these have priors. Every frame's gain is marginalised.
Residuals of neighbours and of successive frames belong together; so many fewer of them count as that says.
"""

from __future__ import annotations

import dataclasses
import math
import warnings

import numpy as np
from scipy.ndimage import gaussian_filter

from palpate.data.brightness.light import FINE
from palpate.data.brightness.sequence import SPREAD, BrightnessSequence
from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.lit_sheet import LitSheet
from palpate.estimators.direct.motion import PressMotion
from palpate.physics.load import Press
from palpate.physics.mechanics import Mechanics
from palpate.physics.observation import Observation

FREEDOM = 3.0
"""Degrees of freedom of Student's errors: highlights that moved and wrong outlines are no normal errors."""
RELATIVE = 0.1
"""Standard deviation of what the law gets wrong, as a share of the logarithm that it predicts: shadows, light from
other tissue, walls so steep that the surface between vertices decides."""
GAIN = 0.02
"""Standard deviation of the logarithm of a frame's gain at the contact, in addition to what far tissue tells."""
LEAST_NOISE = 0.004
"""Of the logarithm of light: a level of 8 bits in brightly lit tissue."""
ASIDE, TILT = 2.0, 0.2
"""Priors' standard deviations: of the dent's middle by axis [grid pixels], of the tilt's tangents."""
ROUNDING, ROUNDING_SD = 0.53, 0.3
"""Prior of how far the surface is rounded off [grid pixels]: as far as patches of vertices that are a pixel wide, and
the standard deviation of its logarithm."""
RESPONSE, AMBIENT = 0.15, 0.1
"""Standard deviations of the logarithm of the response's power against sRGB's, and of the share of light from
everywhere: cameras have curves of their own, and rough tissue sends back more of grazing light than matte tissue."""
PRIOR_MEAN = np.array([0.0, 0.0, 0.0, 0.0, math.log(ROUNDING), 0.0, 0.0])
PRIOR_SD = np.array([ASIDE, ASIDE, TILT, TILT, ROUNDING_SD, RESPONSE, AMBIENT])
LARGEST = np.array([5.0, 5.0, 0.6, 0.6, 1.2, 0.4, 0.4])
"""How far these parameters may lie from the priors' means."""
OTHERS = len(PRIOR_MEAN)
"""Parameters in addition to those of the press."""
LEAST_LIGHT = 1e-3
"""No tissue is darker than this share of its light at rest."""
LAGS, CHANCE = 8, 0.05
"""Residuals farther apart, in places or frames, are independent, and so are those that correlate less."""
MOVED = 4.0
"""Light that changes by more standard deviations says how well the press explains it."""


class BrightnessProblem:
    """Weighted residuals of a brightness sequence and their derivatives by all parameters.

    Args:
        contact: a run of contact with its brightness sequence; of its mesh only the outline and the distance count.
        mechanics: of the fits.
        within: as of `PressMotion`.
        tilt: of the plane whose mesh is simulated, right and down, as tangents.

    Raises:
        ValueError: the contact has no brightness sequence.
    """

    def __init__(self, contact: Interaction, mechanics: Mechanics, within: float, tilt: np.ndarray) -> None:
        if contact.brightness is None or not len(contact.brightness.times):
            raise ValueError("the contact has no brightness sequence; gather it with frames that have light.")
        self.contact, self.within = contact, within
        self.sequence: BrightnessSequence = contact.brightness
        self.sheet = LitSheet(contact.mesh, contact.vertex, self.sequence.rest, tilt)
        self.press = dataclasses.replace(
            contact,
            mesh=self.sheet.mesh,
            load=Press.at(self.sheet.vertex, self.sheet.normal, contact.load.factor),
            observation=Observation.of_point(
                self.sheet.vertex, self.sequence.times, np.full((len(self.sequence.times), 3), np.nan), np.nan
            ),
            sequence=None,
        )
        """The contact on the plane; none of its points is followed."""
        self.motion = PressMotion(self.press, mechanics, self.sheet.vertices, self.sequence.times, within)
        self.observed = self.sequence.light.reshape(len(self.sequence.times), -1).astype(np.float64)
        """Shape [N, P]."""
        self._inner = self.sheet.inner.ravel()
        self._weight = np.ones_like(self.observed)
        self.noise = max(self.sequence.noise, LEAST_NOISE)
        """Standard deviation of a residual where the law predicts no change."""
        self.together = 1.0
        """How many residuals count as one."""
        self._known: tuple[np.ndarray, tuple[np.ndarray, np.ndarray]] | None = None

    def box(self, tissue: np.ndarray) -> np.ndarray:
        """Lower and upper ends of all parameters, shape [2, D], from those of φ [2, 3]."""
        return np.hstack([self.motion.box(tissue), PRIOR_MEAN + np.array([[-1], [1]]) * LARGEST])

    def start(self, press: np.ndarray, aside: np.ndarray) -> np.ndarray:
        """All parameters from those of a press and where its dent lies; the others as their priors say."""
        return np.concatenate([press, aside, PRIOR_MEAN[2:]])

    def darkest(self) -> np.ndarray:
        """Row and column of the middle of what has darkened, from the contact's vertex, shape [2] [grid pixels]."""
        darker = np.clip(self.sequence.rest - self.sequence.light, 0, 1)
        known = np.isfinite(darker)
        total = gaussian_filter(np.where(known, darker, 0).sum(axis=0), FINE)
        mean = total / np.maximum(gaussian_filter(known.sum(axis=0).astype(np.float64), FINE), 0.1)
        weights = np.where(self.sheet.inner & (mean > 0.5 * mean[self.sheet.inner].max()), mean, 0.0)
        places = np.indices(mean.shape) - 0.5 * (len(mean) - 1)
        return np.einsum("rc,irc->i", weights, places) / max(weights.sum(), 1e-9) / FINE

    def predicted(self, logs: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Logarithm of the light at displacements [N, V, 3], and the law's part of it, shape [N, P] each."""
        rest, change = self.sheet.shown(moved, logs[-OTHERS:-2])
        law = math.exp(logs[-2]) * np.log(_with_ambient(np.exp(change), logs[-1]))
        return rest + law, law

    def tangent(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Logarithm of the light [N, P], and its derivatives by all parameters [N, P, D]."""
        found = self.sheet.linearised(*self.motion.at(logs[:-OTHERS]), logs[-OTHERS:-2])
        response, ambient, direct = math.exp(logs[-2]), logs[-1], np.exp(found.change)
        light = _with_ambient(direct, ambient)
        law = response * np.log(light)
        by_change = (response * (1 - ambient) * direct / light)[..., None] * found.change_slopes
        by_response, by_ambient = law[..., None], (response * (1 - direct) / light)[..., None]
        return found.rest + law, np.concatenate([found.rest_slopes + by_change, by_response, by_ambient], axis=-1)

    def linearise(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals in standard deviations, the priors' behind them, and their derivatives by all parameters [K, D]."""
        if self._known is None or not np.array_equal(self._known[0], logs):
            self._known = np.array(logs), self._linearise(logs)
        return self._known[1]

    def _linearise(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        light, slopes = self.tangent(logs)
        residual, weight = self.compared(light)
        slopes = np.where(weight[..., None] > 0, np.nan_to_num(slopes), 0.0)
        # A gain that is unknown takes the weighted mean off, as far as it may reach.
        root, total = np.sqrt(weight)[..., None], weight.sum(axis=1) + 1 / GAIN**2
        both = np.concatenate([residual[..., None], slopes], axis=-1)
        both = root * (both - (np.einsum("np,npd->nd", weight, both) / total[:, None])[:, None])
        both = both.reshape(-1, both.shape[-1])
        prior = np.zeros((OTHERS, len(logs)))
        prior[:, -OTHERS:] = np.diag(1 / PRIOR_SD)
        left = (logs[-OTHERS:] - PRIOR_MEAN) / PRIOR_SD
        return np.concatenate([both[:, 0], left]), np.concatenate([both[:, 1:], prior])

    def compared(self, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predicted less observed, 0 where either isn't known, and the inverse variances [N, P]."""
        residual = light - self.observed
        known = np.isfinite(residual) & self._inner
        variance = self.together * self.noise**2
        return np.where(known, residual, 0.0), np.where(known, self._weight / variance, 0.0)

    def look(self, logs: np.ndarray) -> None:
        """Measure residuals at parameters near the best: their size, which are outliers, how they belong together."""
        light, law = self.predicted(logs, self.motion.quick(logs[:-OTHERS]))
        residual = np.where(self._inner, light - self.observed, np.nan)
        known = np.isfinite(residual)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # frames that show nothing
            residual = np.where(known, residual - np.nanmedian(residual, axis=1, keepdims=True), 0.0)
        law = np.where(known, law, 0.0)
        self.noise = max(SPREAD * float(np.median(np.abs(residual[known]))), LEAST_NOISE)
        inflated = 1 + np.square(RELATIVE * law / self.noise)
        squares = np.square(residual / self.noise) / inflated
        student = (FREEDOM + 1) / (FREEDOM + squares)
        self._weight = student / inflated
        white = np.where(known, np.sign(residual) * np.sqrt(student * squares), 0.0)
        shape = (len(white), *self.sheet.inner.shape)
        self.together = _together(white.reshape(shape), known.reshape(shape))
        change = np.where(known, self.observed - self.sequence.rest.ravel(), 0.0)
        moving = (np.abs(law) > MOVED * self.noise) | (np.abs(np.nan_to_num(change)) > MOVED * self.noise)
        left, whole = (np.square(np.clip(np.nan_to_num(part[moving]), -1, 1)).sum() for part in (residual, change))
        self.skill = 1 - math.sqrt(left / whole) if whole > 0 else 0.0
        """1 - error / change of the light where it changes: 0 as if nothing had moved."""
        self._known = None

    def residual(self, logs: np.ndarray) -> np.ndarray:
        """The first of `linearise`."""
        return self.linearise(logs)[0]

    def jacobian(self, logs: np.ndarray) -> np.ndarray:
        """The second of `linearise`."""
        return self.linearise(logs)[1]


def _with_ambient(direct: np.ndarray, ambient: float) -> np.ndarray:
    """Light over that at rest, where a share of it reaches tissue whatever its tilt."""
    return np.maximum((1 - ambient) * direct + ambient, LEAST_LIGHT)


def _together(residual: np.ndarray, known: np.ndarray) -> float:
    """How many residuals [N, L, L] count as one: along every axis 1 and twice the sum of their correlations."""
    square, found = np.square(residual).sum() / max(known.sum(), 1), 1.0
    for axis in range(residual.ndim):
        values, seen = np.moveaxis(residual, axis, 0), np.moveaxis(known, axis, 0)
        along = 1.0
        for lag in range(1, min(LAGS, len(values) - 1) + 1):
            pairs = max((seen[lag:] & seen[:-lag]).sum(), 1)
            correlation = float((values[lag:] * values[:-lag]).sum() / (pairs * max(square, 1e-12)))
            if correlation <= CHANCE:
                break
            along += 2 * correlation
        found *= along
    return found
