"""Newtons for scene units: one scale from a known force or a known stiffness, and the errors that follow.

The simulator knows k_s, k_d and F up to one factor c, newtons a unit of force. In N per scene unit k_s is c·k_s, and F
is c·F. A property that a clip's contacts share gives c in all of them. Either it is the mass of a vertex, as in the
simulator (Bini 2026, table 1), so that c is the same. Or it is the tissue's stiffness, so that c·k_s is the same. Then
log c = g + bᵀφ with one unknown g, and with b = 0 or b = (-1, 0, 0). All are logarithms with normal errors, so
covariances follow exactly.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from palpate.data.clip import ClipStream
from palpate.data.depth.sources import FARTHEST, NEAREST
from palpate.data.source.layout import InputError
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.known_force import LEAST_KNOWN, KnownForce, fit_factor
from palpate.estimators.records import InteractionEstimate
from palpate.physics.identifiability import LIMIT, NINETY, covariance
from palpate.physics.mechanics import PARAMETERS

SHEET_FACTOR = 0.75
"""k_s over E·thickness: the stiffness of a sheet of the mesh's springs, averaged over directions. With two sides and a
diagonal in every square its area modulus is k_s, its shear modulus k_s/2 and so its Young's modulus 4/3 k_s."""


@dataclass(frozen=True)
class ClipLength:
    """Length of a scene unit of a clip."""

    scale: float
    """Depth that is one scene unit, in the depth source's unit."""
    metres: float | None = None
    """Length of a scene unit, where depth is metric or a length is stated [m]."""
    log_sd: float = 0.0
    """Standard deviation of the logarithm of `metres`."""
    by: str = ""
    """Source of `metres`, or the reason why it isn't known where that is worth saying."""

    @classmethod
    def of(cls, clip: ClipStream) -> "ClipLength":
        """Return the length as the clip itself tells it.

        Raises:
            InputError: by its camera file tissue would lie nearer or farther away than NEAREST and FARTHEST.
        """
        metres, log_sd, by = clip.metres or (None, 0.0, "")
        unit = None if metres is None else clip.scale * metres
        if unit is not None and clip.sources["depth"] == "stored" and not NEAREST <= unit <= FARTHEST:
            text = f"by metres_per_depth {metres:g} tissue is {unit:g} m away; give metres."
            raise InputError(f"{clip.source.path}: {text}")
        return cls(clip.scale, unit, log_sd, by)

    @property
    def record(self) -> dict[str, Any]:
        """Description in words and millimetres, with a 90 % interval."""
        if self.metres is None or not math.isfinite(self.metres):
            return {"mm": None, "by": self.by, "says": "scene units are not metric"}
        mm, half = 1000 * self.metres, math.exp(NINETY * self.log_sd)
        says = f"1 scene unit = {mm:.3g} mm ({mm / half:.3g} to {mm * half:.3g}), metric by {self.by}"
        return {"mm": mm, "mm_low": mm / half, "mm_high": mm * half, "by": self.by, "says": says}


@dataclass(frozen=True, eq=False)
class PressedRun:
    """Summary of a run of contact that has an estimate; all logarithms are of k_s, k_d and |F|."""

    onset_frame: int
    """Number of the first frame in contact."""
    begin: float
    """Time stamp of that frame [s]."""
    end: float
    """Time at which contact ended, or was observed last [s]."""
    logs: np.ndarray
    """φ, shape [3]."""
    covariance: np.ndarray | None
    """Covariance of φ, shape [3, 3]; None from an estimator without uncertainty."""
    expected: np.ndarray | None
    """Covariance of φ by which the verdict is given, shape [3, 3]."""
    explained: bool
    """True if the model explains the motion."""

    @classmethod
    def of(cls, run: InteractionEstimate) -> "PressedRun | None":
        """Summarise a run; None where it has no estimate, or a parameter is zero."""
        found, contact = run.estimate, run.interaction
        if found is None or contact is None or not np.all(found.theta):
            return None
        end = run.onset_time_s + (contact.load_seconds if run.load_s is None else run.load_s)
        expected = covariance(found.verdict_information) if found.covariance is not None else None
        known = np.log(np.abs(found.theta)), found.covariance, expected, found.explained
        return cls(run.onset_frame, run.onset_time_s, end, *known)

    def pressing(self, times: np.ndarray) -> np.ndarray:
        """Return whether the force acts at some times, shape as given, bool."""
        return (times >= self.begin - 1e-9) & (times < self.end - 1e-9)


@dataclass(frozen=True, eq=False)
class ForceScale:
    """The scale that turns estimates of a clip into newtons."""

    log: float
    """Logarithm g of the scale: log c, or log of c·k_s [N per unit of force, or N per scene unit]."""
    variance: float
    """Variance of g."""
    homogeneous: Literal["mass", "stiffness"]
    """Property that contacts share."""
    source: str
    """Source of the scale, in words."""
    used: dict[int, float]
    """Weight in g of every run of this clip that determined it, by the number of its first frame."""

    def of(self, run: PressedRun, length: ClipLength) -> "Physical":
        """Convert a run to physical units."""
        known, metric = self.homogeneous == "stiffness", length.metres is not None
        powers = np.array([-1.0 * known, 0.0, 0.0])  # b
        to_physical = np.eye(3) + powers
        mean = to_physical @ run.logs + self.log
        if length.metres is not None:
            mean[:2] -= math.log(length.metres)
        # A known stiffness is per metre: what its contacts have per metre doesn't depend on a scene unit's length.
        length_error = np.array([known - metric, known - metric, known], np.float64) * length.log_sd
        weight = self.used.get(run.onset_frame, 0.0)

        def spread(own: np.ndarray | None) -> np.ndarray | None:
            if own is None:
                return None
            # Where this run determined g, g = … - weight·(F's row)·φ.
            # [0, 0, 1] picks log |F| from φ.
            shared = -weight * to_physical @ own @ (np.array([0.0, 0.0, 1.0]) + powers)
            found = to_physical @ own @ to_physical.T + shared[:, None] + shared + self.variance
            return found + np.outer(length_error, length_error)

        return Physical(mean, spread(run.covariance), spread(run.expected), metric)


@dataclass(frozen=True, eq=False)
class Physical:
    """A run of contact in physical units."""

    logs: np.ndarray
    """Logarithms of k_s, k_d and |F|, shape [3] [N/m, N·s/m, N; per scene unit where its length isn't known]."""
    covariance: np.ndarray | None
    """Covariance of `logs`, shape [3, 3]."""
    expected: np.ndarray | None
    """Covariance of `logs` by which the verdict is given, shape [3, 3]."""
    metric: bool
    """True if stiffness and damping are per metre."""

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of the parameters whose log standard deviation is below `physics.identifiability.LIMIT`."""
        if self.expected is None:
            return ()
        determined = np.sqrt(np.maximum(np.diag(self.expected), 0)) < LIMIT
        return tuple(name for name, known in zip(PARAMETERS, determined, strict=True) if known)

    @property
    def log_sd(self) -> np.ndarray | None:
        """Standard deviations of the logarithms, shape [3]."""
        return None if self.covariance is None else np.sqrt(np.maximum(np.diag(self.covariance), 0))


KnownPress = tuple[int, float, float]
"""First frame of a run, its force [N] and the standard deviation of the force's logarithm."""


def scale_by_force(runs: Sequence[PressedRun], forces: list[KnownPress], source: str) -> ForceScale:
    """Return the scale from forces that are known in some runs.

    Args:
        runs: the runs of a clip.
        forces: those that are known.
        source: where the forces come from, in words.

    Raises:
        NoEstimate: the estimated force of none of these runs is determined.
    """
    by_frame = {run.onset_frame: run for run in runs}
    found: dict[int, tuple[float, float]] = {}
    why = "no press was estimated in the run of contact whose force is known"
    for frame, force, log_sd in forces:
        run = by_frame.get(frame)
        if run is None:
            continue
        if not run.explained:
            why = f"the model does not explain the motion of the run at frame {frame}, whose force is known"
        elif run.expected is not None and not run.expected[2, 2] < LIMIT**2:
            why = f"the estimated force of the run at frame {frame}, whose force is known, is not determined"
        else:
            own = 0.0 if run.covariance is None else float(run.covariance[2, 2])
            found[frame] = math.log(force) - float(run.logs[2]), log_sd**2 + own
    if not found:
        raise NoEstimate(f"No results in newtons: {why}.")
    logs, variances = np.array([*found.values()]).T
    weights = 1 / np.maximum(variances, 1e-12)
    weights /= weights.sum()
    used = dict(zip(found, weights.tolist(), strict=True))
    return ForceScale(float(weights @ logs), float(weights**2 @ variances), "mass", source, used)


def measured_presses(runs: Sequence[PressedRun], measured: KnownForce) -> list[KnownPress]:
    """Return forces of the runs that were measured, as `scale_by_force` takes them.

    The model's force is constant while it acts, so a run's force is the mean of the measurements in that time.
    """
    found = []
    for run in runs:
        force = np.abs(measured.force[run.pressing(measured.times)])
        if len(force) >= LEAST_KNOWN and force.mean() > 0:
            factor, variance, _ = fit_factor(np.ones(len(force)), force)
            found.append((run.onset_frame, factor, math.sqrt(variance) / factor))
    return found


def scale_by_stiffness(value: float, log_sd: float, length: ClipLength, source: str) -> ForceScale:
    """Return the scale from the stiffness k_s that the tissue has at all contacts.

    Args:
        value: k_s [N/m].
        log_sd: standard deviation of the stiffness's logarithm.
        length: length of a scene unit.
        source: where the stiffness comes from, in words.

    Raises:
        NoEstimate: the length of a scene unit isn't known.
    """
    if length.metres is None:
        problem = "No results in newtons: the stiffness is known in N/m, and the length of a scene unit isn't;"
        raise NoEstimate(f"{problem} give metres_per_depth in the camera file, or --shaft-diameter.")
    return ForceScale(math.log(value * length.metres), log_sd**2, "stiffness", source, {})
