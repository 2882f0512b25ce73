"""Light of the tissue around a contact against the simulator and the law of light.

Its own parameters are where the dent's middle lies, the tilt of the plane that the tissue is taken to be, how far its
surface is rounded off, how far light spreads in tissue, how rough the surface is, how strong the light is that it
mirrors as it is wet and into how wide a lobe, and the camera's response as a power. Further ones are the share of light
that reaches tissue whatever its tilt, its albedo, by which the walls of a dent light each other, and how far coded
pictures lag behind the light: a video leaves changes out until they are worth their bits. All have priors. Every
frame's gain and every place's amplitude are marginalised. Residuals of neighbours and of successive frames are
correlated; so fewer of them count.
"""

import math
import warnings
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from palpate.common.robust import median_sd
from palpate.data.contact.interaction import Interaction
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.light import FINE, brightness
from palpate.data.shading.sequence import RestingLight, ShadingRecorder, ShadingSequence
from palpate.observations.base import Observation, Parameter
from palpate.observations.lit_sheet import PLACING, LitSheet, Shown
from palpate.physics.load import Press
from palpate.physics.observation import CommonErrors, Linearised
from palpate.physics.observation import Observation as Points

FREEDOM = 3.0
"""Degrees of freedom of Student's errors: highlights that moved and wrong outlines are no normal errors."""
AMPLITUDE = 0.25
"""Standard deviation of every place's amplitude, common to all frames: its gloss and albedo are its own."""
LEAST_NOISE = 0.004
"""Least noise of the logarithm of light: a level of 8 bits in brightly lit tissue."""
USUALLY_LEFT, USUAL_LAG = 0.2, 0.5
"""Share of the change of light that a press usually leaves, and usual lag of coded pictures [levels of 8 bits]. The
more either is, the more wrong is the law."""
NUISANCE = (
    # Where the dent's middle lies, by rows and columns [grid pixels].
    *2 * [Parameter(0, 2.0, 5.0)],
    # Tilt of the tissue, right and down, as tangents.
    *2 * [Parameter(0, 0.2, 0.6)],
    # Logarithm of how far the surface is rounded off [grid pixels]: as far as patches of vertices a pixel wide.
    Parameter(math.log(0.53), 0.3, 1.2),
    # Logarithm of how far light spreads in tissue before it comes out [grid pixels].
    Parameter(math.log(0.35), 0.5, 1.5),
    # Logarithm of the width of the lobe into which wet tissue mirrors light [rad]: fine relief makes it wider than a
    # smooth layer of water would.
    Parameter(math.log(0.13), 0.4, 1.2),
    # Roughness of the tissue.
    Parameter(0.1, 0.12, 0.4, 0.0),
    # Mirrored light over matt red and green where tissue faces the camera.
    Parameter(0, 0.25, 1.2, 0.0),
    # Logarithm of the response's power against sRGB's: cameras have curves of their own.
    Parameter(0, 0.1, 0.4),
    # Share of light from everywhere.
    Parameter(0, 0.05, 0.4),
    # Albedo of red and green.
    Parameter(0.3, 0.35, 0.5, 0.0),
    # How far coded pictures lag behind the light [levels of 8 bits].
    Parameter(USUAL_LAG, 0.7, 4.0, 0.0),
)
PRIOR_MEAN, PRIOR_SD = (np.array([getattr(each, name) for each in NUISANCE]) for name in ("mean", "sd"))
LAW = 5
"""The last of them, which the law of light and the coding take: gloss, response, ambient share, albedo, lag."""
STEP = 1e-4
"""Step of the derivatives."""
OTHERS = len(NUISANCE)
"""Parameters in addition to those of the press."""
LAGS, CHANCE = 8, 0.05
"""Residuals farther apart, in places or frames, are independent, and so are those that correlate less."""
MOVED = 4.0
"""Light that changes by more standard deviations says how well the press explains it."""

MOST_TOGETHER = 30.0
"""Residuals that count as one, at most. Coded pictures repeat their errors, which count as the law's: as noise they
would leave gloss and albedo to their priors."""
LAW_ERRORS = np.column_stack([(-0.4, -0.15, 0.0), (0.25, 0.25, 0.25)])
"""Errors of φ by law, mesh and coding, a column for each of two independent ones, as standard deviations: of how deep
and slow the dent is, which k_s explains rather than F, and of the scale of all three, which inertia alone tells. They
were chosen on clips of a path tracer, such as `python -m benchmarks.path_traced` compares."""


class ShadingObservation(Observation):
    """Brightness sequence of a run, whose residuals are weighted anew at every look.

    Args:
        contact: with its brightness sequence; of its mesh only the outline and the distance count.
        tilt: of the plane whose mesh is simulated, right and down, as tangents; None = the contact's own mesh is
            simulated, as for other observations of the same motion. Then `law_errors` are marginalised.
    """

    def __init__(self, contact: Interaction, tilt: np.ndarray | None = None) -> None:
        super().__init__(contact)
        self._own_mesh, self._errors = tilt is None, CommonErrors(np.zeros((0, 0)))
        self.quick = not self._own_mesh
        self.sequence: ShadingSequence = contact.observations["shading"]
        self.sheet = LitSheet(contact.mesh, contact.vertex, self.sequence.rest, tilt)
        means = [*PRIOR_MEAN[:2], *(self.sheet.tilt if tilt is None else PRIOR_MEAN[2:4]), *PRIOR_MEAN[4:]]
        self.nuisance = [each._replace(mean=mean) for each, mean in zip(NUISANCE, means, strict=True)]
        self.vertices, self.times = self.sheet.vertices, self.sequence.times
        load = Press.at(self.sheet.vertex, self.sheet.normal, contact.load.factor)
        nothing = Points.of_point(load.vertex, self.times, np.full((len(self.times), 3), np.nan), np.nan)
        self.press = replace(contact.having(point=nothing, depth=None), mesh=self.sheet.mesh, load=load)
        """The contact on the plane; none of its points is followed."""
        self.observed = self.sequence.light[..., self.sheet.inner].reshape(len(self.times), -1).astype(np.float64)
        """Colour by colour, shape [N, 3·P]."""
        self._rest = rest = self.sequence.rest[:, self.sheet.inner].ravel()
        bright = brightness(self.sequence.rest)
        self._share = np.exp([np.nanmedian(colour - bright) for colour in self.sequence.rest])
        """Light of every colour over that of red and green, at rest."""
        mask = np.isfinite(np.vstack([rest, self.observed]))
        self._followed = mask[1:] & mask[:-1]  # since the frame before; others are coded anew
        # What a level of 8 bits is in the logarithm of light, by a response of 1/2.2.
        self._level = 2.2 / 255 * np.exp(-rest / 2.2)
        self._weight, self._law = np.ones_like(self.observed), np.zeros_like(self.observed)
        self.noise = np.repeat(np.maximum(self.sequence.noise, LEAST_NOISE), self.sheet.inner.sum())
        """Standard deviation of a residual where the law predicts no change, shape [3·P]."""
        self._lag = 0.0
        self.together = 1.0
        """Number of residuals that count as one."""

    @classmethod
    def recorder(cls, onset: PreparedFrame, size: tuple[int, int], rest: RestingLight | None) -> ShadingRecorder | None:
        pixels, vertex = onset.contact.mesh.pixels, onset.contact.vertex
        return None if rest is None else ShadingRecorder(rest.median(), pixels[vertex], onset.light_view)

    def darkest(self) -> np.ndarray:
        """Row and column of the middle of what has darkened, from the contact's vertex, shape [2] [grid pixels]."""
        darker = np.clip(self.sequence.rest - self.sequence.light, 0, 1).mean(axis=1)
        known = np.isfinite(darker)
        total = gaussian_filter(np.where(known, darker, 0).sum(axis=0), FINE)
        mean = total / np.maximum(gaussian_filter(known.sum(axis=0).astype(np.float64), FINE), 0.1)
        weights = np.where(self.sheet.inner & (mean > 0.5 * mean[self.sheet.inner].max()), mean, 0.0)
        places = np.indices(mean.shape) - 0.5 * (len(mean) - 1)
        return np.einsum("rc,irc->i", weights, places) / max(weights.sum(), 1e-9) / FINE

    def predicted(self, logs: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of the light at displacements [N, V, 3], and the law's part of them, shape [N, 3·P] each."""
        placing, surface = np.split(logs[-OTHERS:-LAW], [PLACING])
        return self._light(self.sheet.shown(self.sheet.placed(moved, placing), surface), logs)

    def _light(self, shown: Shown, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of the light in a coded video, and the law's part of what they were before, [N, 3·P] each."""
        law = np.concatenate([_law(shown, share, *logs[-LAW:-1]) for share in self._share], axis=1)
        return coded(shown.rest + law, self._rest, logs[-1] * self._level, self._followed), law

    def tangent(self, moved: np.ndarray, slopes: np.ndarray, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of the light [N, 3·P], and their derivatives by all parameters [N, 3·P, D]."""
        placing, surface, _ = np.split(logs[-OTHERS:], [PLACING, -LAW])
        placed = self.sheet.placed(moved, placing)
        shown = self.sheet.shown(placed, surface)
        light = self._light(shown, logs)[0]
        found = np.empty((len(logs), *light.shape))
        press = len(logs) - OTHERS
        for index, step in enumerate(STEP * np.eye(len(logs))):
            stepped = logs + step
            if index < press:
                ahead = self.predicted(logs, moved + STEP * slopes[..., index])
            elif index < press + PLACING:
                ahead = self.predicted(stepped, moved)
            elif index < len(logs) - LAW:
                ahead = self._light(self.sheet.shown(placed, stepped[press + PLACING : -LAW]), stepped)
            else:
                ahead = self._light(shown, stepped)
            found[index] = ahead[0]
        return light, np.moveaxis((found - light) / STEP, 0, -1)

    def linearise(self, moved: np.ndarray, slopes: np.ndarray, logs: np.ndarray) -> Linearised:
        """See `Observation`, the priors' residuals behind those of the light."""
        both = self._whitened(moved, slopes, logs)
        if self._own_mesh:
            both = self._errors.marginalised(both)
        prior = np.zeros((OTHERS, len(logs)))
        prior[:, -OTHERS:] = np.diag(1 / PRIOR_SD)
        left = (logs[-OTHERS:] - [each.mean for each in self.nuisance]) / PRIOR_SD
        return Linearised(np.concatenate([both[:, 0], left]), np.concatenate([both[:, 1:], prior]))

    def _whitened(self, moved: np.ndarray, slopes: np.ndarray, logs: np.ndarray) -> np.ndarray:
        """Residuals of the light in standard deviations, and their derivatives, shape [N·P, 1 + D]."""
        light, slopes = self.tangent(moved, slopes, logs)
        residual, weight = self.compared(light)
        slopes = np.where(weight[..., None] > 0, np.nan_to_num(slopes), 0.0)
        # A gain that is unknown takes the weighted mean off, as far as it may reach.
        # Standard deviation of the logarithm of a frame's gain at the contact, in addition to what far tissue tells.
        root, total = np.sqrt(weight)[..., None], weight.sum(axis=1) + 1 / 0.02**2
        both = np.concatenate([residual[..., None], slopes], axis=-1)
        both = root * (both - (np.einsum("np,npd->nd", weight, both) / total[:, None])[:, None])
        both = without_amplitude(both, AMPLITUDE * self._law[..., None] * root)
        return both.reshape(-1, both.shape[-1])

    @property
    def law_errors(self) -> np.ndarray:
        """`LAW_ERRORS` of a law that explains as little as the last look says, shape [3, 2]."""
        return LAW_ERRORS * max((1 - self.skill) / USUALLY_LEFT, 1.0) * max(self._lag / USUAL_LAG, 1.0)

    def compared(self, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predicted less observed, 0 where either isn't known, and the inverse variances [N, P]."""
        residual = light - self.observed
        known = np.isfinite(residual)
        variance = self.together * self.noise**2
        return np.where(known, residual, 0.0), np.where(known, self._weight / variance, 0.0)

    def look(self, moved: np.ndarray, slopes: np.ndarray, logs: np.ndarray, *, outliers: bool = False) -> None:
        """Measure residuals near the best: their size, which are outliers, how they are correlated."""
        light, law = self.predicted(logs, moved)
        residual = light - self.observed
        known = np.isfinite(residual)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # frames that show nothing
            residual = np.where(known, residual - np.nanmedian(residual, axis=1, keepdims=True), 0.0)
        law = np.where(known, law, 0.0)
        colours = zip(np.split(residual, 3, axis=1), np.split(known, 3, axis=1), strict=True)
        noise = [max(median_sd(part[mask]), LEAST_NOISE) for part, mask in colours]
        self.noise = np.repeat(noise, self.sheet.inner.sum())
        # Standard deviation of what the law gets wrong, as a share of the logarithm that it predicts.
        inflated = 1 + np.square(0.1 * law / self.noise)
        squares = np.square(residual / self.noise) / inflated
        student = (FREEDOM + 1) / (FREEDOM + squares)
        # What doesn't show now counts for nothing until the next look, so that the sum of squares has no steps.
        self._weight = np.where(known, student / inflated, 0.0)
        white = np.where(known, np.sign(residual) * np.sqrt(student * squares), 0.0)
        self._lag = float(logs[-1])
        self._law, root = law, np.where(known, np.sqrt(self._weight) / self.noise, 0.0)
        white = without_amplitude(white[..., None], (AMPLITUDE * law * root)[..., None])[..., 0]
        side = math.isqrt(int(self.sheet.inner.sum()))
        shape = (len(white), 3, side, side)
        self.together = min(_together(white.reshape(shape), known.reshape(shape)), MOST_TOGETHER)
        change = np.where(known, self.observed - self._rest, 0.0)
        moving = (np.abs(law) > MOVED * self.noise) | (np.abs(np.nan_to_num(change)) > MOVED * self.noise)
        left, whole = (np.square(np.clip(np.nan_to_num(part[moving]), -1, 1)).sum() for part in (residual, change))
        self.skill = 1 - math.sqrt(left / whole) if whole > 0 else 0.0
        """1 - error / change of the light where it changes: 0 as if nothing had moved."""
        if self._own_mesh:
            by_press = self._whitened(moved, slopes, logs)[:, 1:4]
            self._errors = CommonErrors(by_press @ self.law_errors)


def without_amplitude(white: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Residuals over their standard deviations [N, P, C] when an amplitude of every place is marginalised.

    Args:
        white: residuals without that.
        along: what a standard deviation of the amplitude adds to them, shape [N, P, 1].
    """
    square = np.maximum(np.square(along).sum(axis=0), 1e-12)
    share = (1 - 1 / np.sqrt(1 + square)) / square
    return white - along * (share * np.einsum("npi,npc->pc", along, white))


def coded(light: np.ndarray, rest: np.ndarray, lag: np.ndarray, followed: np.ndarray) -> np.ndarray:
    """Light in a coded video: it stays as it was until that is more than the lag off, and so far behind then.

    Args:
        light: its logarithm, shape [N, P].
        rest: its logarithm at rest, shape [P].
        lag: in the logarithm of light, shape [P].
        followed: which places have been visible since the frame before, shape [N, P]; others are coded anew.
    """
    found, before = np.empty_like(light), rest
    for index, now in enumerate(light):
        behind = np.clip(before, now - lag, now + lag)
        before = found[index] = np.where(followed[index] & np.isfinite(before), behind, now)
    return found


def _law(shown: Shown, share: float, gloss: float, response: float, ambient: float, albedo: float) -> np.ndarray:
    """The law's part of the logarithm of a colour's light, [N, P].

    Walls of a dent send each other light as often as they reflect it; mirrored light is white.

    Args:
        shown: what pixels show.
        share: of the colour in red's and green's mean at rest.
        gloss: mirrored light over matt red and green.
        response: logarithm of its power.
        ambient: share of the light that reaches tissue in any tilt.
        albedo: of red and green.
    """
    mirrored = gloss * np.nanmean(shown.gloss_at_rest)
    share = max(share * (1 + mirrored) - mirrored, 0.05)  # of matt light alone
    gloss, sent = gloss / share, np.minimum(albedo * share * shown.received, 0.8)
    # No tissue is darker than this share of its light at rest.
    light = np.maximum((1 - ambient) * shown.matt + ambient + sent / (1 - sent) + gloss * shown.gloss, 1e-3)
    return math.exp(response) * np.log(light / (1 + gloss * shown.gloss_at_rest))


def _together(residual: np.ndarray, known: np.ndarray) -> float:
    """Return the number of residuals [N, 3, L, L] that count as one.

    Along every axis that is 1 and twice the sum of their correlations.
    """
    square, found = np.square(residual).sum() / max(known.sum(), 1), 1.0
    for axis in range(residual.ndim):
        values, mask = np.moveaxis(residual, axis, 0), np.moveaxis(known, axis, 0)
        along = 1.0
        for lag in range(1, min(LAGS, len(values) - 1) + 1):
            pairs = max((mask[lag:] & mask[:-lag]).sum(), 1)
            correlation = float((values[lag:] * values[:-lag]).sum() / (pairs * max(square, 1e-12)))
            if correlation <= CHANCE:
                break
            along += 2 * correlation
        found *= along
    return found
