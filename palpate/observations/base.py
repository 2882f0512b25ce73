"""Base of observations, and the likelihood of one motion under several of them."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, Self

import numpy as np

from palpate.data.contact.interaction import Interaction, Recorder
from palpate.data.prepared import PreparedFrame
from palpate.data.shading.sequence import RestingLight
from palpate.physics.likelihood import LeastSquares
from palpate.physics.observation import Linearised


class Parameter(NamedTuple):
    """A nuisance parameter."""

    mean: float
    """Mean of its normal prior."""
    sd: float
    """Standard deviation of the prior."""
    reach: float
    """Largest distance from the mean."""
    least: float = -np.inf
    """Smallest value."""


class Series:
    """Record of one value a frame, and the recorder of what a function gives for each; None = nothing.

    `times` are those since the onset, shape [N] [s]; `values` have shape [N, …].
    """

    def __init__(self, shown: Callable[[PreparedFrame], Any], times: Any = (), values: Any = ()) -> None:
        self._shown, self.times, self.values = shown, np.array(times), np.array(values)

    def frame(self, frame: PreparedFrame) -> Any | None:
        """See `Recorder`."""
        return self._shown(frame)

    def record(self, times: np.ndarray, values: list[Any], _: int) -> Series:
        """See `Recorder`."""
        return Series(self._shown, times, values)

    def chosen(self, instants: np.ndarray) -> Series:
        """Return the observation at some of its instants: a mask [N] or indices."""
        return Series(self._shown, self.times[instants], self.values[instants])


class Observation:
    """One kind of observation of a run of contact: N instants, V vertices of the mesh, E parameters of its own.

    Args:
        contact: run whose record of this kind is compared.
    """

    times: np.ndarray
    """Times since the onset, shape [N] [s]."""
    vertices: np.ndarray
    """Vertices whose motion is needed, shape [V]."""
    nuisance: Sequence[Parameter] = ()
    quick = False
    """True if `look` needs neither derivatives nor double precision."""

    def __init__(self, contact: Interaction) -> None:
        self.contact = contact

    @staticmethod
    def shown(frame: PreparedFrame, onset: PreparedFrame) -> Any:
        """Return what a frame shows since the onset, a number or an array; None = nothing."""
        raise NotImplementedError

    @classmethod
    def recorder(cls, onset: PreparedFrame, size: tuple[int, int], rest: RestingLight | None) -> Recorder | None:
        """Begin to record a run, by default as a `Series` of what `shown` returns; None where nothing can be.

        Args:
            onset: first frame in contact.
            size: width and height of the pictures [px].
            rest: light before contact, where it is known.
        """
        return Series(lambda frame: cls.shown(frame, onset))

    def look(self, moved: np.ndarray, slopes: np.ndarray, logs: np.ndarray, *, outliers: bool = False) -> None:
        """Decide near the best motion what is then kept; arguments as in `linearise`.

        Args:
            outliers: whether values that lie far from that motion count less from now on.
        """

    def linearise(self, moved: np.ndarray, slopes: np.ndarray, logs: np.ndarray) -> Linearised:
        """Return whitened residuals [K] and their derivatives by all parameters [K, D + E].

        Args:
            moved, slopes: displacements [N, V, 3] and their derivatives by the motion's parameters [N, V, 3, D].
            logs: these parameters, and the observation's own behind them, shape [D + E].
        """
        raise NotImplementedError

    def misfit(self, moved: np.ndarray, logs: np.ndarray) -> float:
        """Return the root mean square of the residuals; arguments as in `linearise`."""
        slopes = np.zeros((*moved.shape, len(logs) - len(self.nuisance)))
        return float(np.sqrt(np.square(self.linearise(moved, slopes, logs).residual).mean()))

    @staticmethod
    def features(contact: Interaction, within: float) -> np.ndarray:
        """Return what networks are given of a contact, a vector.

        Args:
            within: the press began, and ended, at most so long before or after the time stamps [s].
        """
        raise NotImplementedError


class JointLikelihood(LeastSquares):
    """One motion under several observations: their whitened residuals, one below the other.

    Parameters are the motion's, then those of each observation.

    Args:
        observations: one or more.
        motion_of: makes the motion of vertices [V] at instants [N], as in `estimators.direct.motion`.
    """

    def __init__(self, observations: Sequence[Any], motion_of: Callable[[np.ndarray, np.ndarray], Any]) -> None:
        vertices = np.unique(np.concatenate([each.vertices for each in observations]))
        times = np.unique(np.concatenate([each.times for each in observations]))
        self.observations, self.motion = tuple(observations), motion_of(vertices, times)
        self._places = [
            np.ix_(np.searchsorted(times, each.times), np.searchsorted(vertices, each.vertices))
            for each in observations
        ]
        self._nuisance = [parameter for each in observations for parameter in each.nuisance]
        self._last: tuple[np.ndarray, tuple[np.ndarray, np.ndarray]] | None = None
        self.offset: np.ndarray | float = 0.0
        """Error of the simulator's own steps, subtracted from all displacements, shape [N, V, 3] [scene units]."""

    @property
    def first(self) -> Any:
        """The first of the observations."""
        return self.observations[0]

    def press(self, logs: np.ndarray) -> np.ndarray:
        """Return parameters of the motion alone, shape [D]."""
        return logs[: len(logs) - len(self._nuisance)]

    def box(self, tissue: np.ndarray) -> np.ndarray:
        """Return the lower and upper ends of all parameters [2, D + E], from those of φ [2, 3]."""
        own = [(max(each.mean - each.reach, each.least), each.mean + each.reach) for each in self._nuisance]
        return np.hstack([self.motion.box(tissue), np.array(own).reshape(-1, 2).T])

    def started(self, press: np.ndarray) -> np.ndarray:
        """Return all parameters from those of the motion, the others as in their priors."""
        return np.append(press, [each.mean for each in self._nuisance])

    def misfit(self, logs: np.ndarray) -> float:
        """Return the largest misfit of the observations."""
        moved = self._moved(logs)[0] + self.offset
        return max(each.misfit(moved[place], logs[own]) for each, place, own in self._each(logs))

    def _each(self, logs: np.ndarray) -> Iterator[tuple[Any, Any, np.ndarray]]:
        """Yield every observation, its instants and vertices among all, and the places of its parameters."""
        count = first = len(self.press(logs))
        for each, place in zip(self.observations, self._places, strict=True):
            own = np.arange(first, first + len(each.nuisance))
            yield each, place, np.concatenate([np.arange(count), own])
            first += len(own)

    def look(self, logs: np.ndarray, *, finer: bool = False, outliers: bool = False) -> None:
        """Let every observation decide what is kept, by parameters [D + E] near the best.

        Args:
            finer: whether the error of the simulator's steps is measured there, and subtracted from now on.
            outliers: whether values that lie far from that motion count less from now on.
        """
        if all(each.quick for each in self.observations):
            moved = self.motion.quick(self.press(logs))
            slopes = np.empty((*moved.shape, 0))
        else:
            moved, slopes = self._moved(logs)
        self.offset = self.motion.finer(self.press(logs)) - moved if finer else 0.0
        for each, place, own in self._each(logs):
            each.look((moved + self.offset)[place], slopes[place], logs[own], outliers=outliers)
        self._known = None

    def _moved(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the motion of some parameters and its derivatives; the last ones are remembered."""
        press, last = self.press(logs), self._last
        if last is None or not np.array_equal(press, last[0]):
            last = self._last = np.array(press), self.motion.at(press)
        return last[1]

    def _linearise(self, logs: np.ndarray) -> Linearised:
        moved, slopes = self._moved(logs)
        moved, residuals, jacobians = moved + self.offset, [], []
        for each, place, own in self._each(logs):
            found = each.linearise(moved[place], slopes[place], logs[own])
            jacobian = np.zeros((len(found.residual), len(logs)))
            jacobian[:, own] = found.jacobian
            residuals.append(found.residual)
            jacobians.append(jacobian)
        return Linearised(np.concatenate(residuals), np.concatenate(jacobians))

    def copy(self) -> Self:
        """Return a copy, which looks for itself from now on."""
        found = copy.copy(self)
        found.observations = tuple(map(copy.copy, self.observations))
        return found

    def coarser(self) -> Self:
        """Return the problem with larger steps, to search with; it has not looked at anything of its own yet."""
        found = self.copy()
        found.motion, found._last = self.motion.coarser(), None
        return found
