"""Tissue around a grip: a quasi-static elastic sheet on an elastic foundation, on the lattice of followed points.

The gripped points have a prescribed displacement, and the other points are the observation. The single parameter is α,
the foundation over the spring stiffness. The sheet is linear, so that one sparse factorisation per α serves all frames
(`physics.sheet`); the background's affine motion adds three right-hand sides.
"""

from dataclasses import dataclass

import numpy as np

from palpate.common.robust import affine_terms
from palpate.physics.mesh import grid_springs
from palpate.physics.sheet import equilibrium

ALPHAS = np.geomspace(1e-3, 1.0, 14)
"""Foundation over spring stiffness. Motion dies away over √(3/α) spacings: a node's eight springs are worth three."""
PIECE = 7
"""Side of a piece of tissue over which the errors of the sheet are correlated, in spacings of the lattice."""
BEYOND = 5
"""Distance by which the sheet continues beyond the points, in spacings of the lattice."""
LEAST_MOTION = 1.0
"""Root mean square displacement below which a frame shows no motion [px]."""
LEAST_GRIPPED, LEAST_AROUND = 20, 50
"""Least number of points at the instrument, and around it."""


class NothingMoves(ValueError):
    """No frame moves enough for a fit; the message is a sentence that says why."""


@dataclass(frozen=True, eq=False)
class GripFrame:
    """One frame of a grip; N points."""

    moved: np.ndarray
    """Displacement since rest, shape [N, 2] [px]; NaN where a point is lost."""
    gripped: np.ndarray
    """Points that move with the instrument, shape [N], bool; all of them visible."""

    @property
    def around(self) -> np.ndarray:
        """The other visible points, shape [N], bool."""
        return np.isfinite(self.moved).all(axis=1) & ~self.gripped

    @property
    def moves(self) -> bool:
        """True if enough points are visible, and both grip and tissue move."""
        around = self.around
        if self.gripped.sum() < LEAST_GRIPPED or around.sum() < LEAST_AROUND:
            return False
        return min(length(self.moved[self.gripped]), length(self.moved[around])) > LEAST_MOTION


def length(vectors: np.ndarray) -> float:
    """Return the root mean square length of vectors [N, 2]."""
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean()))


@dataclass(frozen=True, eq=False)
class SheetFit:
    """Sheets of A values of α under a pull of T frames."""

    squares: np.ndarray
    """Sum of squared errors around the grip, with the given background, shape [A, T] [px²]."""
    refitted: np.ndarray
    """Sum of squared errors with the background fitted in every frame, shape [A, T] [px²]."""
    motion: np.ndarray
    """Sum of squared displacements around the grip less the given background, shape [T] [px²]."""
    counts: np.ndarray
    """Number of points around the grip, shape [T]."""
    force: np.ndarray
    """Reaction at the grip with the background fitted, shape [A, T, 2] [spring stiffness × px]."""

    def skill(self, half: int) -> float:
        """Return mean of 1 - error / motion, root mean squares, from frame `half` on; α is the likeliest by the frames
        before.

        0 = as if nothing moved, 1 = exact.
        """
        best = int(np.argmax(posterior(self.squares[:, :half], self.counts[:half])))
        return float(np.mean(1 - np.sqrt(self.squares[best, half:] / self.motion[half:])))

    def relative_force(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the force along the last frame's direction over the last frame's, and its standard deviation over α,
        [T] each."""
        last = self.force[:, -1:]
        ratio = (self.force * last).sum(axis=2) / np.square(last).sum(axis=2)
        weights = posterior(self.refitted, self.counts)
        mean = weights @ ratio
        return mean, np.sqrt(weights @ np.square(ratio - mean))


def posterior(squares: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return the probability of each α, shape [A], flat in log α before; the errors' size is unknown in every frame.

    A piece of tissue has two independent errors, the same in all frames: what a sheet can't explain is smooth, and
    stays.

    Args:
        squares: sums of squared errors, shape [A, T].
        counts: numbers of points, shape [T].
    """
    log = -(counts / PIECE**2 / len(counts) * np.log(squares)).sum(axis=1)
    found = np.exp(log - log.max())
    return found / found.sum()


def fit_sheets(
    points: np.ndarray, spacing: int, gripped: np.ndarray, moved: np.ndarray, background: np.ndarray
) -> SheetFit:
    """Compare the sheets of all ALPHAS with a pull.

    Args:
        points: places at rest, on a square grid, shape [N, 2] [px].
        spacing: spacing of the grid [px].
        gripped: points with a prescribed displacement, visible in all frames, shape [N], bool.
        moved: displacements, shape [T, N, 2] [px]; NaN where a point is lost.
        background: affine motion by `affine_terms` of the points, shape [T, 3, 2] [px].
    """
    count, frames, terms = len(points), len(moved), affine_terms(points)
    nodes = continued(points, spacing, BEYOND)
    springs, held = lattice_springs(nodes, spacing), np.zeros(len(nodes), bool)
    held[:count] = gripped
    given = np.column_stack([*moved[:, gripped], terms[gripped]])
    visible = np.isfinite(moved).all(axis=2) & ~gripped
    mask, around = visible[..., None], np.where(visible[..., None], moved, 0.0)
    squares, refitted, force = [], [], []
    for alpha in ALPHAS:
        found = equilibrium(springs, np.ones(len(springs)), np.full(len(nodes), alpha), held, given)
        pulled = found.displacement[:count, :-3].reshape(count, frames, 2).swapaxes(0, 1)
        # A foundation that moves affinely carries the sheet along, but for what the grip holds back.
        follows = terms - found.displacement[:count, -3:]
        off = around - mask * pulled
        fitted = np.linalg.solve(np.einsum("tn,nk,nl->tkl", visible, follows, follows), follows.T @ off)
        for errors, affine in ((squares, background), (refitted, fitted)):
            errors.append(np.square(off - mask * (follows @ affine)).sum(axis=(1, 2)))
        reaction = found.reaction.sum(axis=0)
        force.append(reaction[:-3].reshape(frames, 2) - reaction[-3:] @ fitted)
    motion = np.square(around - mask * (terms @ background)).sum(axis=(1, 2))
    return SheetFit(np.array(squares), np.array(refitted), motion, visible.sum(axis=1), np.array(force))


def continued(points: np.ndarray, spacing: int, beyond: int) -> np.ndarray:
    """Return nodes of the sheet, shape [M, 2] [px]: the points [N, 2], then the tissue that is not visible.

    Tissue goes on behind the instrument and beyond the picture; a sheet that ends there needs too little force.

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
    """Return pairs of neighbours on a square grid, diagonals included, shape [S, 2]; points [N, 2] (column, row)
    [px]."""
    cells = np.rint(points / spacing).astype(np.int64)
    cells -= cells.min(axis=0)
    number = np.full(cells.max(axis=0) + 1, -1)
    number[tuple(cells.T)] = np.arange(len(cells))
    steps = (1, 0), (0, 1), (1, 1), (1, -1)
    pairs = number.ravel()[np.concatenate([grid_springs(number.shape, *step) for step in steps])]
    return pairs[(pairs >= 0).all(axis=1)]
