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

from estimators.grip.lattice import KNOT, Fields, continued, knotted, lattice_springs, uniform
from physics.sheet import Equilibrium, equilibrium

ROUGHNESS = (1.0, 3.0, 10.0)
"""Candidates of the standard deviation between neighbouring knots; besides them one number for all."""
BEYOND = 5
"""How far a sheet of one number goes on beyond the points, in their spacings; fields, untold there, end with them."""
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
HIDDEN = 0.1
"""Relative standard deviation of the force on the foundation of tissue that is not seen."""
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
    carried: np.ndarray | None = None
    """Part of it that a camera's motion is known to do, shape [N, 2] [px]; None = none. The sheet explains the rest."""
    astray: float | None = None
    """How far off that is, root mean square, where it can be told [px]; None where nothing is carried."""

    @property
    def own(self) -> np.ndarray:
        """Displacement besides that, shape [N, 2] [px]."""
        return self.moved if self.carried is None else self.moved - self.carried

    @property
    def around(self) -> np.ndarray:
        """The other points that are seen, shape [N], bool."""
        return np.isfinite(self.moved).all(axis=1) & ~self.gripped

    @property
    def pull(self) -> float:
        """Root mean square displacement of the grip [px]."""
        return length(self.moved[self.gripped])

    @property
    def reach(self) -> float:
        """What a prediction's error grows with besides a point's own motion: `astray`, or else the pull [px]."""
        return self.pull if self.astray is None else self.astray

    @property
    def tells(self) -> bool:
        """Whether there is enough to fit, and both grip and tissue move."""
        around = self.around
        enough = self.gripped.sum() >= LEAST_GRIPPED and around.sum() >= LEAST_AROUND
        return bool(enough) and min(self.pull, length(self.moved[around])) > LEAST_MOTION


@dataclass(frozen=True, eq=False)
class SheetFit:
    """A fitted sheet; N points, P numbers."""

    count: int
    """N. The sheet's first nodes are the points, those behind them are not seen."""
    springs: np.ndarray
    """Pairs of nodes, shape [S, 2]."""
    fields: Fields
    """What the numbers mean."""
    numbers: np.ndarray
    """Likeliest ones, shape [P]."""
    covariance: np.ndarray
    """Theirs, shape [P, P]."""
    roughness: float
    """Chosen standard deviation between neighbouring knots; 0 = one number for all."""
    terms: np.ndarray | None
    """Of the background's affine motion at every point, shape [N, 3]; None where it is at rest."""
    error: tuple[float, float]
    """Standard deviation by axis of predictions, as a share of the frame's reach and of a point's own motion: the sheet
    is linear, so that its error grows with the pull. Measured on frames that were not fitted."""

    @property
    def log_stiffness(self) -> tuple[np.ndarray, np.ndarray]:
        """At every point relative to the mean, and its standard deviation, shape [N] each."""
        return self._field(self.fields.stiffness[: self.count])

    @property
    def log_anchor(self) -> tuple[np.ndarray, np.ndarray]:
        """Foundation over the stiffness of the springs at every point, and its standard deviation, shape [N] each.

        Motion dies away over √(3/it) spacings of the points: with diagonals every node has springs worth three.
        """
        return self._field((self.fields.anchor - self.fields.stiffness)[: self.count])

    def _field(self, basis: csr_array) -> tuple[np.ndarray, np.ndarray]:
        spread = ((basis @ self.covariance) * basis.toarray()).sum(axis=1)
        return basis @ self.numbers, np.sqrt(np.maximum(spread, 0))

    @property
    def mean_log_anchor(self) -> tuple[float, float]:
        """Mean of `log_anchor` over all points, and its standard deviation."""
        row = (self.fields.anchor - self.fields.stiffness)[: self.count].mean(axis=0)
        return float(row @ self.numbers), float(np.sqrt(max(row @ self.covariance @ row, 0.0)))

    def predict(self, frame: GripFrame) -> tuple[np.ndarray, np.ndarray]:
        """Displacement of every point [N, 2] with grip and camera, and its standard deviation [N] [px].

        Without that of a background which was found with the sheet.
        """
        moved = self.explained(frame)[0].displacement[: self.count]
        moved = moved if frame.carried is None else moved + frame.carried
        grip, own = self.error
        return moved, np.sqrt(grip**2 * frame.reach**2 + own**2 * np.square(moved).sum(axis=1))

    def explained(self, frame: GripFrame) -> tuple[Equilibrium, np.ndarray]:
        """The sheet at rest under a frame's grip, and how far the background carries every point, shape [N, 2] [px]."""
        return solve(self.springs, self.fields, self.numbers, frame, self.terms)

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
        drawn = [_along_last(_forces(self, numbers, frames))[0] for numbers in self._draws()]
        ratio, across = _along_last(_forces(self, self.numbers, frames))
        left = self.error[1] * np.hypot(ratio * (1 - ratio), across)
        return ratio, np.hypot(np.std(drawn, axis=0), left)

    def log_force(self, frame: GripFrame) -> tuple[float, float]:
        """Log of what holds the gripped tissue over the springs' mean stiffness, and its standard deviation [px].

        Tissue behind the instrument is not seen: the share of the force that it takes, on its foundation, counts as
        known to HIDDEN of itself.
        """
        found = self.explained(frame)[0]
        force = found.reaction.sum(axis=0)
        anchor = _moduli(self.springs, self.fields, self.numbers)[1]
        hidden = (anchor[:, None] * found.displacement)[self.count :].sum(axis=0) @ force / (force @ force)
        drawn = [np.log(np.linalg.norm(_forces(self, numbers, [frame])[0])) for numbers in self._draws()]
        return float(np.log(np.linalg.norm(force))), float(np.hypot(np.std(drawn), HIDDEN * hidden))

    def _draws(self) -> np.ndarray:
        """Numbers from their posterior, shape [DRAWS, P]; of one number the two that have its standard deviation."""
        if len(self.numbers) == 1:
            return self.numbers + np.sqrt(self.covariance) * np.array([[1.0], [-1.0]])
        factor = np.linalg.cholesky(self.covariance + TINY * np.eye(len(self.numbers)))
        return self.numbers + np.random.default_rng(0).standard_normal((DRAWS, len(self.numbers))) @ factor.T


def _forces(fit: SheetFit, numbers: np.ndarray, frames: Sequence[GripFrame]) -> np.ndarray:
    """What holds the gripped tissue in every frame, shape [T, 2] [unit of stiffness × px]."""
    found = [solve(fit.springs, fit.fields, numbers, frame, fit.terms)[0] for frame in frames]
    return np.array([item.reaction.sum(axis=0) for item in found])


def _along_last(forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces [T, 2] along the last one, and across it, over its length, shape [T] each."""
    last = forces[-1] / (forces[-1] @ forces[-1])
    return forces @ last, forces @ np.array([-last[1], last[0]])


def fit_sheet(
    points: np.ndarray, spacing: int, frames: Sequence[GripFrame], field: bool = True, background: bool = False
) -> SheetFit:
    """Fit a sheet to some frames of a grip, in their order in time.

    Args:
        points: places at rest, on a square grid, shape [N, 2] [px].
        spacing: of the grid [px].
        frames: of which those that show no motion don't count; with a background all do.
        field: whether stiffness and foundation may vary over the sheet; else one number explains all.
        background: whether the foundation moves affinely, in every frame in its own way: a camera's motion, breathing.
            It is found with the sheet, because far points, too, are pulled along.

    Raises:
        NothingMoves: fewer than LEAST_FRAMES frames move, or too few points are seen.
    """
    # With the background's motion on top it can't be seen which frames move.
    moving = [frame for frame in frames if background or frame.tells]
    if len(moving) < LEAST_FRAMES:
        raise NothingMoves(
            f"In {len(moving)} of {len(frames)} frames the tissue moves by more than {LEAST_MOTION:g} px, with "
            f"{LEAST_GRIPPED} points seen at the instrument and {LEAST_AROUND} around it; {LEAST_FRAMES} are needed."
        )
    nodes = continued(points, spacing, 0 if field else BEYOND)
    springs, terms = lattice_springs(nodes, spacing), _affine(points) if background else None
    later = len(moving) // 2
    early, late = _spread(moving[:-later]), moving[-later:]
    plain = uniform(len(nodes))
    candidates = {0.0: plain} | (
        {rough: knotted(nodes, len(points), spacing, rough) for rough in ROUGHNESS} if field else {}
    )
    found: dict[float, np.ndarray] = {}
    for rough, fields in candidates.items():
        start = _started(fields, found[0.0][0] if found else float(plain.mean[0]))
        found[rough] = _likeliest(springs, fields, early, start, terms)
    errors = {rough: _relative_error(springs, candidates[rough], found[rough], late, terms) for rough in found}
    best = min(errors, key=lambda rough: errors[rough])
    fields = candidates[best]
    error = _discrepancy(springs, fields, found[best], late, terms)
    used = _spread(moving)
    numbers = _likeliest(springs, fields, used, found[best], terms)
    covariance = _covariance(springs, fields, numbers, used, terms)
    return SheetFit(len(points), springs, fields, numbers, covariance, best, terms, error)


def skill(fit: SheetFit, frame: GripFrame) -> float:
    """1 - error / motion of the points around the grip, root mean squares: 0 as if nothing moved, 1 = exact.

    Both without the motion of a background that was found with the sheet.
    """
    found, carried = fit.explained(frame)
    left = (frame.own - carried - found.displacement[: fit.count])[frame.around]
    return 1 - length(left) / length((frame.moved - carried)[frame.around])


def length(vectors: np.ndarray) -> float:
    """Root mean square length of vectors [N, 2]."""
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean()))


def solve(
    springs: np.ndarray, fields: Fields, numbers: np.ndarray, frame: GripFrame, terms: np.ndarray | None
) -> tuple[Equilibrium, np.ndarray]:
    """The sheet at rest under a frame's grip, and how far the background carries every point, shape [N, 2] [px]."""
    return _held(springs, *_moduli(springs, fields, numbers), frame, terms)[:2]


def _held(
    springs: np.ndarray, stiffness: np.ndarray, anchor: np.ndarray, frame: GripFrame, terms: np.ndarray | None
) -> tuple[Equilibrium, np.ndarray, np.ndarray]:
    """The same, and how the points around the grip follow each of the background's terms, shape [n, 3 or 0].

    A foundation that moves affinely carries the whole sheet along, which changes no spring; what is left of the grip's
    motion pulls as if the foundation stood still. The least squares of the points around say which affine motion.
    """
    count, around = len(frame.gripped), frame.around
    gripped = np.zeros(len(anchor), bool)
    gripped[:count] = frame.gripped
    motion = frame.own[frame.gripped]
    if terms is None:
        return (
            equilibrium(springs, stiffness, anchor, gripped, motion),
            np.zeros((count, 2)),
            np.zeros((around.sum(), 0)),
        )
    found = equilibrium(springs, stiffness, anchor, gripped, np.hstack([motion, terms[frame.gripped]]))
    pulled, tied = found.displacement[:, :2], found.displacement[:, 2:]
    follows = (terms - tied[:count])[around]
    affine = np.linalg.lstsq(follows, (frame.own - pulled[:count])[around], rcond=None)[0]
    return dataclasses.replace(found, displacement=pulled - tied @ affine), terms @ affine, follows


def _affine(points: np.ndarray) -> np.ndarray:
    """Terms of an affine motion at points [N, 2], each of about unit size, shape [N, 3]."""
    return np.column_stack([(points - points.mean(axis=0)) / points.std(axis=0), np.ones(len(points))])


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


def _likeliest(
    springs: np.ndarray, fields: Fields, frames: Sequence[GripFrame], start: np.ndarray, terms: np.ndarray | None
) -> np.ndarray:
    """Numbers of highest posterior density, the error's size unknown in every frame."""
    ends = (fields.stiffness[springs[:, 0]] + fields.stiffness[springs[:, 1]]) / 2

    def loss(numbers: np.ndarray) -> tuple[float, np.ndarray]:
        off = numbers - fields.mean
        value, gradient = 0.5 * off @ fields.precision @ off, fields.precision @ off
        stiffness, anchor = _moduli(springs, fields, numbers)
        for frame in frames:
            # The background is the likeliest for these numbers: it has no slope of its own.
            found, carried, _ = _held(springs, stiffness, anchor, frame, terms)
            around = np.flatnonzero(frame.around)
            error = np.zeros_like(found.displacement)
            error[around] = found.displacement[around] - (frame.own - carried)[around]
            size, worth = float(np.square(error).sum()), _independent(len(around)) / len(frames)
            value += 0.5 * worth * np.log(size)
            by_stiffness, by_anchor = found.gradient(worth / size * error)
            gradient = gradient + ends.T @ (by_stiffness * stiffness) + fields.anchor.T @ (by_anchor * anchor)
        return value, gradient

    limits = np.column_stack([fields.mean - LARGEST, fields.mean + LARGEST])
    return minimize(loss, start, jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": STEPS}).x


def _covariance(
    springs: np.ndarray, fields: Fields, numbers: np.ndarray, frames: Sequence[GripFrame], terms: np.ndarray | None
) -> np.ndarray:
    """Of the numbers at their likeliest, by Gauss and Newton's Hessian, shape [P, P]."""
    precision = fields.precision.copy()
    moduli = _moduli(springs, fields, numbers)
    for frame in frames:
        found, carried, follows = _held(springs, *moduli, frame, terms)
        around = np.flatnonzero(frame.around)
        slopes = _slopes(springs, fields, numbers, found)[around]
        # What the background could do as well tells nothing.
        basis = np.linalg.qr(follows)[0]
        slopes = slopes - np.einsum("nk,kap->nap", basis, np.einsum("nk,nap->kap", basis, slopes))
        slopes = slopes.reshape(2 * len(around), -1)
        size = float(np.square(found.displacement[around] - (frame.own - carried)[around]).sum())
        precision += _independent(len(around)) / len(frames) / size * (slopes.T @ slopes)
    return np.linalg.inv(precision)


def _slopes(springs: np.ndarray, fields: Fields, numbers: np.ndarray, found: Equilibrium) -> np.ndarray:
    """Derivatives of the displacement by the numbers, shape [N, 2, P]."""
    stiffness, anchor = _moduli(springs, fields, numbers)
    ends = (fields.stiffness[springs[:, 0]] + fields.stiffness[springs[:, 1]]) / 2
    return found.slopes(ends.toarray() * stiffness[:, None], fields.anchor.toarray() * anchor[:, None])


def _errors(
    springs: np.ndarray, fields: Fields, numbers: np.ndarray, frame: GripFrame, terms: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, float]:
    """Squared error and predicted motion of the points around the grip [n], and their mean square motion [px²]."""
    found, carried = solve(springs, fields, numbers, frame, terms)
    around = np.flatnonzero(frame.around)
    predicted, moved = found.displacement[around], (frame.moved - carried)[around]
    return np.square(predicted - moved).sum(axis=1), np.square(predicted).sum(axis=1), length(moved) ** 2


def _relative_error(
    springs: np.ndarray,
    fields: Fields,
    numbers: np.ndarray,
    frames: Sequence[GripFrame],
    terms: np.ndarray | None,
) -> float:
    """Mean square of error over motion."""
    found = [_errors(springs, fields, numbers, frame, terms) for frame in frames]
    return float(np.mean([error.mean() / motion for error, _, motion in found]))


def _discrepancy(
    springs: np.ndarray, fields: Fields, numbers: np.ndarray, frames: Sequence[GripFrame], terms: np.ndarray | None
) -> tuple[float, float]:
    """Shares of the errors in some frames."""
    pairs = [_errors(springs, fields, numbers, frame, terms)[:2] for frame in frames]
    error, motion = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return error_shares(
        error, motion, np.repeat([frame.reach**2 for frame in frames], [len(part) for part, _ in pairs])
    )


def error_shares(error: np.ndarray, motion: np.ndarray, reach: np.ndarray) -> tuple[float, float]:
    """The reach's share and a point's own in the standard deviation √((share · reach)² + (share · motion)²) by axis.

    Their ratio is the likeliest one of normal errors; their size is such that 90 % discs hold 90 % of the points.

    Args:
        error, motion, reach: squares of how far points are off, of how far they are expected to move, and of their
            frame's reach, shape [n] each [px²].
    """

    def loss(logs: np.ndarray) -> float:
        variance = np.exp(2 * logs[0]) * reach + np.exp(2 * logs[1]) * motion
        return float((np.log(variance) + error / (2 * variance)).mean())

    start = 0.5 * np.log([error.mean() / reach.mean() / 4, error.mean() / motion.mean() / 4])
    grip, own = np.exp(minimize(loss, start, method="Nelder-Mead").x)
    scale = np.quantile(np.sqrt(error / (grip**2 * reach + own**2 * motion)), 0.9) / RADIUS
    return float(grip * scale), float(own * scale)
