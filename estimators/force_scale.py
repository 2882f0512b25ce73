"""Newtons for what is estimated in scene units: one scale, from a known force, a known stiffness or palpations.

The simulator knows k_s, k_d and F up to one factor c, newtons a unit of force: in N per scene unit k_s is c·k_s, and
F is c·F. What contacts have in common tells c elsewhere: the mass of a vertex, as the simulator has it (Bini 2026,
table 1), so that c is the same, or the tissue's stiffness, so that c·k_s is. Then log c = g + bᵀφ with one unknown g,
and with b = 0 or b = (-1, 0, 0). All are logarithms with normal errors, of which covariances follow exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.estimate import InteractionEstimate, NoEstimate
from estimators.known_force import LEAST_KNOWN, KnownForce, fit_factor
from physics.identifiability import LIMIT, covariance
from physics.mechanics import PARAMETERS

SHEET = 0.75
"""k_s over E·thickness: the stiffness of a sheet of the mesh's springs, averaged over directions. With two sides and a
diagonal in every square its area modulus is k_s, its shear modulus k_s/2 and so its Young's modulus 4/3 k_s."""
MASS, STIFFNESS = "mass", "stiffness"
SHARES = {MASS: np.zeros(3), STIFFNESS: np.array([-1.0, 0.0, 0.0])}
"""b by what contacts have in common."""
FORCE = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class ClipLength:
    """What a scene unit of a clip is."""

    scale: float
    """Depth that is one scene unit, in the depth source's unit."""
    metres: float | None = None
    """Of a scene unit, where depth is metric or a length is stated [m]."""
    log_sd: float = 0.0
    """Standard deviation of its logarithm."""
    stored: bool = False
    """Whether depth comes from files, whose unit is then taken to be the same in all clips."""

    def over(self, other: ClipLength) -> float | None:
        """A scene unit of this clip over that of another; None where nobody knows."""
        if self.metres is not None and other.metres is not None:
            return self.metres / other.metres
        return self.scale / other.scale if self.stored and other.stored else None


@dataclass(frozen=True, eq=False)
class PressedRun:
    """What is kept of a run of contact that has an estimate; all logarithms are of k_s, k_d and |F|."""

    onset_frame: int
    """Number of its first frame in contact."""
    begin: float
    """Time stamp of that frame [s]."""
    end: float
    """When contact ended, or was seen last [s]."""
    logs: np.ndarray
    """φ, shape [3]."""
    covariance: np.ndarray | None
    """Of φ, shape [3, 3]; None from an estimator that knows none."""
    expected: np.ndarray | None
    """The same by which its verdict is given."""
    explained: bool
    """Whether the model explains the motion."""

    @classmethod
    def of(cls, run: InteractionEstimate) -> PressedRun | None:
        """Of a run; None where it has no estimate, or one at zero."""
        found, contact = run.estimate, run.interaction
        if found is None or contact is None or not np.all(found.theta):
            return None
        told = found.covariance is not None
        return cls(
            run.onset_frame,
            run.onset_time_s,
            run.onset_time_s + (contact.load_seconds if run.load_s is None else run.load_s),
            np.log(np.abs(found.theta)),
            found.covariance,
            covariance(found.verdict_information) if told else None,
            found.explained,
        )

    def pressing(self, times: np.ndarray) -> np.ndarray:
        """Whether the force acts at some times, shape as given, bool."""
        return (times >= self.begin - 1e-9) & (times < self.end - 1e-9)


@dataclass(frozen=True, eq=False)
class ForceScale:
    """What turns estimates of a clip into newtons."""

    log: float
    """g: log c, or log of c·k_s [N per unit of force, or N per scene unit]."""
    variance: float
    """Of g."""
    alike: str
    """What contacts have in common, MASS or STIFFNESS."""
    source: str
    """What it comes from, in words."""
    used: dict[int, float]
    """Runs of this clip that told it by their first frames' numbers, with the weight of each in g."""
    metric: bool = False
    """Whether g comes from a stiffness in N/m, and so leans on the length of a scene unit."""

    def elsewhere(self, here: ClipLength, there: ClipLength) -> ForceScale:
        """The scale of another clip.

        c is a mass times the length of a scene unit over a time squared, c·k_s a stiffness in N/m times that length.

        Raises:
            NoEstimate: how long a scene unit of one is in the other's isn't known.
        """
        longer = there.over(here)
        if longer is None:
            raise NoEstimate(
                "A scene unit of the clip with the known force can't be compared with this clip's; give "
                "metres_per_depth."
            )
        return replace(self, log=self.log + math.log(longer), used={})

    def of(self, run: PressedRun, length: ClipLength) -> Physical:
        """A run in physical units."""
        to_physical = np.eye(3) + SHARES[self.alike]
        metric = length.metres is not None
        mean = to_physical @ run.logs + self.log
        if length.metres is not None:
            mean[:2] -= math.log(length.metres)
        leans = np.array([self.metric - metric, self.metric - metric, self.metric], np.float64) * length.log_sd
        weight = self.used.get(run.onset_frame, 0.0)

        def spread(own: np.ndarray | None) -> np.ndarray | None:
            if own is None:
                return None
            # g = … - weight·(F's row)·φ where this run told it.
            shared = -weight * to_physical @ own @ (FORCE + SHARES[self.alike])
            found = to_physical @ own @ to_physical.T + shared[:, None] + shared + self.variance
            return found + np.outer(leans, leans)

        return Physical(mean, spread(run.covariance), spread(run.expected), metric)


@dataclass(frozen=True, eq=False)
class Physical:
    """A run of contact in physical units."""

    logs: np.ndarray
    """Of k_s, k_d and |F|, shape [3] [N/m, N·s/m and N; without a known length per scene unit]."""
    covariance: np.ndarray | None
    """Of them, shape [3, 3]."""
    expected: np.ndarray | None
    """The same by which the verdict is given."""
    metric: bool
    """Whether stiffness and damping are per metre."""

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of what is known to within a factor e on either side of one standard deviation."""
        if self.expected is None:
            return ()
        sure = np.sqrt(np.maximum(np.diag(self.expected), 0)) < LIMIT
        return tuple(name for name, known in zip(PARAMETERS, sure, strict=True) if known)

    @property
    def log_sd(self) -> np.ndarray | None:
        """Standard deviations of the logarithms, shape [3]."""
        return None if self.covariance is None else np.sqrt(np.maximum(np.diag(self.covariance), 0))


def scale_by_force(
    runs: Sequence[PressedRun], forces: Sequence[tuple[int, float, float]], alike: str, source: str
) -> ForceScale:
    """Scale from forces that are known in some runs.

    Args:
        runs: of a clip.
        forces: first frame of a run, its force [N] and the standard deviation of the force's logarithm.
        alike: MASS or STIFFNESS.
        source: in words.

    Raises:
        NoEstimate: none of these runs tells a force well enough.
    """
    by_frame, row = {run.onset_frame: run for run in runs}, FORCE + SHARES[alike]
    found: dict[int, tuple[float, float]] = {}
    why = "no press was estimated in the run of contact whose force is known"
    for frame, force, log_sd in forces:
        run = by_frame.get(frame)
        if run is None:
            continue
        if not run.explained:
            why = f"the model does not explain the motion of the run at frame {frame}, whose force is known"
            continue
        if run.expected is not None and not row @ run.expected @ row < LIMIT**2:
            name = "force" if alike == MASS else "force over stiffness"
            why = f"the estimated {name} of the run at frame {frame}, whose force is known, is not determined"
            continue
        own = 0.0 if run.covariance is None else float(row @ run.covariance @ row)
        found[frame] = math.log(force) - float(row @ run.logs), log_sd**2 + own
    if not found:
        raise NoEstimate(f"Nothing is told in newtons: {why}.")
    precise = {frame: 1 / max(variance, 1e-12) for frame, (_, variance) in found.items()}
    total = sum(precise.values())
    weights = {frame: value / total for frame, value in precise.items()}
    log = sum(weights[frame] * value for frame, (value, _) in found.items())
    variance = sum(weights[frame] ** 2 * spread for frame, (_, spread) in found.items())
    return ForceScale(log, variance, alike, source, weights)


def measured_presses(
    runs: Sequence[PressedRun], measured: KnownForce, known: tuple[float, float]
) -> list[tuple[int, float, float]]:
    """Forces of the runs that were measured within some seconds, as `scale_by_force` takes them.

    The model's force is constant while it acts, so a run's is the mean of what was measured meanwhile.
    """
    found = []
    for run in runs:
        here = run.pressing(measured.times) & (known[0] <= measured.times) & (measured.times <= known[1])
        force = np.abs(measured.force[here])
        if len(force) >= LEAST_KNOWN and force.mean() > 0:
            factor, variance, _ = fit_factor(np.ones(len(force)), force)
            found.append((run.onset_frame, factor, math.sqrt(variance) / factor))
    return found


def scale_by_stiffness(value: float, log_sd: float, metric: bool, length: ClipLength, source: str) -> ForceScale:
    """Scale from the stiffness k_s that the tissue has at all contacts.

    Args:
        value: k_s [N/m, or N per scene unit].
        log_sd: standard deviation of its logarithm.
        metric: whether it is in N/m.
        length: of a scene unit.
        source: in words.

    Raises:
        NoEstimate: it is in N/m, and nobody knows how long a scene unit is.
    """
    log = math.log(value)
    if metric:
        if length.metres is None:
            raise NoEstimate(
                "Nothing is told in newtons: the stiffness is known in N/m, and the length of a scene unit isn't; "
                "give metres_per_depth."
            )
        log += math.log(length.metres)
    return ForceScale(log, log_sd**2, STIFFNESS, source, {}, metric)
