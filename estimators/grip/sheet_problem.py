"""Frames of a gripped endless sheet at one foundation: which loads and background explain its points, and how well.

Unknown are the forces on every place at the instrument, also on tissue that it hides; an endless sheet
(`physics.endless_sheet`) answers these, and an affine background moves on its own. Errors of points are Student's,
whose scale is found in every frame: a sheet is not tissue. Neighbours' errors are alike (`estimators.grip.whitening`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.sparse import csr_array

from estimators.grip.alike import correlated_points
from estimators.grip.lattice import KNOT
from estimators.grip.whitening import REACH, Whitening, alike_points
from physics.endless_sheet import response

LOADED = 32.0
"""Forces act on tissue that began nearer to the tool [px]."""
DENSE, THIRD = 64.0, 3
"""Of points that began farther from the tool every third one along both axes counts: neighbours err alike."""
SIZE = 512
"""Of the repeated piece of the endless sheet [nodes]."""
ENERGY, FREE = 300.0, 3000.0
"""Prior scale of the work that the forces do, a number of them [px² · stiffness]: at a node alone 10 px. The sum of the
forces hangs on it where an instrument hides tissue. The foundation is told with ten times as much: strong pulls, which
are expected less, would pass for a softer attachment."""
FREEDOM = 3.0
"""Of Student's distribution, in the plane."""
UNTOLD = 1e-6
"""Of the loads' independent numbers those count that move points by more than so much, as far as they are expected
[px²]: no link tells of others."""
LINK = 0.05
"""Least standard deviation of a point by axis [px]."""
ALIKE = KNOT**2 / THIRD**2
"""So many points are taken to err alike where they are weighted: what a sheet can't explain is smooth over a knot's
cell."""
ROUNDS, AGAIN, CONVERGED = 15, 4, 1e-3
"""Of weighting the points anew: at most, where near values are solved, and the change of weights that ends them."""
SCALED = 10
"""Steps to the errors' scale."""
MOST_LOADED = 400
"""More places with a force take minutes, and leave too much free."""
TINY = 1e-9
"""Of the largest: added to a diagonal so that rounding doesn't make it indefinite."""


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """Followed points of one frame; N points."""

    moved: np.ndarray
    """Displacement since rest, shape [N, 2] [px]; not a number where a point is lost."""
    noise: np.ndarray
    """Its standard deviation by axis, shape [N] [px]."""


@dataclass(eq=False)
class Solved:
    """One frame at one foundation; M places that are loaded."""

    loss: float
    """Negative log of the density, of all unknowns at their likeliest."""
    unknowns: np.ndarray
    """Loads [stiffness × px] and the background's motion, shape [M + 3, 2]."""
    weights: np.ndarray
    """Of the points that count, 0 for those not seen."""
    scale: float
    """Of the errors besides the told noise, variance by axis [px²]."""


class Design(NamedTuple):
    """How n points follow K independent numbers for the loads and 3 for the background, at one foundation."""

    rows: np.ndarray
    """Motion for a unit of each, shape [n, K + 3]."""
    precision: np.ndarray
    """Prior precision of these, shape [K + 3]."""
    loads: np.ndarray
    """Loads on the M places for a unit of the numbers, shape [M, K]."""
    untold: float
    """Variance by axis of the sum of the loads that no point tells [stiffness² × px²]."""


class Whitened(NamedTuple):
    """Of the n points that count in a frame; rows of those not seen are 0."""

    transform: csr_array
    """What makes their errors independent and of size 1, shape [n, n]."""
    moved: np.ndarray
    """Their motion then, shape [n, 2]."""


class Profile(NamedTuple):
    """One frame at one foundation, by whitened motion."""

    loss: float
    """Negative log of the density, of all other unknowns at their likeliest."""
    force: np.ndarray
    """Sum of the loads, shape [2]."""
    variance: float
    """Of that, by axis."""


def loaded_cells(points: np.ndarray, distance: np.ndarray, hidden: np.ndarray, spacing: int) -> np.ndarray:
    """Places of the grid on which forces may act, as numbers of its columns and rows, shape [M, 2].

    Every other one of those near the tool, as on a chessboard: the field around them is as free, at an eighth of the
    work. Under a long shaft half of these. Arguments as of `fit_foundation`.
    """
    loaded = np.rint(np.concatenate([points[distance < LOADED], hidden]) / spacing).astype(np.int64)
    half = loaded[loaded.sum(axis=1) % 2 == 0]
    return half if len(half) <= MOST_LOADED else half[half[:, 0] % 2 == 0]


def load_precision(answer: np.ndarray, loaded: np.ndarray, energy: float = ENERGY) -> np.ndarray:
    """Prior precision of loads on places [M, 2] and of the background's three numbers, shape [M + 3, M + 3].

    Args:
        answer: of the sheet, as `physics.endless_sheet.response` gives it.
        loaded: as of `loaded_cells`.
        energy: expected work of a load [px² · stiffness].
    """
    count = len(loaded)
    precision = np.zeros((count + 3, count + 3))
    own = answer[tuple(np.moveaxis(loaded[:, None] - loaded, -1, 0) % SIZE)] / energy
    precision[:count, :count] = own + TINY * own.max() * np.eye(count)
    return precision


class SheetProblem:
    """What the frames have in common.

    Args:
        points: at rest, shape [N, 2] [px].
        distance: from the tool there, shape [N] [px].
        hidden: places of the grid that the tool hides, shape [H, 2] [px].
        spacing: of the grid [px].
        reach: of the correlation between neighbours' errors [px].
    """

    def __init__(
        self, points: np.ndarray, distance: np.ndarray, hidden: np.ndarray, spacing: int, reach: float = REACH
    ) -> None:
        cells = np.rint(points / spacing).astype(np.int64)
        self.counted = np.flatnonzero((distance < DENSE) | (cells % THIRD == 0).all(axis=1))
        """Points that count, shape [n]."""
        self._points, self._spacing = points, spacing
        self._loaded_cells = loaded_cells(points, distance, hidden, spacing)
        self._middle, self._size = points.mean(axis=0), points.std(axis=0)
        self.loaded = len(self._loaded_cells)
        self._whitening = Whitening(points[self.counted], reach)
        self._expected = max(alike_points(spacing, reach), 1.0)

    def _following(self, answer: np.ndarray, places: np.ndarray) -> np.ndarray:
        """How places of the grid [n, 2] [px] follow loads and background, shape [n, M + 3]."""
        cells = np.rint(places / self._spacing).astype(np.int64)
        apart = np.moveaxis(cells[:, None] - self._loaded_cells, -1, 0) % SIZE
        return np.hstack([answer[tuple(apart)], (places - self._middle) / self._size, np.ones((len(places), 1))])

    def design(self, log_anchor: float, energy: float = FREE) -> Design:
        """How the points that count follow what is unknown.

        Few combinations of loads under an instrument can be told apart: those of the prior's independent numbers that
        move the points, by the eigenvectors of what these say.
        """
        answer = response(float(np.exp(log_anchor)), SIZE)
        rows = self._following(answer, self._points[self.counted])
        prior = load_precision(answer, self._loaded_cells, energy)[: self.loaded, : self.loaded]
        triangle = cholesky(prior, check_finite=False)
        by_number = solve_triangular(triangle, rows[:, : self.loaded].T, trans=1, check_finite=False).T
        told, vectors = np.linalg.eigh(by_number.T @ by_number)
        loads = solve_triangular(triangle, vectors, check_finite=False)
        kept = told > UNTOLD
        return Design(
            np.hstack([rows[:, : self.loaded] @ loads[:, kept], rows[:, self.loaded :]]),
            np.append(np.ones(int(kept.sum())), np.zeros(3)),
            loads[:, kept],
            float(np.square(loads[:, ~kept].sum(axis=0)).sum()),
        )

    def solve(self, design: Design, frame: SeenFrame, start: Solved | None = None) -> Solved:
        """The likeliest loads, background and size of errors, by weighting the points anew.

        Args:
            design: of the foundation.
            frame: what is seen.
            start: from which to begin.
        """
        seen = np.flatnonzero(np.isfinite(frame.moved[self.counted]).all(axis=1))
        told = np.square(np.maximum(frame.noise[self.counted][seen], LINK))
        rows, moved = design.rows[seen], frame.moved[self.counted][seen]
        scale = 0.0 if start is None else start.scale
        weights = np.ones(len(told)) if start is None else start.weights[seen]
        for _ in range(ROUNDS if start is None else AGAIN):
            before = weights
            root = np.sqrt(weights / (told + scale) / ALIKE)[:, None]
            factor = _factor(rows * root, design.precision)
            found = cho_solve(factor, (rows * root).T @ (moved * root), check_finite=False)
            squares = np.square(moved - rows @ found).sum(axis=1)
            scale = error_scale(squares, told, weights, scale)
            weights = (FREEDOM + 2) / (FREEDOM + squares / (told + scale))
            if np.abs(weights - before).max() < CONVERGED:
                break
        variance = told + scale
        density = (FREEDOM + 2) / 2 * np.log1p(squares / variance / FREEDOM) + np.log(variance)
        whole = np.zeros(len(self.counted))
        whole[seen] = weights
        return Solved(
            float(density.sum() / ALIKE + 0.5 * design.precision @ np.square(found).sum(axis=1)),
            np.vstack([design.loads @ found[:-3], found[-3:]]),
            whole,
            scale,
        )

    def whitened(self, frame: SeenFrame, solved: Solved) -> Whitened:
        """What makes errors of a frame independent and of size 1."""
        told = np.square(np.maximum(frame.noise[self.counted], LINK)) + solved.scale
        sizes = np.sqrt(told / np.where(solved.weights > 0, solved.weights, np.nan))
        transform = self._whitening.transform(sizes)
        return Whitened(transform, transform @ np.where(solved.weights[:, None] > 0, frame.moved[self.counted], 0.0))

    def profile(self, design: Design, seen: Whitened) -> Profile:
        """All but the foundation at its likeliest."""
        rows = seen.transform @ design.rows
        factor = _factor(rows, design.precision)
        found = cho_solve(factor, rows.T @ seen.moved, check_finite=False)
        left = seen.moved - rows @ found
        total = np.append(design.loads.sum(axis=0), np.zeros(3))
        return Profile(
            0.5 * float((left * seen.moved).sum()),
            total @ found,
            float(total @ cho_solve(factor, total, check_finite=False)) + design.untold,
        )

    def motion(self, log_anchor: float, solved: Solved, places: np.ndarray) -> np.ndarray:
        """Where a sheet says that places of the grid go, shape as of the places […, 2] [px]."""
        following = self._following(response(float(np.exp(log_anchor)), SIZE), places.reshape(-1, 2))
        return (following @ solved.unknowns).reshape(places.shape)

    def left(self, log_anchor: float, frame: SeenFrame, solved: Solved) -> np.ndarray:
        """What is not explained over its told size, of all points, shape [N, 2]; outliers count little."""
        off = frame.moved - self.motion(log_anchor, solved, self._points)
        variance = np.square(np.maximum(frame.noise, LINK)) + solved.scale
        weights = (FREEDOM + 2) / (FREEDOM + np.square(off).sum(axis=1) / variance)
        return off * np.sqrt(weights / variance)[:, None]

    def wider(self, left: np.ndarray) -> float:
        """By which factor variances grow if more points err alike than was taken for granted, 1 or more."""
        return max(correlated_points(self._points, self._spacing, left) / self._expected, 1.0)


def _factor(rows: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, bool]:
    """Cholesky's, of the information of rows [n, P] and a prior precision [P]."""
    information = rows.T @ rows
    information[np.diag_indices_from(information)] += precision
    return cho_factor(information, overwrite_a=True, check_finite=False)


def error_scale(squares: np.ndarray, told: np.ndarray, weights: np.ndarray, scale: float) -> float:
    """Likeliest variance by axis of weighted errors besides the told one, from a value on [px²].

    Args:
        squares: squared lengths of errors in the plane, shape [n] [px²].
        told: variances by axis, shape [n] [px²].
        weights: shape [n].
        scale: the value so far.
    """
    found = max(scale, float(told.min()))
    for _ in range(SCALED):
        variance = told + found
        found *= float(np.sqrt((weights * squares / (2 * variance**2)).sum() / (1 / variance).sum()))
    return found if found > LINK**2 / 100 else 0.0
