"""Newtons of one clip: calibrated.csv, a row a run of contact, and the forces of pulls over time."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from palpate.estimators.calibration_file import Calibration
from palpate.estimators.estimate import NoEstimate, PressResult
from palpate.estimators.force_scale import ClipLength, ForceScale, Physical, PressedRun
from palpate.estimators.known_force import predict_force
from palpate.estimators.records import InteractionEstimate, Onset
from palpate.estimators.result import ENDS, Quantity, Table, column
from palpate.physics.identifiability import NINETY, covariance
from palpate.physics.mechanics import PARAMETERS

NEWTONS, UNIT = "N", "unit, and what it was calibrated by"


@dataclass(frozen=True)
class Newtons:
    """Columns of a contact in newtons."""

    stiffness: Quantity | None = column("k_s in stiffness_unit", None)
    stiffness_unit: str = column(UNIT, "")
    damping: Quantity | None = column("k_d in damping_unit", None)
    damping_unit: str = column(UNIT, "")
    force: Quantity | None = column("|F| in force_unit", None)
    force_unit: str = column(UNIT, "")
    determined: str = column("parameters that are determined, joined by ;", "")
    detail: str = column("reason why there are no numbers", "")


CALIBRATED = Table((Onset, Newtons))
"""calibrated.csv."""


@dataclass
class ClipCalibration:
    """Newtons of a clip, gathered run by run.

    Args:
        calibration: what is known of this clip.
    """

    calibration: Calibration
    scale: ForceScale | None = None
    """Force scale of this clip, once it has been concluded."""
    length: ClipLength | None = None
    """Length of a scene unit, once it is known, or set before where newtons are told on the way."""
    rows: list[dict[str, Any]] = field(default_factory=list)
    """Rows of calibrated.csv, likewise."""
    reason: str = ""
    """Reason why there is no scale."""

    def __post_init__(self) -> None:
        self._runs: list[tuple[int, float, PressedRun | None]] = []
        self._pulled = False
        self._unknown_pull = ""

    def add(self, run: InteractionEstimate) -> np.ndarray | None:
        """Keep the next run of contact; return the force of a pull and the ends of its 90 % interval, shape [3, K] [N].

        Raises:
            NoEstimate: the known force does not determine that of this pull.
        """
        self._runs.append((run.onset_frame, run.onset_time_s, PressedRun.of(run)))
        found, measured = run.grip, self.calibration.measured
        if measured is None or found is None or run.main_estimate is not found:
            return None
        try:
            force, sd = predict_force(measured.at(run.onset_time_s + found.times), found.force, found.force_sd)
        except NoEstimate as reason:
            self._unknown_pull = str(reason)
            raise
        self._pulled = True
        return force + np.outer([*ENDS.values()], NINETY * sd)

    def conclude(self, length: ClipLength) -> None:
        """Convert all into newtons, after the last run of contact."""
        self.length = length
        pressed = [run for *_, run in self._runs if run is not None]
        try:
            self.scale = self.calibration.scale(pressed, length)
        except NoEstimate as reason:
            self.reason = str(reason)
        for frame, time_s, run in self._runs:
            values: dict[str, Any] = {"onset_frame": frame, "onset_time_s": time_s}
            if run is None:
                values["detail"] = "No press was estimated in this run of contact."
            elif self.scale is None:
                values["detail"] = self.reason
            elif not run.explained:
                values["detail"] = "The model does not explain the motion."
            else:
                values |= physical_values(self.scale.of(run, length), self.scale.source, length.by)
            self.rows.append(values)
        self.reason = "" if self._pulled else self._unknown_pull or self.reason

    def known_force(self, found: PressResult) -> Quantity | None:
        """Return the magnitude of a frame's force [N]; None where that isn't determined.

        No scale is known before the run of contact with the known force has ended.
        """
        if self.length is None or found.covariance is None or not found.explained:
            return None
        try:
            scale = self.calibration.scale([run for *_, run in self._runs if run is not None], self.length)
        except NoEstimate:
            return None
        known = np.log(np.abs(found.theta)), found.covariance, covariance(found.verdict_information), True
        physical = scale.of(PressedRun(-1, math.nan, math.nan, *known), self.length)
        if physical.log_sd is None or "force" not in physical.determined:
            return None
        return Quantity(math.exp(physical.logs[2]), physical.log_sd[2])

    def record(self) -> dict[str, Any]:
        """Return the entry of run.json on the source of newtons."""
        found: dict[str, Any] = {"files": [str(path.resolve()) for path in self.calibration.files]}
        if self.scale is not None:
            kept = {name: getattr(self.scale, name) for name in ("variance", "homogeneous", "source")}
            found["scale"] = {"log_newtons": self.scale.log, **kept}
        if self.reason:
            found["reason"] = self.reason
        return found


def physical_values(physical: Physical, source: str, metres: str = "") -> dict[str, Any]:
    """Return numbers of a run by column of CALIBRATED; unknown uncertainties are missing.

    Args:
        physical: the run.
        source: by what newtons are known.
        metres: by what metres are.
    """
    per, metric = "m" if physical.metric else "scene unit", f", metric by {metres}" if metres else ""
    units = f"N/{per}, by {source}{metric}", f"N·s/{per}, by {source}{metric}", f"N, by {source}"
    spread = (None,) * len(units) if physical.log_sd is None else physical.log_sd.tolist()
    found: dict[str, Any] = {"determined": ";".join(physical.determined)}
    for name, unit, log, log_sd in zip(PARAMETERS, units, physical.logs, spread, strict=True):
        parts = Quantity(math.exp(log), log_sd).parts | {"_unit": unit}
        found |= {f"{name}{end}": part for end, part in parts.items()}
    return found
