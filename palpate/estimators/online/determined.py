"""Motion that the instrument alone explains, and the stiffness fields that this determines, place by place.

A simulation is driven by the instrument from rest on and never mapped to what is observed, unlike the session's state.
Its residual judges the model. As many more, each with the stiffness around one knot changed, give derivatives. These
and a normal prior give the posterior of log stiffness at the knots: linear least squares around the fields of each
frame (Gauss–Newton). The noise is the likeliest fields' residual. Model errors are correlated over neighbouring places
and frames: on the one real pull by 0.99 from frame to frame. So all frames count as one, and points of a frame by as
much as their means over the cells around the knots vary.

The paper leaves time step, masses and attachments open, and its optimiser takes tens of frames to get anywhere. Three
numbers are fitted to the first frames by simulation alone: time step, foundation and bending. Stiffness place by place
is left to the optimiser.
"""

import dataclasses
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from typing import NamedTuple

import numpy as np

from palpate.estimators.grip.lattice import length
from palpate.estimators.online.knots import knot_shares
from palpate.estimators.online.objective import Objective
from palpate.estimators.result import LEAST_SKILL
from palpate.physics.identifiability import LIMIT
from palpate.physics.pbd.body import Body
from palpate.physics.pbd.simulation import Stepping
from palpate.physics.pbd.stiffness import Stiffness

FOUNDATIONS = (0.0, 0.01, 0.03, 0.1, 0.3)
"""Foundations that are tried, over the stiffness of distances."""
BENDINGS = (0.02, 0.3, 1.0)
"""Stiffnesses of shapes that are tried within the bounds, over that of distances; the paper's largest is a
five-hundredth."""
Answer = Callable[[np.ndarray], np.ndarray]
"""Function from values of the particles to values of points."""

LEAST = 0.2
"""Root mean square motion below which a frame's points count for nothing [px]."""


VOLUME = 1e10 * 0.0089**4
"""Stiffness of volumes where edges have a mean length of 1: the paper's 10¹⁰ for edges of 8.9 mm, 600 particles in a
block. It goes with the inverse fourth power of the edges, since a volume's gradient goes with the second."""


def uniform(body: Body, distance: float, shape: float) -> Stiffness:
    """Return one stiffness everywhere; of volumes as the paper's, in whatever unit."""
    return Stiffness(np.full(body.count, distance), np.full(body.count, shape), VOLUME / body.edge**4)


class Fit(NamedTuple):
    """Parameters that explain some frames best."""

    time_step: float
    foundation: float
    """Foundation over the stiffness of distances."""
    bending: float
    """Stiffness of shapes over that of distances."""
    error: float
    """Error over motion, root mean squares over points, of frames held out in turn: their mean."""

    def stepping(self, usual: Stepping, stiffness: float) -> Stepping:
        """Return the usual stepping with this time step and foundation, for such a stiffness of distances."""
        return dataclasses.replace(usual, time_step=self.time_step, foundation=self.foundation * stiffness)


class Fitting:
    """The first frames by every combination, and by what is given, all led by the instrument from rest on.

    Args:
        objective: how the body is stepped if nothing is fitted.
        begun: the stiffness then, the same everywhere.
        bendings: stiffness of shapes over that of distances, to choose from.
        shown: gives displacements of the points in states [B, N, 3], shape [B, Q, 2] [px].
    """

    def __init__(self, objective: Objective, begun: Stiffness, bendings: list[float], shown: Answer) -> None:
        self._shown, stiffness = shown, float(begun.distance[0])
        shapes = stiffness * np.repeat(np.array(bendings)[:, None], objective.body.count, axis=1)
        fields = Stiffness(np.full_like(shapes, stiffness), shapes, begun.volume)
        self._fits, self._groups = [None], [(objective, begun)]
        # A frame's time over √(m/k): from tissue that hangs back to tissue that is at rest in every frame.
        for time_step, foundation in product((1.0, 2.0, 4.0, 8.0), FOUNDATIONS):
            own = [Fit(time_step, foundation, bending, np.nan) for bending in bendings]
            stepping = own[0].stepping(objective.stepping, stiffness)
            self._groups.append((dataclasses.replace(objective, stepping=stepping), fields))
            self._fits += own
        self._states = [objective.body.rest] * len(self._groups)
        self._errors: list[list[float]] = []
        """Errors over the motion by the given parameters and by all combinations, of every frame in which points
        move."""

    def step(self, places: np.ndarray, seen: np.ndarray) -> None:
        """Lead all on, and compare them with a frame; arguments as in `Determined.step`."""

        def stepped(group: tuple[Objective, Stiffness], states: np.ndarray) -> np.ndarray:
            return group[0].stepped(group[1], states, places[None]).positions[:, -1]

        with ThreadPoolExecutor(2) as both:
            self._states = list(both.map(stepped, self._groups, self._states))
        used = np.isfinite(seen).all(axis=1)
        motion = length(seen[used]) if used.any() else 0.0
        if motion > LEAST:
            off = (self._shown(np.concatenate(self._states)) - seen)[:, used]
            self._errors.append([length(each) / motion for each in off])

    @property
    def best(self) -> Fit | None:
        """Parameters that explain the frames so far best; None if held-out frames don't confirm them.

        Each frame is held out in turn and predicted by the parameters that the others choose. The error must be below
        that of the given parameters, and as small as a run's. Else the fit may be noise.
        """
        errors = np.array(self._errors)
        if len(errors) < 2:
            return None
        chosen = (errors.sum(axis=0) - errors).argmin(axis=1)
        held_out, fit = float(errors[np.arange(len(errors)), chosen].mean()), self._fits[errors.sum(axis=0).argmin()]
        explained = held_out < min(errors[:, 0].mean(), 1 - LEAST_SKILL)
        return fit._replace(error=held_out) if fit is not None and explained else None


CHANGE = 0.01
"""Change of log stiffness, for finite differences."""


class Determined:
    """One run of contact; N particles, Q points that are compared, K knots of both fields."""

    uncertain = "time_step", "foundation"
    """Uncertain parameters of `Stepping`, known no better than a knot, as first frames identify them in large steps."""

    def __init__(self, objective: Objective, begun: Stiffness, cells: Answer, shown: Answer) -> None:
        """Begin at rest.

        Args:
            objective: body, grip and how it is stepped.
            begun: stiffness to begin with, shape [N].
            cells: gives values of the particles [N, C] at the points, shape [Q, C].
            shown: gives displacements of the points in states [B, N, 3], shape [B, Q, 2] [px].
        """
        self._objective, self._shown = objective, shown
        rest = objective.body.rest
        (stretch, _), self._shares = knot_shares(rest, len(self.uncertain))
        total = self._shares.shape[2]
        own = {name: getattr(objective.stepping, name) * math.exp(CHANGE) for name in self.uncertain}
        others = (dataclasses.replace(objective.stepping, **{name: value}) for name, value in own.items())
        self._others = [dataclasses.replace(objective, stepping=stepping) for stepping in others]
        self._projected = np.linalg.pinv(self._shares.reshape(-1, total))
        self._begun = np.log(begun[:2])
        self._cell = cells(stretch).argmax(axis=1)
        self._carried = np.repeat(rest[None], total + 1, axis=0)
        self._squares = np.zeros((stretch.shape[1], total + 1, total + 1))
        self._shared = np.zeros_like(self._squares)
        self._points = np.zeros(stretch.shape[1])
        self._axes = 2
        """Axes of the picture. Before it, for every cell over frames: squares and products, summed over its
        points, of what is observed less what the first fields would show, then of its derivatives; the same of
        their means over points, times their number; and that number."""
        self._frames = 0
        self._motion = self._left = 0.0
        self.moved = self.predicted = np.zeros((len(self._cell), 2))
        """Displacement of the points in the last frame that shows some, and by the instrument alone, [Q, 2] [px]."""
        self.course = [(0.0, 0.0, 0.0)]
        """Course of every frame, rest first, how far points have moved, by the instrument alone, and the difference of
        both, root mean squares [px]; not a number where none is seen."""

    @property
    def skill(self) -> float:
        """Skill so far, 1 - error / motion, root mean squares over points and frames; not a number where nothing has
        moved."""
        return 1 - math.sqrt(self._left / self._motion) if self._motion > 0 else math.nan

    def step(self, fields: Stiffness, places: np.ndarray, seen: np.ndarray) -> None:
        """Lead the simulations on, and compare them with a frame.

        Args:
            fields: stiffness as it is before the frame is taken in, shape [N].
            places: where the gripped particles are, shape [G, 3] [m].
            seen: displacement of the points, shape [Q, 2] [px]; not observed = NaN.
        """
        factors = np.exp(CHANGE * self._shares[:, :, : -len(self.uncertain)].transpose(0, 2, 1))
        own = np.stack(fields[:2])[:, None]
        distance, shape = np.concatenate([own, own * factors], axis=1)
        fewer = len(distance)
        carried = [self._objective.carried(Stiffness(distance, shape, fields.volume), self._carried[:fewer], places)]
        for other, state in zip(self._others, self._carried[fewer:], strict=True):
            carried.append(other.stepped(fields, state, places[None]).positions[:, -1])
        self._carried = np.concatenate(carried)
        shown = self._shown(self._carried)
        used = np.isfinite(seen).all(axis=1)
        if not used.any():
            self.course.append((math.nan, math.nan, math.nan))
            return
        self.moved, self.predicted = seen, shown[0]
        self.course.append((length(seen[used]), length(shown[0][used]), length((seen - shown[0])[used])))
        motion = float(np.square(seen[used]).sum())
        if motion <= LEAST**2 * used.sum():
            return
        off, slopes, cell = (seen - shown[0])[used], (shown[1:] - shown[0])[:, used] / CHANGE, self._cell[used]
        towards = off + np.einsum("kqi,k->qi", slopes, self._projected @ self._logs(fields).ravel())
        self._frames, self._axes = self._frames + 1, seen.shape[1]
        self._motion += motion
        self._left += float(np.square(off).sum())
        rows = np.concatenate([towards[None], slopes])
        for one in np.unique(cell):
            here = rows[:, cell == one]
            count, flat, means = here.shape[1], here.reshape(len(here), -1), here.mean(axis=1)
            self._squares[one] += flat @ flat.T
            self._shared[one] += count * means @ means.T
            self._points[one] += count

    def likeliest(self, fields: Stiffness) -> Stiffness:
        """Take a Gauss–Newton step from the fields of the frame that was taken in, within the bounds.

        It leads to the likeliest fields for the present time step and foundation, by at most 0.3 in a knot's logarithm.
        """
        covariance, likeliest = self._posterior(fields)
        knots, stepped = slice(-len(self.uncertain)), slice(-len(self.uncertain), None)
        others = np.linalg.solve(covariance[stepped, stepped], likeliest[stepped])
        way = (likeliest - covariance[:, stepped] @ others - self._projected @ self._logs(fields).ravel())[knots]
        way *= min(1.0, 0.3 / max(float(np.abs(way).max()), 1e-300))
        # As if they had been led by these fields all along: what remains of former ones would count again.
        slopes = (self._carried[1 : len(way) + 1] - self._carried[0]) / CHANGE
        self._carried = self._carried + np.tensordot(way, slopes, 1)
        changed = np.stack(fields[:2]) * np.exp(self._shares[:, :, knots] @ way)
        return Stiffness(*np.minimum(changed, self._objective.bounds.both), fields.volume)

    def known(self, fields: Stiffness, among: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return standard deviations of log stiffness over its mean, shape [2, N]: of distances, of shapes; and where
        known.

        A particle is known if the knots around constrain it to LIMIT, and to half of the prior's deviation. The field
        must also lie within that deviation of the likeliest value, which steps have not reached elsewhere. Deviations
        include the random walk from one knot to the next. Nothing is known where known places differ by less than their
        deviations, so that the stiffer one is not identified.

        Args:
            fields: stiffness as it is now, shape [N].
            among: particles over which means are taken and that may be known, one at least, shape [N], bool.
        """
        covariance, likeliest = self._posterior(fields)
        logs = self._logs(fields)
        shares, logs = (each - each[:, among].mean(axis=1, keepdims=True) for each in (self._shares, logs))
        expected = np.sqrt(np.square(shares).sum(axis=2))
        sd = np.sqrt(np.einsum("fnk,kl,fnl->fn", shares, covariance, shares))
        apart = np.abs(logs - shares @ likeliest)
        known = among & (sd < LIMIT) & (sd <= 0.5 * expected) & (apart <= sd)
        for values, deviations, which in zip(logs, sd, known, strict=True):
            if which.sum() < 3 or values[which].std() < np.median(deviations[which]):  # three make a triangle
                which[:] = False
        # Standard deviation of the difference of log stiffness between neighbouring knots, before anything is observed.
        stray = 0.55 * np.sqrt((self._shares * (1 - self._shares)).sum(axis=2))
        return np.hypot(sd, stray), known

    def _posterior(self, fields: Stiffness) -> tuple[np.ndarray, np.ndarray]:
        """Return the covariance of all numbers, shape [K, K], and their likeliest values relative to the first ones,
        shape [K].

        The noise is what these leave of the motion, not what the fields of each frame did, which had to be learnt.
        """
        of_field = self._shares.any(axis=1).astype(float)
        # Log stiffness at a knot is known to 1 about its level. The level about the stiffness to begin with is as good
        # as unknown: with 0 in place of 3 the map depended on that. On twelve drawn pulls 0, 1, 2 and 3 made no
        # difference to how often intervals hold.
        prior = np.linalg.inv(np.eye(self._shares.shape[2]) + 3.0**2 * of_field.T @ of_field)
        precision, likeliest = prior, self._projected @ self._logs(fields).ravel()
        some = self._points > 0
        squares, shared, points = self._squares[some], self._shared[some], self._points[some]
        for _ in range(4 if some.any() else 0):  # the likeliest values and, with them, the noise
            way = np.append(1.0, -likeliest)
            left, common = (np.maximum(np.einsum("i,cij,j->c", way, each, way), 0.0) for each in (squares, shared))
            # Of a cell's points in a frame so many err together, and so do all frames.
            together = np.maximum(points * common.sum() / max(left.sum(), 1e-300), self._frames)
            weight = 1 / (together * (left / (self._axes * points) + 0.3**2))  # points err by 0.3 px at least, by axis
            precision = prior + np.einsum("c,ckl->kl", weight, squares[:, 1:, 1:])
            likeliest = np.linalg.solve(precision, weight @ squares[:, 1:, 0])
        return np.linalg.inv(precision), likeliest

    def _logs(self, fields: Stiffness) -> np.ndarray:
        """Log stiffness of distances and of shapes, over that to begin with, shape [2, N]."""
        return np.log(fields[:2]) - self._begun
