"""Newtons of one clip: calibrated.csv, a row a run of contact, and measured forces compared with estimated ones."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from palpate.estimators.calibration_file import Calibration
from palpate.estimators.estimate import NINETY, Estimate, NoEstimate
from palpate.estimators.force_scale import ClipLength, ForceScale, Physical, PressedRun
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.known_force import ForceCurve, KnownForce, predict_force
from palpate.estimators.records import InteractionEstimate
from palpate.physics.identifiability import covariance
from palpate.physics.mechanics import PARAMETERS
from palpate.results.columns import TEXTS

NUMBERS = ("measured_N", "estimated", "estimated_low", "estimated_high")
NEWTONS, NORMALISED = "N", "scene units"
LEAST_COMPARED = 3
"""Forces, of which scale and correlation are given."""


@dataclass(frozen=True, eq=False)
class Curve:
    """An estimated force over time; T instants."""

    onset_frame: int
    times: np.ndarray
    """Shape [T] [s]."""
    force: np.ndarray
    """Shape [T], in `unit`."""
    low: np.ndarray
    """Shape [T]; not a number where it isn't known."""
    high: np.ndarray
    """Likewise."""
    unit: str
    """NEWTONS or NORMALISED."""

    @classmethod
    def of(cls, onset_frame: int, times: np.ndarray, found: ForceCurve) -> "Curve":
        """Curve of forces [N] with their 90 % interval."""
        half = NINETY * found.sd
        return cls(onset_frame, times, found.force, found.force - half, found.force + half, NEWTONS)


@dataclass
class ClipCalibration:
    """Gathers what a clip tells, and says it in newtons.

    Args:
        calibration: what is known.
        home: whether what was measured, or is known of a force, belongs to this clip.
        carried: the scale of another clip and its length, where the force is known there; or why there is none.
    """

    calibration: Calibration
    home: bool = True
    carried: tuple[ForceScale, ClipLength] | str | None = None
    scale: ForceScale | None = None
    """Of this clip, once it has been concluded."""
    length: ClipLength | None = None
    """Likewise, or set before where newtons are told on the way."""
    rows: list[dict[str, Any]] = field(default_factory=list)
    """Of calibrated.csv, likewise."""
    curves: list[Curve] = field(default_factory=list)
    """Estimated forces where some were measured, likewise."""
    reason: str = ""
    """Why there is no scale."""

    def __post_init__(self) -> None:
        self._runs: list[tuple[int, float, PressedRun | None]] = []
        self._pulls: list[Curve] = []
        self._unknown_pull = ""
        self.known = self.calibration.known if self.home else None
        """Forces that tell the scale of this clip's grips."""
        self.measured = self.calibration.measured if self.home and not self.calibration.every_clip else None
        """Forces to compare with."""

    def add(self, run: InteractionEstimate) -> list[dict[str, Any]]:
        """Keep the next run of contact; return the force of a pull over time by column of FORCES.

        Raises:
            NoEstimate: the known force does not determine that of this pull.
        """
        self._runs.append((run.onset_frame, run.onset_time_s, PressedRun.of(run)))
        found = run.main_estimate
        if self.known is None or not isinstance(found, GripEstimate) or "relative_force" not in found.determined:
            return []
        times = run.onset_time_s + found.times
        try:
            known = predict_force(self.known.at(times), found.force, found.force_sd)
        except NoEstimate as reason:
            self._unknown_pull = str(reason)
            raise
        curve = Curve.of(run.onset_frame, times, known)
        self._pulls.append(curve)
        names = ("time_s", "force_N", "force_N_low", "force_N_high", "known_N")
        values = np.column_stack([times, curve.force, curve.low, curve.high, known.known]).tolist()
        return [{"onset_frame": run.onset_frame, **dict(zip(names, row, strict=True))} for row in values]

    def conclude(self, length: ClipLength) -> None:
        """Say all in newtons, after the last run of contact."""
        self.length = length
        pressed = [run for *_, run in self._runs if run is not None]
        try:
            self.scale = self._found(pressed, length)
        except NoEstimate as reason:
            self.reason = str(reason)
        for frame, time_s, run in self._runs:
            values = {"onset_frame": frame, "onset_time_s": time_s}
            if run is None:
                values["detail"] = "No press was estimated in this run of contact."
            elif self.scale is None:
                values["detail"] = self.reason
            elif not run.explained:
                values["detail"] = "The model does not explain the motion."
            else:
                values |= physical_values(self.scale.of(run, length), self.scale.source, length.by)
            self.rows.append(values)
        if self.measured is not None:
            self.curves = self._compared(pressed, length, self.measured)
        pulled = self._pulls or any(curve.unit == NEWTONS for curve in self.curves)
        self.reason = "" if pulled else self._unknown_pull or self.reason

    def upper_force(self, found: Estimate) -> float | None:
        """Upper end of the 90 % interval of a frame's force [N]; None where that isn't determined.

        In the clip with the known force no scale is known until the run that tells it has ended.
        """
        if self.length is None or found.covariance is None or not found.explained:
            return None
        try:
            scale = self._found([run for *_, run in self._runs if run is not None], self.length)
        except NoEstimate:
            return None
        known = np.log(np.abs(found.theta)), found.covariance, covariance(found.verdict_information), True
        physical = None if scale is None else scale.of(PressedRun(-1, math.nan, math.nan, *known), self.length)
        if physical is None or physical.log_sd is None or "force" not in physical.determined:
            return None
        return math.exp(physical.logs[2] + NINETY * physical.log_sd[2])

    def _found(self, pressed: Sequence[PressedRun], length: ClipLength) -> ForceScale | None:
        if self.home or not self.calibration.of_one_clip:
            return self.calibration.scale(pressed, length) if self.calibration.tells else None
        if not isinstance(self.carried, tuple):
            raise NoEstimate(self.carried or "No results in newtons: the clip with the known force has no results.")
        scale, here = self.carried
        return scale.elsewhere(here, length)

    def _compared(self, pressed: Sequence[PressedRun], length: ClipLength, measured: KnownForce) -> list[Curve]:
        found = []
        for run in pressed:
            times = measured.times[run.pressing(measured.times)]
            if len(times) and run.explained:
                found.append(_press_curve(run, times, self.scale, length))
        return [*found, *self._pulls]

    def compared_rows(self) -> list[dict[str, Any]]:
        """Estimated and measured forces by column of COMPARED."""
        if self.measured is None:
            return []
        span = self.calibration.fields.known_s or (math.inf, -math.inf)
        found = []
        for curve in self.curves:
            columns = curve.times, self.measured.at(curve.times), curve.force, curve.low, curve.high
            for row in np.column_stack(columns).tolist():
                values = dict(zip(("time_s", *NUMBERS), row, strict=True))
                known = span[0] <= row[0] <= span[1]
                found.append(values | {"onset_frame": curve.onset_frame, "estimated_unit": curve.unit, "known": known})
        return found

    def record(self) -> dict[str, Any]:
        """What run.json keeps: where newtons come from, and how well estimates agree with what was measured."""
        found: dict[str, Any] = {"files": [str(path.resolve()) for path in self.calibration.files]}
        if self.scale is not None and self.length is not None:
            kept = {name: getattr(self.scale, name) for name in ("variance", "homogeneous", "source", "metric")}
            found["scale"] = {"log_newtons": self.scale.log, **kept}
            found["length"] = vars(self.length).copy()
        if self.reason:
            found["reason"] = self.reason
        if self.measured is not None:
            found["comparison"] = agreement(self.compared_rows())
        return found


def carried_from(record: dict[str, Any]) -> tuple[ForceScale, ClipLength] | str:
    """Scale and length that the record of another clip holds, or why there is none."""
    kept = record.get("calibration") or {}
    if "scale" not in kept:
        return str(kept.get("reason", ""))
    scale = kept["scale"]
    carried = scale["log_newtons"], scale["variance"], scale["homogeneous"], scale["source"]
    return ForceScale(*carried, {}, metric=scale["metric"]), ClipLength(**kept["length"])


def physical_values(physical: Physical, source: str, metres: str = "") -> dict[str, Any]:
    """Numbers of a run by column of CALIBRATED; uncertainties that nobody knows are missing.

    Args:
        physical: the run.
        source: by what newtons are known.
        metres: by what metres are.
    """
    per, metric = "m" if physical.metric else "scene unit", f", metric by {metres}" if metres else ""
    units = dict(zip(PARAMETERS, (f"N/{per}", f"N·s/{per}", "N"), strict=True))
    spread = physical.log_sd
    found: dict[str, Any] = {"determined": ";".join(physical.determined)}
    for index, name in enumerate(PARAMETERS):
        value = math.exp(physical.logs[index])
        by = source + metric if "/m" in units[name] else source
        found |= {name: value, f"{name}_unit": f"{units[name]}, by {by}"}
        if spread is not None:
            log_sd = float(spread[index])
            found[f"{name}_sd"] = value * math.exp(log_sd**2 / 2) * math.sqrt(math.expm1(log_sd**2))
            found[f"{name}_low"] = value * math.exp(-NINETY * log_sd)
            found[f"{name}_high"] = value * math.exp(NINETY * log_sd)
    return found


def _press_curve(run: PressedRun, times: np.ndarray, scale: ForceScale | None, length: ClipLength) -> Curve:
    """A press's force, constant while it acts."""
    log, sd, unit = run.logs[2], math.nan, NORMALISED
    if scale is not None:
        physical = scale.of(run, length)
        log, sd, unit = physical.logs[2], math.nan if physical.log_sd is None else physical.log_sd[2], NEWTONS
    values = math.exp(log), math.exp(log - NINETY * sd), math.exp(log + NINETY * sd)
    force, low, high = (np.full(len(times), value) for value in values)
    return Curve(run.onset_frame, times, force, low, high, unit)


def agreement(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Scale, correlation and error of estimated forces against measured ones that did not tell the scale."""
    some = [row for row in rows if not row["known"] and math.isfinite(row["measured_N"])]
    found: dict[str, Any] = {"forces": len(some)}
    if len(some) < LEAST_COMPARED or len({row["estimated_unit"] for row in some}) > 1:
        return found
    measured, estimated, low, high = np.array([[row[name] for name in NUMBERS] for row in some]).T
    if estimated.any():
        found["measured_over_estimated"] = float(measured @ estimated / (estimated @ estimated))
    if np.ptp(measured) > 0 and np.ptp(estimated) > 1e-9 * np.abs(estimated).max():
        found["correlation"] = float(np.corrcoef(measured, estimated)[0, 1])
    if some[0]["estimated_unit"] == NEWTONS:
        found["rms_error_N"] = float(np.sqrt(np.square(measured - estimated).mean()))
        found["rms_measured_N"] = float(np.sqrt(np.square(measured).mean()))
        if np.isfinite(low).all():
            found["within_90_percent_intervals"] = float(((low <= measured) & (measured <= high)).mean())
    return found


def comparison_sentence(found: dict[str, Any]) -> str:
    """The same in words."""
    return ", ".join(text.format(found[name]) for name, text in TEXTS["agreement"].items() if name in found)
