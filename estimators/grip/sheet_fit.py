"""How stiff gripped tissue is, and how firmly it is attached, as far as the motion around the grip tells.

The tissue at the instrument is a prescribed displacement, the other points are the observation, and a quasi-static
sheet on a foundation (`physics.sheet`) explains them. Only the ratio of foundation to spring stiffness is determined,
as a number or as two fields over coarse knots with a smoothness prior; how smooth is decided by the last frames of
those that are fitted, which the other ones predict. So is how far predictions are off: a sheet is not tissue, and its
error is hundreds of times that of following points.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import csr_array

from estimators.grip.lattice import KNOT, Fields, knotted, lattice_springs, uniform
from physics.sheet import Equilibrium, equilibrium

ROUGHNESS = (1.0, 3.0, 10.0)
"""Candidates of the standard deviation between neighbouring knots; besides them one number for all."""
MOST_FRAMES = 8
"""So many frames, evenly spread, are fitted: the motion grows steadily, and its neighbours say the same."""
LEAST_MOTION = 1.0
"""Root mean square below which a frame shows no motion [px]."""
LEAST_FRAMES = 3
"""Fewer frames that move can't be fitted and checked."""
LEAST_GRIPPED, LEAST_AROUND = 20, 50
"""Fewer points at the instrument, or around it, are too few."""
STEPS = 60
"""Of the optimiser."""
LARGEST = 20.0
"""Numbers stay so near to their prior mean, where exponentials are finite."""
DRAWS = 32
"""Of the posterior, for the force's standard deviation."""
TINY = 1e-12
"""Added to a covariance's diagonal so that rounding doesn't make it indefinite."""
RADIUS = 2.1459660262893474
"""Standard deviations of a two-dimensional normal distribution that hold 90 % of it, √(-2 log 0.1)."""


class NothingMoves(ValueError):
    """There is no motion that a sheet could be fitted to; the message is a sentence that says why."""


@dataclass(frozen=True, eq=False)
class GripFrame:
    """One frame of a grip; N points."""

    moved: np.ndarray
    """Displacement since rest, shape [N, 2] [px]; not a number where a point is lost."""
    gripped: np.ndarray
    """Which points move with the instrument, shape [N], bool; all of them seen."""

    @property
    def around(self) -> np.ndarray:
        """The other points that are seen, shape [N], bool."""
        return np.isfinite(self.moved).all(axis=1) & ~self.gripped

    @property
    def pull(self) -> float:
        """Root mean square displacement of the grip [px]."""
        return length(self.moved[self.gripped])

    @property
    def tells(self) -> bool:
        """Whether there is enough to fit, and both grip and tissue move."""
        around = self.around
        enough = self.gripped.sum() >= LEAST_GRIPPED and around.sum() >= LEAST_AROUND
        return bool(enough) and min(self.pull, length(self.moved[around])) > LEAST_MOTION


@dataclass(frozen=True, eq=False)
class SheetFit:
    """A fitted sheet; N nodes, P numbers."""

    springs: np.ndarray
    """Shape [S, 2]."""
    fields: Fields
    """What the numbers mean."""
    numbers: np.ndarray
    """Likeliest ones, shape [P]."""
    covariance: np.ndarray
    """Theirs, shape [P, P]."""
    roughness: float
    """Chosen standard deviation between neighbouring knots; 0 = one number for all."""
    error: tuple[float, float]
    """Standard deviation by axis of predictions, as a share of the grip's motion and of a point's own: the sheet is
    linear, so that its error grows with the pull. Measured on frames that were not fitted."""

    @property
    def log_stiffness(self) -> tuple[np.ndarray, np.ndarray]:
        """Of every node relative to the mean, and its standard deviation, shape [N] each."""
        return self._field(self.fields.stiffness)

    @property
    def log_anchor(self) -> tuple[np.ndarray, np.ndarray]:
        """Foundation over the stiffness of the springs there of every node, and its standard deviation, shape [N] each.

        Motion dies away over √(3/it) spacings of the points: with diagonals every node has springs worth three.
        """
        return self._field(self.fields.anchor - self.fields.stiffness)

    def _field(self, basis: csr_array) -> tuple[np.ndarray, np.ndarray]:
        spread = ((basis @ self.covariance) * basis.toarray()).sum(axis=1)
        return basis @ self.numbers, np.sqrt(np.maximum(spread, 0))

    @property
    def mean_log_anchor(self) -> tuple[float, float]:
        """Mean of `log_anchor` over all nodes, and its standard deviation."""
        row = (self.fields.anchor - self.fields.stiffness).mean(axis=0)
        return float(row @ self.numbers), float(np.sqrt(max(row @ self.covariance @ row, 0.0)))

    def predict(self, frame: GripFrame) -> tuple[np.ndarray, np.ndarray]:
        """Displacement of every node [N, 2] where the grip is, and its standard deviation by axis [N] [px]."""
        moved = solve(self.springs, self.fields, self.numbers, frame).displacement
        grip, own = self.error
        return moved, np.sqrt(grip**2 * frame.pull**2 + own**2 * np.square(moved).sum(axis=1))

    def relative_force(self, frames: Sequence[GripFrame]) -> tuple[np.ndarray, np.ndarray]:
        """What holds the gripped tissue in every frame over what holds it in the last, and its standard deviation.

        Along the last one's direction, shape [T] each, of the points that are seen in all of them; not a number where
        these are too few. What the sheet leaves of the motion counts as its share of the force, in between rest and the
        last frame, where the ratio is 0 and 1 whatever the tissue.
        """
        same = np.logical_and.reduce([frame.gripped for frame in frames])
        if same.sum() < LEAST_GRIPPED:
            return np.full(len(frames), np.nan), np.full(len(frames), np.nan)
        frames = [dataclasses.replace(frame, gripped=same) for frame in frames]
        factor = np.linalg.cholesky(self.covariance + TINY * np.eye(len(self.numbers)))
        random = np.random.default_rng(0).standard_normal((DRAWS, len(self.numbers)))
        if len(self.numbers) == 1:
            random = np.array([[1.0], [-1.0]])  # which have its standard deviation, and are fewer
        drawn = [_along_last(_forces(self, self.numbers + factor @ row, frames))[0] for row in random]
        ratio, across = _along_last(_forces(self, self.numbers, frames))
        left = self.error[1] * np.hypot(ratio * (1 - ratio), across)
        return ratio, np.hypot(np.std(drawn, axis=0), left)


def _forces(fit: SheetFit, numbers: np.ndarray, frames: Sequence[GripFrame]) -> np.ndarray:
    """What holds the gripped tissue in every frame, shape [T, 2] [unit of stiffness × px]."""
    return np.array([solve(fit.springs, fit.fields, numbers, frame).reaction.sum(axis=0) for frame in frames])


def _along_last(forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces [T, 2] along the last one, and across it, over its length, shape [T] each."""
    last = forces[-1] / (forces[-1] @ forces[-1])
    return forces @ last, forces @ np.array([-last[1], last[0]])


def fit_sheet(points: np.ndarray, spacing: int, frames: Sequence[GripFrame], field: bool = True) -> SheetFit:
    """Fit a sheet to some frames of a grip, in their order in time.

    Args:
        points: places at rest, on a square grid, shape [N, 2] [px].
        spacing: of the grid [px].
        frames: of which those that show no motion don't count.
        field: whether stiffness and foundation may vary over the sheet; else one number explains all.

    Raises:
        NothingMoves: fewer than LEAST_FRAMES frames move, or too few points are seen.
    """
    moving = [frame for frame in frames if frame.tells]
    if len(moving) < LEAST_FRAMES:
        raise NothingMoves(
            f"In {len(moving)} of {len(frames)} frames the tissue moves by more than {LEAST_MOTION:g} px, with "
            f"{LEAST_GRIPPED} points seen at the instrument and {LEAST_AROUND} around it; {LEAST_FRAMES} are needed."
        )
    springs = lattice_springs(points, spacing)
    later = len(moving) // 2
    early, late = _spread(moving[:-later]), moving[-later:]
    plain = uniform(len(points))
    candidates = {0.0: plain} | ({rough: knotted(points, spacing, rough) for rough in ROUGHNESS} if field else {})
    found: dict[float, np.ndarray] = {}
    for rough, fields in candidates.items():
        start = _started(fields, found[0.0][0] if found else float(plain.mean[0]))
        found[rough] = _likeliest(springs, fields, early, start)
    errors = {rough: _relative_error(springs, candidates[rough], found[rough], late) for rough in found}
    best = min(errors, key=lambda rough: errors[rough])
    fields = candidates[best]
    error = _discrepancy(springs, fields, found[best], late)
    used = _spread(moving)
    numbers = _likeliest(springs, fields, used, found[best])
    return SheetFit(springs, fields, numbers, _covariance(springs, fields, numbers, used), best, error)


def skill(fit: SheetFit, frame: GripFrame) -> float:
    """1 - error / motion of the points around the grip, root mean squares: 0 as if nothing moved, 1 = exact."""
    off = solve(fit.springs, fit.fields, fit.numbers, frame).displacement - frame.moved
    return 1 - length(off[frame.around]) / length(frame.moved[frame.around])


def length(vectors: np.ndarray) -> float:
    """Root mean square length of vectors [N, 2]."""
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean()))


def solve(springs: np.ndarray, fields: Fields, numbers: np.ndarray, frame: GripFrame) -> Equilibrium:
    """The sheet at rest under a frame's grip."""
    stiffness, anchor = _moduli(springs, fields, numbers)
    return equilibrium(springs, stiffness, anchor, frame.gripped, frame.moved[frame.gripped])


def _moduli(springs: np.ndarray, fields: Fields, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness of every spring [S], the geometric mean of its ends', and every node's foundation [N]."""
    log = fields.stiffness @ numbers
    return np.exp((log[springs[:, 0]] + log[springs[:, 1]]) / 2), np.exp(fields.anchor @ numbers)


def _started(fields: Fields, log_anchor: float) -> np.ndarray:
    """Numbers of a sheet that is the same everywhere."""
    return np.where(fields.mean == 0, 0.0, log_anchor)


def _spread(frames: Sequence[GripFrame]) -> list[GripFrame]:
    """At most MOST_FRAMES of them, evenly spread, the last one included."""
    places = np.linspace(0, len(frames), min(MOST_FRAMES, len(frames)) + 1)[1:].round().astype(int) - 1
    return [frames[place] for place in places]


def _independent(count: int) -> float:
    """How many independent numbers the errors of so many points are worth: two a knot's cell.

    What a sheet can't explain is alike over distances that its knots don't resolve.
    """
    return 2 * count / KNOT**2


def _likeliest(springs: np.ndarray, fields: Fields, frames: Sequence[GripFrame], start: np.ndarray) -> np.ndarray:
    """Numbers of highest posterior density, the error's size unknown in every frame."""
    ends = (fields.stiffness[springs[:, 0]] + fields.stiffness[springs[:, 1]]) / 2

    def loss(numbers: np.ndarray) -> tuple[float, np.ndarray]:
        off = numbers - fields.mean
        value, gradient = 0.5 * off @ fields.precision @ off, fields.precision @ off
        stiffness, anchor = _moduli(springs, fields, numbers)
        for frame in frames:
            found = equilibrium(springs, stiffness, anchor, frame.gripped, frame.moved[frame.gripped])
            around = frame.around
            error = np.where(around[:, None], found.displacement - frame.moved, 0.0)
            size, worth = float(np.square(error).sum()), _independent(int(around.sum())) / len(frames)
            value += 0.5 * worth * np.log(size)
            by_stiffness, by_anchor = found.gradient(worth / size * error)
            gradient = gradient + ends.T @ (by_stiffness * stiffness) + fields.anchor.T @ (by_anchor * anchor)
        return value, gradient

    limits = np.column_stack([fields.mean - LARGEST, fields.mean + LARGEST])
    return minimize(loss, start, jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": STEPS}).x


def _covariance(springs: np.ndarray, fields: Fields, numbers: np.ndarray, frames: Sequence[GripFrame]) -> np.ndarray:
    """Of the numbers at their likeliest, by Gauss and Newton's Hessian, shape [P, P]."""
    precision = fields.precision.copy()
    for frame in frames:
        found = solve(springs, fields, numbers, frame)
        around = frame.around
        slopes = _slopes(springs, fields, numbers, found)[around].reshape(2 * int(around.sum()), -1)
        size = float(np.square(found.displacement - frame.moved)[around].sum())
        precision += _independent(int(around.sum())) / len(frames) / size * (slopes.T @ slopes)
    return np.linalg.inv(precision)


def _slopes(springs: np.ndarray, fields: Fields, numbers: np.ndarray, found: Equilibrium) -> np.ndarray:
    """Derivatives of the displacement by the numbers, shape [N, 2, P]."""
    stiffness, anchor = _moduli(springs, fields, numbers)
    ends = (fields.stiffness[springs[:, 0]] + fields.stiffness[springs[:, 1]]) / 2
    return found.slopes(ends.toarray() * stiffness[:, None], fields.anchor.toarray() * anchor[:, None])


def _errors(
    springs: np.ndarray, fields: Fields, numbers: np.ndarray, frame: GripFrame
) -> tuple[np.ndarray, np.ndarray]:
    """Squared error and squared predicted motion of the points around the grip, shape [n] each [px²]."""
    found, around = solve(springs, fields, numbers, frame).displacement, frame.around
    return np.square(found - frame.moved)[around].sum(axis=1), np.square(found[around]).sum(axis=1)


def _relative_error(springs: np.ndarray, fields: Fields, numbers: np.ndarray, frames: Sequence[GripFrame]) -> float:
    """Mean square of error over motion."""
    found = [
        _errors(springs, fields, numbers, frame)[0].mean() / length(frame.moved[frame.around]) ** 2 for frame in frames
    ]
    return float(np.mean(found))


def _discrepancy(
    springs: np.ndarray, fields: Fields, numbers: np.ndarray, frames: Sequence[GripFrame]
) -> tuple[float, float]:
    """Shares of errors with standard deviation √((share · grip's motion)² + (share · own motion)²), by axis.

    Their ratio is the likeliest one of normal errors; their size is such that 90 % discs hold 90 % of the points.
    """
    pairs = [_errors(springs, fields, numbers, frame) for frame in frames]
    error, motion = (np.concatenate(part) for part in zip(*pairs, strict=True))
    pull = np.repeat([frame.pull**2 for frame in frames], [len(part) for part, _ in pairs])

    def loss(logs: np.ndarray) -> float:
        variance = np.exp(2 * logs[0]) * pull + np.exp(2 * logs[1]) * motion
        return float((np.log(variance) + error / (2 * variance)).mean())

    start = 0.5 * np.log([error.mean() / pull.mean() / 4, error.mean() / motion.mean() / 4])
    grip, own = np.exp(minimize(loss, start, method="Nelder-Mead").x)
    scale = np.quantile(np.sqrt(error / (grip**2 * pull + own**2 * motion)), 0.9) / RADIUS
    return float(grip * scale), float(own * scale)
