"""Followed points as the nodes of a sheet on a foundation, and what such a sheet says where the grip's motion is given.

The tissue at the instrument is a prescribed displacement, the other points are the observation, and a quasi-static
sheet on a foundation (`physics.sheet`) explains them. Only the ratio of foundation to spring stiffness is determined.
A sheet is not tissue, and its error is hundreds of times that of following points: how large it is the last frames of
those that are fitted tell, which the other ones predict.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from scipy.optimize import minimize, minimize_scalar
from scipy.sparse import csr_array

from palpate.common.robust import affine_terms
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.physics.sheet import Equilibrium, equilibrium

PIECE = 7
"""Side of a piece of tissue, in grid spacings of the points, over which what a sheet can't explain is the same."""
TYPICAL_ANCHOR, SPREAD = 0.01, 3.0
"""Foundation over spring stiffness of tissue, and the standard deviation of its logarithm: almost anything."""
BEYOND = 5
"""How far a sheet goes on beyond the points, in their spacings."""
MOST_FRAMES = 8
"""So many frames, evenly spread, are fitted: the motion grows steadily, and its neighbours say the same."""
LEAST_MOTION = 1.0
"""Root mean square below which a frame shows no motion [px]."""
LEAST_FRAMES = 3
"""Fewer frames that move can't be fitted and checked."""
LEAST_GRIPPED, LEAST_AROUND = 20, 50
"""Fewer points at the instrument, or around it, are too few."""
PRECISION = 1e-5
"""Of the likeliest log foundation, relative."""
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
        """The other points that are visible, shape [N], bool."""
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


def length(vectors: np.ndarray) -> float:
    """Root mean square length of vectors [N, 2]."""
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean()))


class Held(NamedTuple):
    """A sheet at rest under a frame's grip; M nodes, N points, n of them around the grip."""

    found: Equilibrium
    """Its displacement without the background's motion, [M, 2] [px]."""
    carried: np.ndarray
    """How far the background carries every point, shape [N, 2] [px]."""
    follows: np.ndarray
    """How the points around the grip follow each of the background's terms, shape [n, 3 or 0]."""


@dataclass(frozen=True, eq=False)
class SheetFit:
    """A sheet whose springs have stiffness 1; N points, M nodes."""

    count: int
    """N. The sheet's first nodes are the points, those behind them are not visible."""
    nodes: int
    """M."""
    springs: np.ndarray
    """Pairs of nodes, shape [S, 2]."""
    terms: np.ndarray | None
    """Of the background's affine motion at every point, shape [N, 3]; None where it is at rest."""
    log_anchor: float = float(np.log(TYPICAL_ANCHOR))
    """Log of the foundation over the stiffness of the springs.

    Motion dies away over √(3/it) spacings of the points: with diagonals every node has springs worth three.
    """
    log_anchor_sd: float = SPREAD
    """Its standard deviation."""
    error: float = 0.0
    """Standard deviation by axis of predictions as a share of a point's motion, besides a part that grows with the
    grip's: the sheet is linear. Measured on frames that were not fitted."""

    def at(self, log_anchor: float) -> Self:
        """The sheet on another foundation."""
        return replace(self, log_anchor=log_anchor)

    def held(self, frame: GripFrame) -> Held:
        """The sheet at rest under a frame's grip.

        A foundation that moves affinely carries the whole sheet along, which changes no spring; what is left of the
        grip's motion pulls as if the foundation stood still. The least squares of the points around say which affine
        motion.
        """
        around, gripped = frame.around, np.zeros(self.nodes, bool)
        gripped[: self.count] = frame.gripped
        terms = np.zeros((self.count, 0)) if self.terms is None else self.terms
        given = np.hstack([frame.moved[frame.gripped], terms[frame.gripped]])
        stiffness, anchor = np.ones(len(self.springs)), np.full(self.nodes, np.exp(self.log_anchor))
        found = equilibrium(self.springs, stiffness, anchor, gripped, given)
        pulled, tied = found.displacement[:, :2], found.displacement[:, 2:]
        follows = (terms - tied[: self.count])[around]
        affine = np.linalg.lstsq(follows, (frame.moved - pulled[: self.count])[around], rcond=None)[0]
        return Held(replace(found, displacement=pulled - tied @ affine), terms @ affine, follows)

    def relative_force(self, frames: Sequence[GripFrame]) -> tuple[np.ndarray, np.ndarray]:
        """What holds the gripped tissue in every frame over what holds it in the last, and its standard deviation.

        Along the last one's direction, shape [T] each, of the points that are visible in all of them; not a number
        where these are too few. What the sheet leaves of the motion counts as its share of the force, in between rest
        and the last frame, where the ratio is 0 and 1 whatever the tissue.
        """
        same = np.logical_and.reduce([frame.gripped for frame in frames])
        if same.sum() < LEAST_GRIPPED:
            return np.full(len(frames), np.nan), np.full(len(frames), np.nan)
        frames = [replace(frame, gripped=same) for frame in frames]
        _, ratio, across = along_last(self._forces(frames))
        either = [along_last(sheet._forces(frames))[1] for sheet in self._either()]
        return ratio, np.hypot(np.std(either, axis=0), self.error * np.hypot(ratio * (1 - ratio), across))

    def log_force(self, frame: GripFrame) -> tuple[float, float]:
        """Log of what holds the gripped tissue over the springs' stiffness, and its standard deviation [px].

        Tissue behind the instrument is not visible: the share of the force that it takes, on its foundation, counts as
        known to `hidden_force` (`estimators.model_errors`) of itself.
        """
        found = self.held(frame).found
        force = found.reaction.sum(axis=0)
        unseen = np.exp(self.log_anchor) * found.displacement[self.count :].sum(axis=0)
        either = [np.log(np.linalg.norm(sheet._forces([frame])[0])) for sheet in self._either()]
        share = unseen @ force / (force @ force)
        return float(np.log(np.linalg.norm(force))), float(np.hypot(np.std(either), MODEL_ERRORS.hidden_force * share))

    def _either(self) -> list[Self]:
        """Two whose log foundations have its standard deviation."""
        return [self.at(self.log_anchor + way * self.log_anchor_sd) for way in (1, -1)]

    def _forces(self, frames: Sequence[GripFrame]) -> np.ndarray:
        """What holds the gripped tissue in every frame, shape [T, 2] [unit of stiffness × px]."""
        return np.array([self.held(frame).found.reaction.sum(axis=0) for frame in frames])


def fit_sheet(points: np.ndarray, spacing: int, frames: Sequence[GripFrame], background: bool = False) -> SheetFit:
    """Fit a sheet to some frames of a grip, in their order in time.

    Args:
        points: places at rest, on a square grid, shape [N, 2] [px].
        spacing: of the grid [px].
        frames: of which those that show no motion don't count; with a background all do.
        background: whether the foundation moves affinely, in every frame in its own way: a camera's motion, breathing.
            It is found with the sheet, because far points, too, are pulled along.

    Raises:
        NothingMoves: fewer than LEAST_FRAMES frames move, or too few points are visible.
    """
    # With the background's motion on top it can't be seen which frames move.
    moving = [frame for frame in frames if background or frame.tells]
    if len(moving) < LEAST_FRAMES:
        raise NothingMoves(
            f"In {len(moving)} of {len(frames)} frames the tissue moves by more than {LEAST_MOTION:g} px, with "
            f"{LEAST_GRIPPED} points seen at the instrument and {LEAST_AROUND} around it; {LEAST_FRAMES} are needed."
        )
    nodes = continued(points, spacing, BEYOND)
    terms = affine_terms(points) if background else None
    sheet = SheetFit(len(points), len(nodes), lattice_springs(nodes, spacing), terms)
    half = len(moving) - len(moving) // 2
    used = [moving[place] for place in evenly(len(moving), MOST_FRAMES)]
    early = _likeliest(sheet, [moving[place] for place in evenly(half, MOST_FRAMES)])
    squares = [_squares(early, frame) for frame in moving[half:]]
    error = error_shares(*np.concatenate(squares, axis=1))[1]
    found = _likeliest(early, used)
    return replace(found, log_anchor_sd=_deviation(found, used), error=error)


def skill(fit: SheetFit, frame: GripFrame) -> float:
    """1 - error / motion of the points around the grip, root mean squares: 0 as if nothing moved, 1 = exact.

    Both without the motion of a background that was found with the sheet.
    """
    found, carried, _ = fit.held(frame)
    moved, around = frame.moved - carried, frame.around
    return 1 - length((moved - found.displacement[: fit.count])[around]) / length(moved[around])


def evenly(count: int, most: int) -> list[int]:
    """Numbers of at most so many of a count of frames, evenly spread, the last one included."""
    return (np.linspace(0, count, min(most, count) + 1)[1:].round().astype(int) - 1).tolist()


def along_last(forces: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Length of the last of forces [T, 2], and all along it and across it over this length, shape [T] each."""
    last = forces[-1] / (forces[-1] @ forces[-1])
    return float(np.linalg.norm(forces[-1])), forces @ last, forces @ np.array([-last[1], last[0]])


def error_shares(error: np.ndarray, motion: np.ndarray, pull: np.ndarray) -> tuple[float, float]:
    """The pull's share and a point's own in the standard deviation √((share · pull)² + (share · motion)²) by axis.

    Their ratio is the likeliest one of normal errors; their size is such that 90 % discs hold 90 % of the points.

    Args:
        error, motion, pull: squares of how far points are off, of how far they are expected to move, and of their
            frame's pull, shape [n] each [px²].
    """

    def loss(logs: np.ndarray) -> float:
        variance = np.exp(2 * logs[0]) * pull + np.exp(2 * logs[1]) * motion
        return float((np.log(variance) + error / (2 * variance)).mean())

    start = 0.5 * np.log([error.mean() / pull.mean() / 4, error.mean() / motion.mean() / 4])
    grip, own = np.exp(minimize(loss, start, method="Nelder-Mead").x)
    scale = np.quantile(np.sqrt(error / (grip**2 * pull + own**2 * motion)), 0.9) / RADIUS
    return float(grip * scale), float(own * scale)


def _squares(sheet: SheetFit, frame: GripFrame) -> np.ndarray:
    """What `error_shares` needs of the n points around the grip, shape [3, n] [px²]."""
    found, carried, _ = sheet.held(frame)
    around = frame.around
    predicted = found.displacement[: sheet.count][around]
    off = predicted - (frame.moved - carried)[around]
    squares = [np.square(vectors).sum(axis=1) for vectors in (off, predicted)]
    return np.stack([*squares, np.full(len(off), frame.pull**2)])


def _worth(frame: GripFrame, frames: Sequence[GripFrame]) -> float:
    """How many independent numbers the errors of a frame's points are worth among those of some: two a piece."""
    return 2 * int(frame.around.sum()) / PIECE**2 / len(frames)


def _likeliest(sheet: SheetFit, frames: Sequence[GripFrame]) -> SheetFit:
    """The sheet on the foundation of highest posterior density, the error's size unknown in every frame."""

    def loss(log_anchor: float) -> float:
        value = 0.5 * ((log_anchor - np.log(TYPICAL_ANCHOR)) / SPREAD) ** 2
        tried = sheet.at(log_anchor)
        for frame in frames:
            value += 0.5 * _worth(frame, frames) * np.log(_squares(tried, frame)[0].sum())
        return float(value)

    near = sheet.log_anchor - 0.5, sheet.log_anchor + 0.5
    return sheet.at(float(minimize_scalar(loss, near, options={"xtol": PRECISION}).x))


def _deviation(sheet: SheetFit, frames: Sequence[GripFrame]) -> float:
    """Standard deviation of the log foundation at its likeliest, by Gauss and Newton's curvature."""
    precision = SPREAD**-2
    for frame in frames:
        found, _, follows = sheet.held(frame)
        anchor = np.full((sheet.nodes, 1), np.exp(sheet.log_anchor))
        slopes = found.slopes(np.zeros((len(sheet.springs), 1)), anchor)[: sheet.count, :, 0][frame.around]
        # What the background could do as well tells nothing.
        basis = np.linalg.qr(follows)[0]
        slopes = slopes - basis @ (basis.T @ slopes)
        precision += _worth(frame, frames) * np.square(slopes).sum() / _squares(sheet, frame)[0].sum()
    return float(precision**-0.5)


def continued(points: np.ndarray, spacing: int, beyond: int) -> np.ndarray:
    """Nodes of the sheet, shape [M, 2] [px]: the points [N, 2], and behind them what is not visible.

    Tissue goes on behind the instrument and beyond the picture's edges; a sheet with a hole there, or that ends there,
    is pulled along with too little force.

    Args:
        beyond: how far it goes on beyond the points, in their spacings.
    """
    cells = np.rint(points / spacing).astype(np.int64)
    low, high = cells.min(axis=0) - beyond, cells.max(axis=0) + beyond
    hidden = np.ones(high - low + 1, bool)
    hidden[tuple((cells - low).T)] = False
    offset = points[0] - cells[0] * spacing
    return np.concatenate([points, (np.argwhere(hidden) + low) * spacing + offset])


def lattice_springs(points: np.ndarray, spacing: int) -> np.ndarray:
    """Pairs of neighbours on a square grid, diagonals included, shape [S, 2]; points [N, 2] (column, row) [px]."""
    cells = np.rint(points / spacing).astype(np.int64)
    cells -= cells.min(axis=0)
    number = np.full(cells.max(axis=0) + 2, -1)
    number[cells[:, 0], cells[:, 1]] = np.arange(len(cells))
    pairs = []
    for right, down in ((1, 0), (0, 1), (1, 1), (1, -1)):
        other = cells + np.array([right, down])
        # Below 0 the index wraps round to the last row, which is empty.
        found = number[other[:, 0], other[:, 1]]
        pairs.append(np.column_stack([np.arange(len(cells)), found])[found >= 0])
    return np.concatenate(pairs)


def smoothness(shape: np.ndarray) -> np.ndarray:
    """Sum of the squared differences between neighbours on a grid of K knots, as a matrix [K, K]."""
    rows, columns = (np.diff(np.eye(side), axis=0) for side in shape)
    return np.kron(rows.T @ rows, np.eye(shape[1])) + np.kron(np.eye(shape[0]), columns.T @ columns)


def bilinear(places: np.ndarray, shape: np.ndarray) -> csr_array:
    """Weights of the knots of a grid at places [N, 2] in its units, shape [N, product of shape]."""
    corner = np.clip(places.astype(int), 0, np.maximum(shape - 2, 0))
    share = places - corner
    rows, columns, values = [], [], []
    for step in np.ndindex(2, 2):
        rows.append(np.arange(len(places)))
        columns.append(np.ravel_multi_index(tuple((corner + step).T), tuple(shape)))
        values.append(np.where(step, share, 1 - share).prod(axis=1))
    flat = [np.concatenate(part) for part in (values, rows, columns)]
    return csr_array((flat[0], (flat[1], flat[2])), (len(places), int(np.prod(shape))))
