"""The file of `infer.py --calibration`: what is known in newtons, and what was measured to compare with.

Two kinds are read: this program's own (fields of `CalibrationFile`), and calibration.json of `calibrate.py palpation`
with a sheet's thickness in it.

The simulator knows k_s, k_d and F up to one factor c, newtons a unit of force: in N per scene unit k_s is c·k_s, and F
is c·F. A property that contacts share gives c elsewhere: either the mass of a vertex, as in the simulator (Bini 2026,
table 1), so that c is the same, or the tissue's stiffness, so that c·k_s is the same. Then log c = g + bᵀφ with one
unknown g, and with b = 0 or b = (-1, 0, 0). All are logarithms with normal errors, so covariances follow exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from palpate.common.settings import require_numbers
from palpate.data.clip import ClipStream
from palpate.data.depth.sources import FARTHEST, NEAREST
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError, from_mapping, read_mapping
from palpate.estimators.estimate import NINETY, NoEstimate
from palpate.estimators.known_force import LEAST_KNOWN, KnownForce, fit_factor, read_forces
from palpate.estimators.palpated import palpated_young
from palpate.estimators.records import InteractionEstimate
from palpate.physics.identifiability import LIMIT, covariance
from palpate.physics.mechanics import PARAMETERS

SHEET_FACTOR = 0.75
"""k_s over E·thickness: the stiffness of a sheet of the mesh's springs, averaged over directions. With two sides and a
diagonal in every square its area modulus is k_s, its shear modulus k_s/2 and so its Young's modulus 4/3 k_s."""
MASS, STIFFNESS = "mass", "stiffness"
EXPONENTS = {MASS: np.zeros(3), STIFFNESS: np.array([-1.0, 0.0, 0.0])}
"""b by the property that contacts share."""
FORCE_ROW = np.array([0.0, 0.0, 1.0])
"""Row that picks log |F| from φ."""


@dataclass(frozen=True)
class ClipLength:
    """Length of a scene unit of a clip."""

    scale: float
    """Depth that is one scene unit, in the depth source's unit."""
    metres: float | None = None
    """Length of a scene unit, where depth is metric or a length is stated [m]."""
    log_sd: float = 0.0
    """Standard deviation of the logarithm of `metres`."""
    stored: bool = False
    """Whether depth comes from files, whose unit is then taken to be the same in all clips."""
    by: str = ""
    """By what `metres` is known, or why it isn't where that is worth saying."""

    @classmethod
    def of(cls, clip: ClipStream) -> ClipLength:
        """As the clip itself tells it; raises as `stated` does."""
        metres, log_sd, by = clip.metres or (None, 0.0, "")
        own = cls(clip.scale, metres and clip.scale * metres, log_sd, clip.sources["depth"] == "stored", by)
        return own.stated(metres, log_sd, by, str(clip.source.path)) if own.stored and metres else own

    def stated(self, metres: float, log_sd: float, by: str, where: str) -> ClipLength:
        """The same where a file, named by `where`, states the length of a unit of depth [m].

        Raises:
            InputError: tissue would lie nearer or farther away than NEAREST and FARTHEST.
        """
        if (unit := self.scale * metres) > FARTHEST or unit < NEAREST:
            raise InputError(f"{where}: by metres_per_depth {metres:g} tissue is {unit:g} m away; give metres.")
        return replace(self, metres=unit, log_sd=log_sd, by=by)

    @property
    def record(self) -> dict[str, Any]:
        """The same in words and millimetres, with a 90 % interval."""
        if self.metres is None or not math.isfinite(self.metres):
            return {"mm": None, "by": self.by, "says": "scene units are not metric"}
        mm, half = 1000 * self.metres, math.exp(NINETY * self.log_sd)
        says = f"1 scene unit = {mm:.3g} mm ({mm / half:.3g} to {mm * half:.3g}), metric by {self.by}"
        return {"mm": mm, "mm_low": mm / half, "mm_high": mm * half, "by": self.by, "says": says}

    def over(self, other: ClipLength) -> float | None:
        """A scene unit of this clip over that of another; None where it isn't known."""
        if self.metres is not None and other.metres is not None:
            return self.metres / other.metres
        return self.scale / other.scale if self.stored and other.stored else None


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
    """Whether the model explains the motion."""

    @classmethod
    def of(cls, run: InteractionEstimate) -> PressedRun | None:
        """Summarise a run; None where it has no estimate, or a parameter is zero."""
        found, contact = run.estimate, run.interaction
        if found is None or contact is None or not np.all(found.theta):
            return None
        end = run.onset_time_s + (contact.load_seconds if run.load_s is None else run.load_s)
        expected = covariance(found.verdict_information) if found.covariance is not None else None
        known = np.log(np.abs(found.theta)), found.covariance, expected, found.explained
        return cls(run.onset_frame, run.onset_time_s, end, *known)

    def pressing(self, times: np.ndarray) -> np.ndarray:
        """Whether the force acts at some times, shape as given, bool."""
        return (times >= self.begin - 1e-9) & (times < self.end - 1e-9)


@dataclass(frozen=True, eq=False)
class ForceScale:
    """The scale that turns estimates of a clip into newtons."""

    log: float
    """g: log c, or log of c·k_s [N per unit of force, or N per scene unit]."""
    variance: float
    """Variance of g."""
    homogeneous: str
    """The property that contacts share, MASS or STIFFNESS."""
    source: str
    """Where the scale comes from, in words."""
    used: dict[int, float]
    """Weight in g of every run of this clip that determined it, by the number of its first frame."""
    metric: bool = False
    """Whether g comes from a stiffness in N/m, and so depends on the length of a scene unit."""

    def elsewhere(self, here: ClipLength, there: ClipLength) -> ForceScale:
        """The scale of another clip.

        c is a mass times the length of a scene unit over a time squared, c·k_s a stiffness in N/m times that length.

        Raises:
            NoEstimate: the ratio of the clips' scene units isn't known.
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
        to_physical = np.eye(3) + EXPONENTS[self.homogeneous]
        metric = length.metres is not None
        mean = to_physical @ run.logs + self.log
        if length.metres is not None:
            mean[:2] -= math.log(length.metres)
        length_error = np.array([self.metric - metric, self.metric - metric, self.metric], np.float64) * length.log_sd
        weight = self.used.get(run.onset_frame, 0.0)

        def spread(own: np.ndarray | None) -> np.ndarray | None:
            if own is None:
                return None
            # Where this run determined g, g = … - weight·(F's row)·φ.
            shared = -weight * to_physical @ own @ (FORCE_ROW + EXPONENTS[self.homogeneous])
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
    """Whether stiffness and damping are per metre."""

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


def scale_by_force(runs: Sequence[PressedRun], forces: list[KnownPress], homogeneous: str, source: str) -> ForceScale:
    """Scale from forces that are known in some runs.

    Args:
        runs: the runs of a clip.
        forces: those that are known.
        homogeneous: the property that contacts share, MASS or STIFFNESS.
        source: where the forces come from, in words.

    Raises:
        NoEstimate: the estimated force of none of these runs is determined.
    """
    by_frame, row = {run.onset_frame: run for run in runs}, FORCE_ROW + EXPONENTS[homogeneous]
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
            name = "force" if homogeneous == MASS else "force over stiffness"
            why = f"the estimated {name} of the run at frame {frame}, whose force is known, is not determined"
            continue
        own = 0.0 if run.covariance is None else float(row @ run.covariance @ row)
        found[frame] = math.log(force) - float(row @ run.logs), log_sd**2 + own
    if not found:
        raise NoEstimate(f"No results in newtons: {why}.")
    precise = {frame: 1 / max(variance, 1e-12) for frame, (_, variance) in found.items()}
    total = sum(precise.values())
    weights = {frame: value / total for frame, value in precise.items()}
    log = sum(weights[frame] * value for frame, (value, _) in found.items())
    variance = sum(weights[frame] ** 2 * spread for frame, (_, spread) in found.items())
    return ForceScale(log, variance, homogeneous, source, weights)


def measured_presses(runs: Sequence[PressedRun], measured: KnownForce, known: tuple[float, float]) -> list[KnownPress]:
    """Forces of the runs that were measured within some seconds, as `scale_by_force` takes them.

    The model's force is constant while it acts, so a run's force is the mean of the measurements in that time.
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
        log_sd: standard deviation of the stiffness's logarithm.
        metric: whether the stiffness is in N/m.
        length: length of a scene unit.
        source: where the stiffness comes from, in words.

    Raises:
        NoEstimate: the stiffness is in N/m, and the length of a scene unit isn't known.
    """
    log = math.log(value)
    if metric:
        if length.metres is None:
            raise NoEstimate(
                "No results in newtons: the stiffness is known in N/m, and the length of a scene unit isn't; "
                "give metres_per_depth."
            )
        log += math.log(length.metres)
    return ForceScale(log, log_sd**2, STIFFNESS, source, {}, metric)


REFERENCES = ("force_N", "known_s", "stiffness", "palpation")
"""Fields of which one at most tells newtons."""


@dataclass(frozen=True)
class CalibrationFile:
    """Fields of the file.

    Raises:
        ValueError: fields that don't belong together, or numbers that can't be.
    """

    force_N: float | None = None
    """A known force, its magnitude [N]."""
    force_sd_N: float = 0.0
    """Its standard deviation [N]."""
    force_time_s: float | None = None
    """When it acted: in the run of contact under way then, in the clip's time [s]."""
    measured: str | None = None
    """Measured forces, a CSV file next to this one with the columns time_s (in the clip's time) and force_N."""
    known_s: tuple[float, float] | None = None
    """The part of `measured` that tells the scale [s]; the rest is compared. None = all of it is compared only."""
    stiffness: float | None = None
    """Stiffness k_s of the tissue's sheet of springs, at all contacts."""
    stiffness_sd: float = 0.0
    """Its standard deviation."""
    stiffness_unit: Literal["N/m", "N/scene unit"] = "N/m"
    palpation: str | None = None
    """calibration.json or curves.csv of calibrate.py, next to this file: E, of which k_s is three quarters, times
    `thickness_m`."""
    thickness_m: float | None = None
    """Of the sheet that the tissue's surface is [m]."""
    thickness_sd_m: float = 0.0
    """Its standard deviation [m]."""
    homogeneous: Literal["mass", "stiffness"] = MASS
    """What contacts have in common where a force is known: the mass of a vertex, as the simulator has it, or the
    tissue's stiffness."""
    clip: str | None = None
    """Folder or file name of the clip in which the force is known, where there are several."""
    metres_per_depth: float | None = None
    """Length of a unit of the clips' depth [m]; none = as metric depth has it, else not known."""
    metres_per_depth_sd: float = 0.0
    """Its standard deviation [m]."""

    def __post_init__(self) -> None:
        given = [name for name in REFERENCES if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)} each tell newtons; give one.")
        if not given and self.measured is None:
            raise ValueError(f"nothing is known; give one of {', '.join(REFERENCES)}, or measured.")
        if (self.force_N is None) != (self.force_time_s is None):
            raise ValueError("force_N and force_time_s belong together; give both.")
        if self.known_s is not None and self.measured is None:
            raise ValueError("known_s is a part of measured; give that.")
        if (self.palpation is None) != (self.thickness_m is None):
            raise ValueError("palpation and thickness_m belong together; give both.")
        otherwise = bool(given) and given[0] not in ("force_N", "known_s")
        if self.homogeneous == STIFFNESS and otherwise:
            raise ValueError(f"homogeneous is for a known force; leave it out next to {given[0]}.")
        if self.clip is not None and otherwise:
            raise ValueError(f"clip names that of a known force; leave it out next to {given[0]}.")
        deviations = ("force_sd_N", "stiffness_sd", "thickness_sd_m", "metres_per_depth_sd")
        values = ("force_N", "stiffness", "thickness_m", "metres_per_depth")
        require_numbers(self, positive=values, not_negative=deviations)
        if self.known_s is not None and not self.known_s[0] < self.known_s[1]:
            raise ValueError(f"known_s is {list(self.known_s)}; give a beginning before an end.")


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is known in newtons, read."""

    fields: CalibrationFile
    path: Path
    files: tuple[Path, ...]
    """It and those that it names."""
    measured: KnownForce | None
    young: tuple[float, float] | None
    """E of the palpations [Pa] and the standard deviation of its logarithm."""

    @property
    def of_one_clip(self) -> bool:
        """Whether a force tells the scale, which acted in one clip."""
        return self.fields.force_N is not None or self.fields.known_s is not None

    @property
    def leans_on_a_clip(self) -> bool:
        """Whether some of it belongs to one clip alone."""
        return self.of_one_clip or self.measured is not None

    @property
    def tells(self) -> bool:
        """Whether anything tells newtons."""
        return self.of_one_clip or self.fields.stiffness is not None or self.young is not None

    @property
    def known(self) -> KnownForce | None:
        """The measured forces that tell the scale."""
        if self.measured is None or self.fields.known_s is None:
            return None
        low, high = self.fields.known_s
        some = (low <= self.measured.times) & (self.measured.times <= high)
        return KnownForce(self.measured.times[some], self.measured.force[some])

    def length(self, own: ClipLength) -> ClipLength:
        """What a scene unit of a clip is, as the file states it, else as the clip itself tells.

        Raises:
            InputError: as of `ClipLength.stated`.
        """
        stated, sd = self.fields.metres_per_depth, self.fields.metres_per_depth_sd
        if stated is None:
            return own
        return own.stated(stated, sd / stated, f"metres_per_depth in {self.path.name}", str(self.path))

    def scale(self, runs: Sequence[PressedRun], length: ClipLength) -> ForceScale:
        """The scale of a clip from its own runs, or from the tissue's stiffness.

        Raises:
            NoEstimate: why there is none.
        """
        given = self.fields
        if given.force_N is not None and given.force_time_s is not None:
            at = np.array([given.force_time_s])
            here = [run for run in runs if run.pressing(at)[0]]
            if not here:
                raise NoEstimate(
                    f"No results in newtons: no press was estimated in contact at {given.force_time_s:g} s, when "
                    "the force is known."
                )
            frame, log_sd = here[0].onset_frame, given.force_sd_N / given.force_N
            source = f"known force of {given.force_N:g} N at frame {frame}"
            return scale_by_force(runs, [(frame, given.force_N, log_sd)], given.homogeneous, source)
        if given.known_s is not None and self.measured is not None:
            forces = measured_presses(runs, self.measured, given.known_s)
            if not forces:
                raise NoEstimate(
                    f"No results in newtons: in no run of contact with an estimate {LEAST_KNOWN} or more forces "
                    "are known."
                )
            frames = ", ".join(str(frame) for frame, *_ in forces)
            return scale_by_force(runs, forces, given.homogeneous, f"forces measured at frame {frames}")
        if given.stiffness is not None:
            source = f"known stiffness of {given.stiffness:g} {given.stiffness_unit}"
            log_sd, metric = given.stiffness_sd / given.stiffness, given.stiffness_unit == "N/m"
            return scale_by_stiffness(given.stiffness, log_sd, metric, length, source)
        if self.young is None or given.thickness_m is None:
            raise NoEstimate("Nothing that the file holds tells newtons.")
        young, young_sd = self.young
        log_sd = math.hypot(young_sd, given.thickness_sd_m / given.thickness_m)
        source = f"palpation, E = {young:.4g} Pa, in a sheet of {1000 * given.thickness_m:g} mm"
        return scale_by_stiffness(SHEET_FACTOR * young * given.thickness_m, log_sd, True, length, source)


def read_calibration(path: Path) -> Calibration:
    """Read a file of what is known in newtons.

    Raises:
        InputError: it, or a file that it names, can't be read or can't be.
    """
    values = read_mapping(path, "a calibration")
    if "young_pa" in values:
        if "thickness_m" not in values:
            raise InputError(
                f"{printable(path)} holds no thickness_m, without which E tells no stiffness of a sheet; give "
                "calibrate.py palpation --sheet-thickness, or a YAML file with palpation and thickness_m."
            )
        values = {"palpation": path.name, "thickness_m": values["thickness_m"]}
    given = from_mapping(CalibrationFile, values, printable(path))
    files, measured, young = [path], None, None
    if given.measured is not None:
        files.append(path.parent / given.measured)
        measured = read_forces(files[-1])
    if given.palpation is not None:
        files.append(path.parent / given.palpation)
        young = palpated_young(files[-1])
    return Calibration(given, path, tuple(dict.fromkeys(files)), measured, young)
