"""Contacts as they might have been observed: errors, cut-off windows and what is told of them, drawn around their fits.

A likelihood is a parabola around its fit, so a draw costs no rollout.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable

import numpy as np

from data.contact.features import SLOTS, join_features
from data.contact.film import smooth_errors
from data.contact.film_features import ROUNDED, SHAPES, dent_shapes, join_film_features
from estimators.network.fits import Films, Fits

NOISE = (3e-4, 6e-3)
"""σ is drawn log-uniformly from this range [scene units]."""
ROUNDING_SHARE, LEVEL = 0.25, 1 / 255
"""Share of samples whose depth is rounded instead, as 8 bits do, and the rounding's step [scene units]."""
ROUNDING_NOISE = LEVEL / math.sqrt(12)
"""Its error's standard deviation [scene units]."""
REST_SHARE = 0.1
"""Error of the rest position, in σ: the rest surface is an average of many depths (`benchmarks.tracking_errors`)."""
CUT_SHARES = 0.5, 0.2
"""Shares of samples that end under the tool, as live frames see them, and anywhere before the second is over."""
FILM_SHARE = 0.85
"""Share of samples that are told of the film, where there is one."""
DELAY_RANGE = 2.0
"""Of every delay, from -1 to 1, in units of `within`."""
STEEPEST = 0.004
"""Steepest tissue at rest whose depth is rounded [scene units a pixel]."""


def draw_errors(motion: np.ndarray, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Errors of observed motions, shape [B, SLOTS], and the noise level that each is said to have, [B] [scene units].

    A part of the samples is rounded like 8-bit depth, the others have Gaussian noise. The rest position has an error of
    its own: it is no depth that was rounded once, but comes from a surface through many.
    """
    count = len(motion)
    noise = np.exp(generator.uniform(*np.log(NOISE), size=count))
    rounded = generator.random(count) < ROUNDING_SHARE
    noise[rounded] = ROUNDING_NOISE
    error = noise[:, None] * generator.normal(size=motion.shape)
    depth = motion + generator.uniform(0, LEVEL, (count, 1))
    error[rounded] = (np.rint(depth / LEVEL) * LEVEL - depth)[rounded]
    return error + noise[:, None] * REST_SHARE * generator.normal(size=(count, 1)), noise


def draw_known(loaded: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Which slots are seen, shape [B, SLOTS]: all, those up to one under the tool, or the first few.

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
    """Contacts as they might have been observed, with their likelihood's parabola; B samples."""

    features: np.ndarray
    """What is told of them, shape [B, FEATURES], or with films [B, FEATURES + FILM_FEATURES], float32."""
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
    known = draw_known(loaded, generator) if seen is None else seen(loaded)
    slopes = fits.slopes[index] * (known / noise[:, None])[..., None]
    information = np.einsum("btp,btq->bpq", slopes, slopes)
    pull = np.einsum("btp,bt->bp", slopes, error * known / noise[:, None])
    films = fits.films
    if films is not None:
        told = generator.random(count) < FILM_SHARE
        beside = draw_film_errors(films, index, noise, generator)
        # The contact's own pixel is one of the film's: its error is the film's, and it may show neighbours as well.
        error[told] = (films.middle[index] - motion + beside.middle)[told]
        noise = np.where(told & (noise == ROUNDING_NOISE), ROUNDED * noise, noise)
        more, pulled = film_information(films.slopes[index], films.factors[index], beside.amounts, noise, known)
        information[told], pull[told] = more[told], pulled[told]
    within = fits.within[index]
    along = (motion + error) / spacing[:, None]
    features = join_features(along, known, loaded * known, fits.around[index], spacing, noise)
    if films is not None:
        amounts = (films.amounts[index] + beside.amounts) * known[..., None]
        more = join_film_features(amounts, spacing, noise, within, told)
        features = np.concatenate([features, more], axis=1)
    logs = fits.logs[index]
    information, pull = without_delays(information, pull, logs[:, 3:])
    return Drawn(features, logs[:, :3], information, pull)


@dataclasses.dataclass(frozen=True)
class FilmErrors:
    """Errors of B films."""

    amounts: np.ndarray
    """Of the shapes' amounts, shape [B, SLOTS, SHAPES] [scene units]."""
    middle: np.ndarray
    """Of the middle pixel, shape [B, SLOTS] [scene units]."""


def draw_film_errors(films: Films, index: np.ndarray, noise: np.ndarray, generator: np.random.Generator) -> FilmErrors:
    """Errors of some films: noise, or rounding where the noise is that of rounding, and the rest surface's.

    Args:
        films: all.
        index: which of them, shape [B].
        noise: of every pixel, shape [B] [scene units].
    """
    shapes, factors = dent_shapes(), films.factors[index]
    middle = shapes[len(shapes) // 2]
    # Jointly normal: what the middle pixel's error has beyond the amounts' share of it.
    normal = generator.standard_normal((len(index), SLOTS, SHAPES), dtype=np.float32)
    amounts = (factors @ normal[..., None])[..., 0]
    share = middle @ factors
    rest = np.sqrt(np.maximum(1 - np.square(share).sum(axis=2), 0))
    alone = amounts @ middle + rest * generator.standard_normal(rest.shape, dtype=np.float32)
    amounts, alone = noise[:, None, None] * amounts, noise[:, None] * alone
    rounded = np.flatnonzero(noise == ROUNDING_NOISE)
    if len(rounded):
        change = films.change[index[rounded]].astype(np.float32)
        side = math.isqrt(change.shape[2])
        slopes = generator.uniform(-1, 1, (2, len(rounded), 1)).astype(np.float32) * STEEPEST
        places = np.mgrid[:side, :side].reshape(2, 1, -1)
        depth = (
            change + (np.float32(LEVEL) * generator.random((len(rounded), 1)) + (slopes * places).sum(axis=0))[:, None]
        )
        error = np.nan_to_num(np.rint(depth / np.float32(LEVEL)) * np.float32(LEVEL) - depth)
        part = factors[rounded]
        mixed = (error @ shapes.astype(np.float32))[..., None]
        amounts[rounded] = (part @ (part.transpose(0, 1, 3, 2) @ mixed))[..., 0]
        alone[rounded] = error[:, :, side * side // 2]
    still = noise[:, None] * (generator.standard_normal((len(index), SHAPES)) @ smooth_share().T)
    return FilmErrors(amounts + still[:, None], alone + (still @ middle)[:, None])


@functools.cache
def smooth_share() -> np.ndarray:
    """Factor of the covariance that the rest surface's error has in the shapes' amounts, [SHAPES, SHAPES] [σ]."""
    smooth = dent_shapes().T @ smooth_errors(1.0)
    return np.linalg.cholesky(smooth @ smooth.T + 1e-12 * np.eye(SHAPES))


def film_information(
    slopes: np.ndarray, factors: np.ndarray, errors: np.ndarray, noise: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Information [B, D, D] and pull [B, D] of films, their errors independent but for the rest surface's.

    Args:
        slopes, factors: of `Films`, of B films.
        errors: of the amounts, shape [B, SLOTS, SHAPES] [scene units].
        noise: of every pixel, shape [B] [scene units].
        known: whether a slot is seen, shape [B, SLOTS].
    """
    whiten = np.linalg.inv(factors) * (known / noise[:, None])[..., None, None]
    smooth = noise[:, None, None, None] * smooth_share()
    parts = slopes, errors[..., None], np.broadcast_to(smooth, (*known.shape, SHAPES, SHAPES))
    columns = (whiten @ np.concatenate(parts, axis=-1)).reshape(len(known), -1, slopes.shape[-1] + 1 + SHAPES)
    products = columns.transpose(0, 2, 1) @ columns
    count = slopes.shape[-1]
    still = products[:, -SHAPES:, -SHAPES:] + np.eye(SHAPES)
    common = np.linalg.solve(still, products[:, -SHAPES:, : count + 1])
    left = products[:, :count, : count + 1] - products[:, :count, -SHAPES:] @ common
    information, pull = left[..., :count], left[..., count]
    return information, pull


def without_delays(information: np.ndarray, pull: np.ndarray, delays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information [B, 3, 3] and pull [B, 3] of φ where the delays are unknown within their range.

    Args:
        information, pull: of all parameters, shapes [B, D, D] and [B, D].
        delays: that explain the motions, shape [B, D - 3]; their prior is about 0.
    """
    count = delays.shape[1]
    if not count:
        return information, pull
    prior = 12 / DELAY_RANGE**2
    cross = np.linalg.solve(information[:, 3:, 3:] + prior * np.eye(count), information[:, 3:, :3])
    left = information[:, :3, :3] - np.einsum("bdp,bdq->bpq", information[:, 3:, :3], cross)
    return left, pull[:, :3] - np.einsum("bdp,bd->bp", cross, pull[:, 3:] - prior * delays)
