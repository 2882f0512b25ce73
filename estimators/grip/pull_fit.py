"""A pull explained by a slab of finite elements of given thickness: what holds the grip over E.

The body's shape being known, force over E follows from displacements alone. The grip's way is unknown, as points at
the instrument are followed badly; it is linear in the motion, and solved for at every φ = (log E, log d) in units of a
density (variable projection, Golub & Pereyra 1973), with an affine background in every frame. It is a natural cubic
spline in time which begins at rest: one simulation for each direction in the picture's plane answers for all its bumps,
as these differ in time alone. Errors of points are Student's, and as many err together as of a sheet
(`estimators.grip.sheet`).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import least_squares

from palpate.common.robust import affine_terms, error_scale, student_weights
from palpate.estimators.direct.slab_motion import DENSITY, POISSON, SLAB_BOUNDS
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip.lattice import PIECE, along_last
from palpate.estimators.grip.sheet import LEAST_SCALE, LINK, THIRD, ForceFit, PointGrid, SeenFrame
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.fem import Inertia, Material, simulate
from palpate.physics.fem.slab import Slab
from palpate.physics.identifiability import box_information
from palpate.physics.load import Grip

CELLS = 6, 6, 2
"""Of the slab, along columns, rows and depth, of quadratic elements: linear ones are far too stiff next to the grip."""
KNOTS = 9
"""Of the way, from its beginning to the last instant that is looked at."""
STEPS = 3
"""Of the simulation from one knot to the next."""

_BUMP = BSpline.basis_element(np.arange(5.0), extrapolate=False)
_NATURAL = np.vstack([np.eye(KNOTS - 1), np.eye(KNOTS - 1)[-2:].T @ [-1, 2]])
"""Of the bumps at all knots by the way's numbers, shape [KNOTS, P]: without curvature at its end."""


class PullMotion:
    """Motion of n points in the picture, and what holds the grip, at T instants, by 2P numbers of the grip's way.

    Args:
        slab: the body; its contact is the grip's middle.
        cell: width and height of a grid pixel, shape [2] [px].
        places: the points at rest, within the slab, shape [n, 2] (column, row) [px].
        radius: of the tissue that moves as one with the instrument [grid px].
        times: since rest, rising, shape [T] [s].
    """

    def __init__(self, slab: Slab, cell: np.ndarray, places: np.ndarray, radius: float, times: np.ndarray) -> None:
        self.slab, self._shown = slab, slab.between(((places + 0.5) / cell - 0.5)[:, ::-1])
        rest = self._shown @ slab.solid.rest
        self._scale = cell * slab.focal_lengths / rest[:, 2:]
        self._slopes = rest[:, :2] / rest[:, 2:]
        self.scale = float(self._scale.mean())
        """Of the picture [px/scene unit]."""
        apart = np.hypot(slab.columns[:, None] - slab.place[0], slab.rows - slab.place[1])
        self.gripped = slab.top[apart <= radius]
        """Nodes that move with the instrument, the contact's at least."""
        self.step = float(times[-1]) / (KNOTS * STEPS)
        """Of the simulation [s]."""
        after = np.minimum((times / self.step).astype(int), KNOTS * STEPS - 1)
        self._after, self._share = after, times / self.step - after
        self._latest: tuple[np.ndarray, tuple[np.ndarray, np.ndarray]] | None = None

    def at(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By every number of the way: displacement of points, shape [T, n, 2, 2P], and force over E, [T, 2, 2P].

        The way's numbers are displacements [scene units], those along the picture's two directions taking turns, P =
        KNOTS - 1 of each; points move in px, force over E counts in scene units².

        Args:
            logs: φ, shape [2]. The latest is remembered, as it takes half a second.
        """
        if self._latest is None or not np.array_equal(self._latest[0], logs):
            moved, held = zip(*(self._answer(logs, axis) for axis in (0, 1)), strict=True)
            self._latest = np.array(logs), (self._spline(np.stack(moved, -1)), self._spline(np.stack(held, -1)))
        return self._latest[1]

    def _answer(self, logs: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """Of one bump along an axis of the picture: points [S + 1, n, 2] and force over E [S + 1, 2], S steps."""
        young, damping = np.exp(logs)
        path = np.zeros((KNOTS * STEPS, len(self.gripped), 3))
        path[:, :, axis] = np.nan_to_num(_BUMP(np.arange(1, len(path) + 1) / STEPS))[:, None]
        what = self.slab.solid, Material("linear", young, POISSON), self.slab.held, Grip(self.gripped, path)
        found = simulate(*what, self.step, inertia=Inertia(DENSITY, damping / DENSITY))
        held = found.reaction[:, self.gripped, :2].sum(axis=1) / young
        # Means over the steps to values between them.
        held = np.concatenate([held[:1] / 2, (held[:-1] + held[1:]) / 2, held[-1:]])
        moved = np.stack([self._shown @ nodes for nodes in found.displacement])
        return self._scale * (moved[..., :2] - self._slopes * moved[..., 2:]), held

    def _spline(self, answer: np.ndarray) -> np.ndarray:
        """What a bump does [S + 1, ..., 2], begun at every knot, seen at the instants [T, ..., 2P]."""
        none, steps = np.zeros((1, *answer.shape[1:])), np.arange(len(answer))[:, None]
        late = np.concatenate([none, answer])[np.maximum(steps + 1 - STEPS * np.arange(KNOTS), 0)]
        whole = np.einsum("sk...a,kp->s...pa", late, _NATURAL)
        share = self._share.reshape(-1, *[1] * answer.ndim)
        found = (1 - share) * whole[self._after] + share * whole[self._after + 1]
        return found.reshape(*found.shape[:-2], -1)


DENSE = 48.0
"""Of points that began farther from the tool every third one along both axes counts [px]."""
RADII = 6.0, 10.0, 14.0
"""Of the tissue that moves as one with the instrument, of which the one that explains most is taken [grid px]."""
YOUNG, DAMPING = np.log([100.0, 1000.0]), np.log([3e3, 2e4, 1.5e5])
"""log E and log d among whose pairs a start is looked for."""
TOGETHER = PIECE**2 / THIRD**2
"""So many of the points that count err together."""
INSTANTS = 4.0
"""So many frames err independently: what a slab can't explain stays."""
BENT = 0.5
"""Prior standard deviation of the second differences of the way's numbers over the points' motion."""
LOOKS, ROUNDS, EVALUATIONS = 2, 3, 5
"""Times that points are weighted anew, in so many rounds, and evaluations between."""
DIFFERENCE = 0.1
"""Of φ, for derivatives."""


@dataclass(frozen=True, eq=False)
class PullFit(ForceFit):
    """What a slab tells of a pull; T frames. The force is over E [scene units²]."""

    logs: np.ndarray
    """log E and log d in units of the density, shape [2]."""
    error: float
    """Standard deviation by axis of what the slab does not explain, over the points' motion, root mean square."""


@dataclass(frozen=True, eq=False)
class _Solved:
    """The likeliest way of the grip at some φ; P numbers by axis, n points, T frames."""

    residual: np.ndarray
    """Of points without their affine background, and of the prior, whitened; its squares add up to χ²."""
    squares: np.ndarray
    """Of what is not explained, shape [T, n] [px²]."""
    force: np.ndarray
    """Over E, shape [T, 2] [scene units²]."""
    force_variance: np.ndarray
    """As the way is known, mean of both axes, shape [T]."""


class _Problem:
    """Points within the slab, frame by frame, and how much each counts.

    Args:
        slab: the body.
        cell: width and height of a grid pixel, shape [2] [px].
        grid: the points.
        frames: T of them.
    """

    def __init__(self, slab: Slab, cell: np.ndarray, grid: PointGrid, frames: Sequence[SeenFrame]) -> None:
        points, distance, _, spacing = grid
        cells = np.rint(points / spacing).astype(np.int64)
        low, high = (np.array([slab.columns[end], slab.rows[end]]) * cell for end in (0, -1))
        counted = ((points > low + cell) & (points < high)).all(axis=1)
        counted &= ((distance < DENSE) & (cells.sum(axis=1) % 2 == 0)) | (cells % THIRD == 0).all(axis=1)
        self.places = points[counted].astype(np.float64)
        """Points that count, shape [n, 2] [px]."""
        moved = np.array([frame.moved[counted] for frame in frames])
        self._seen: np.ndarray = np.logical_and.reduce(np.isfinite(moved), axis=-1)
        if not self._seen.any(axis=1).all():
            raise NoEstimate("No followed point lies on the slab; choose a place where tissue is seen.")
        self._moved = np.where(self._seen[..., None], moved, 0.0)
        self._given = np.square(np.maximum([frame.noise[counted] for frame in frames], LINK))
        self._terms = affine_terms(self.places)
        self.size = float(np.sqrt(np.square(moved[-1][self._seen[-1]]).sum(axis=-1).mean()))
        """Of the points' motion in the last frame, root mean square [px]."""
        self.scale = float(self._given.min())
        """Of errors besides the given noise, variance by axis [px²]."""
        self._weights: np.ndarray = self._seen.astype(np.float64)

    def solve(self, motion: PullMotion, logs: np.ndarray) -> _Solved:
        """The likeliest way and background, as the points count by now."""
        answer, held = motion.at(logs)
        root = np.sqrt(self._weights / (self._given + self.scale) * INSTANTS / TOGETHER / len(answer))
        rows, right = [], []
        for columns, seen, weight in zip(answer, self._moved, root, strict=True):
            # What the background could do as well tells nothing.
            basis = np.linalg.qr(self._terms * weight[:, None])[0]
            whole = np.concatenate([columns, seen[..., None]], axis=-1) * weight[:, None, None]
            whole -= np.einsum("nk,kap->nap", basis, np.einsum("nk,nap->kap", basis, whole))
            rows.append(whole[..., :-1])
            right.append(whole[..., -1])
        design, wanted = np.stack(rows), np.stack(right)
        bends = np.kron(np.diff(np.eye(answer.shape[-1] // 2), n=2, axis=0), np.eye(2))
        bends *= motion.scale / (BENT * self.size)
        flat = design.reshape(-1, design.shape[-1])
        factor = cho_factor(flat.T @ flat + bends.T @ bends)
        way = cho_solve(factor, flat.T @ wanted.ravel())
        off = design @ way - wanted
        squares = np.square(off).sum(axis=-1) / np.maximum(np.square(root), np.finfo(float).tiny)
        spread = cho_solve(factor, held.reshape(-1, len(way)).T).T.reshape(held.shape)
        residual, variance = np.concatenate([off.ravel(), bends @ way]), (held * spread).sum(axis=(1, 2)) / 2
        return _Solved(residual, np.where(self._seen, squares, 0.0), held @ way, variance)

    def look(self, motion: PullMotion, logs: np.ndarray) -> None:
        """Weight the points anew by how far they lie from the slab, and find the size of their errors."""
        for _ in range(ROUNDS):
            squares = self.solve(motion, logs).squares
            given, seen = self._given[self._seen], squares[self._seen]
            self.scale = error_scale(seen, given, self._weights[self._seen], self.scale, LEAST_SCALE)
            self._weights[self._seen] = student_weights(seen, given + self.scale)


def fit_pull(slab: Slab, cell: np.ndarray, grid: PointGrid, times: np.ndarray, frames: Sequence[SeenFrame]) -> PullFit:
    """Fit a slab to some frames of a grip.

    Args:
        slab: the tissue, its contact where the instrument holds it.
        cell: width and height of a grid pixel, shape [2] [px].
        grid: the points.
        times: of the frames since rest, rising, shape [T] [s].
        frames: T of them.

    Raises:
        NoEstimate: no point is visible on the slab.
    """
    problem = _Problem(slab, cell, grid, frames)
    motions = [PullMotion(slab, cell, problem.places, radius, times) for radius in RADII]
    box = SLAB_BOUNDS.log_box[:, :2]
    middle = box.mean(axis=0)

    def misfit(motion: PullMotion, logs: np.ndarray) -> float:
        return float(np.square(problem.solve(motion, logs).residual).sum())

    problem.look(motions[1], middle)
    motion = min(motions, key=lambda item: misfit(item, middle))
    logs = min(map(np.array, itertools.product(YOUNG, DAMPING)), key=lambda item: misfit(motion, item))
    for _ in range(LOOKS):
        problem.look(motion, logs)
        how = {"bounds": box, "diff_step": DIFFERENCE / np.abs(logs), "max_nfev": EVALUATIONS}
        found = least_squares(lambda tried: problem.solve(motion, tried).residual, logs, **how)
        logs = found.x
    information = found.jac.T @ found.jac + box_information(box)
    return _concluded(problem, motion, logs, np.linalg.inv(information))


def _concluded(problem: _Problem, motion: PullMotion, logs: np.ndarray, covariance: np.ndarray) -> PullFit:
    """What a fit at φ [2], known with a covariance [2, 2], says of the force."""
    here = problem.solve(motion, logs)
    length, along, _ = along_last(here.force)
    nearby = [along_last(problem.solve(motion, logs + step).force) for step in DIFFERENCE * np.eye(2)]
    slopes = np.array([[np.log(more / length), *(ratios - along)] for more, ratios, _ in nearby]) / DIFFERENCE
    spread = np.einsum("pt,pq,qt->t", slopes, covariance, slopes)
    variance = here.force_variance / length**2
    relative = variance + along**2 * variance[-1] + spread[1:] + np.square(MODEL_ERRORS.pull_course * along)
    # The last frame's ratio is 1 by definition.
    relative[-1] = 0.0
    sd = float(np.sqrt(variance[-1] + spread[0] + MODEL_ERRORS.pull_force**2))
    error = float(np.sqrt(problem.scale) / problem.size)
    return PullFit(float(np.log(length)), sd, along, np.sqrt(relative), logs, error)
