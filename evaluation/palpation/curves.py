"""What measured forces tell, judged on what was kept back from the fits.

Judges every CSV file under --data whose columns it knows, whatever its name: probes of a region (probe, contact_x …,
depth_mm, fn_N), indentations that are held (t_s, force_N, displacement_mm), grasps (force_N, gripper_width_m; the name
gives day and object). Writes table.csv (file, measure, value); what the measures mean is in docs/reports/palpation.md.
"""

from __future__ import annotations

import functools
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.common.files import all_below
from palpate.estimators.estimate import NINETY
from palpate.estimators.palpation import (
    Hold,
    Probe,
    fit_grasp,
    fit_region,
    fit_relaxation,
    read_grasp,
    read_hold,
    read_probes,
)
from palpate.estimators.palpation.curves import HOLD, KINDS, PROBES, kind_of
from palpate.estimators.palpation.region import LEAST_PROBES
from palpate.evaluation.harness import FileMeasurements, Row

FOLDS = 5
"""Parts of a region, each of which is left out once."""
ORDER = ("softest", "softer", "soft", "medium", "hard", "harder", "hardest")
"""Words of a name that rank it, softest first."""
COMPLIANCE = "compliance (mm/N)"
SUMMARISED = {
    "probing": (
        "that over the mean stiffness's, random fifths",
        "that over the mean stiffness's, strips",
        "coverage of 90 % intervals, random fifths",
    ),
    "relaxation": ("second half off, rms / peak", "one standard linear solid: second half off, rms / peak"),
}
"""Measures whose median over the files is in the table as well."""


@dataclass(frozen=True)
class Curves(FileMeasurements):
    """Tables of forces."""

    def __post_init__(self) -> None:
        """Raise a ValueError where there is nothing to judge."""
        if not self.wanted:
            known = "; ".join(", ".join(columns) for columns in KINDS)
            raise ValueError(
                f"{self.data} holds no CSV file with the columns of any of: {known}. Give --data that does."
            )

    @functools.cached_property
    def wanted(self) -> Mapping[str, Callable[[], Row]]:
        """What each file shows whose columns are known."""
        below = all_below(self.data) if self.data.is_dir() else []
        kinds = {path: kind_of(path) for path in below if path.suffix.lower() == ".csv"}
        judges = {PROBES: judge_probing, HOLD: judge_relaxation}
        return {
            path.relative_to(self.data).as_posix(): functools.partial(judges.get(kind, judge_grasp), path)
            for path, kind in kinds.items()
            if kind is not None
        }

    def tabled(self, rows: Sequence[Row]) -> list[Row]:
        """Also the grasps of every object and day, and medians over the files of a kind."""
        compliances: dict[GraspName, list[float]] = defaultdict(list)
        for row in rows:
            if COMPLIANCE in row:
                compliances[GraspName.of(Path(row["file"]).stem)].append(row[COMPLIANCE])
        grasps = [{"file": name, **measures} for name, measures in judge_grasps(compliances).items()]
        return [*rows, *grasps, *medians(rows)]


def medians(rows: Sequence[Row]) -> list[Row]:
    """Medians of the SUMMARISED measures, a row for every kind of file."""
    found = []
    for kind, measures in SUMMARISED.items():
        values = {measure: [row[measure] for row in rows if measure in row] for measure in measures}
        named = {
            f"{measure}, median of {len(each)} files": float(np.median(each))
            for measure, each in values.items()
            if each
        }
        if named:
            found.append({"file": f"all {kind}", **named})
    return found


def judge_probing(path: Path) -> Row:
    """Measures of a region: errors of left-out probes over those of the region's mean stiffness, and coverage.

    Probes are left out a fifth at a time: drawn at random, and as strips across the region's longest side, where
    most of the left-out ones have no neighbour.

    Raises:
        ValueError: the file can't be read, or holds too few probes.
    """
    probes = read_probes(path)
    places = np.array([probe.place for probe in probes])
    along = np.linalg.svd(places - places.mean(axis=0), full_matrices=False)[2][0]
    strips = np.argsort(np.argsort(places @ along)) * FOLDS // len(probes)
    drawn = np.random.default_rng(0).permutation(len(probes)) % FOLDS
    if len(probes) < FOLDS / (FOLDS - 1) * LEAST_PROBES:
        raise ValueError(f"{len(probes)} probes are too few to leave some out; give {2 * LEAST_PROBES}.")
    found: Row = {"probes": len(probes)}
    for name, folds in (("random fifths", drawn), ("strips", strips)):
        found |= {f"{measure}, {name}": value for measure, value in _left_out(probes, folds).items()}
    return found


def _left_out(probes: Sequence[Probe], folds: np.ndarray) -> dict[str, float]:
    """Errors of the probes of every fold, predicted from those of the others."""
    errors, of_mean, inside = [], [], []
    for fold in range(FOLDS):
        region = fit_region([probe for probe, of in zip(probes, folds, strict=True) if of != fold])
        for probe in (probe for probe, of in zip(probes, folds, strict=True) if of == fold):
            force, half = region.predict(probe.place, probe.depth)
            errors.append(force - probe.force)
            of_mean.append(region.stiffness * probe.depth - probe.force)
            inside.append(np.abs(errors[-1]) <= half)
    off, rival = np.concatenate(errors), np.concatenate(of_mean)
    size = float(np.sqrt(np.mean(np.square(off))))
    return {
        "force error, rms (N)": size,
        "that over the mean stiffness's": size / float(np.sqrt(np.mean(np.square(rival)))),
        "mean absolute error over the mean stiffness's": float(np.abs(off).mean() / np.abs(rival).mean()),
        "coverage of 90 % intervals": float(np.concatenate(inside).mean()),
    }


def judge_relaxation(path: Path) -> Row:
    """Measures of an indentation: how far off the forecast of the hold's second half is, over the largest force.

    Raises:
        ValueError: the file can't be read, or the first half of the hold has too few samples.
    """
    hold: Hold = read_hold(path)
    times = hold.times[hold.held]
    middle = (times[0] + times[-1]) / 2
    after = hold.held & (hold.times > middle)
    peak = float(hold.force.max())
    found: Row = {"peak force (N)": peak, "hold (s)": float(times[-1] - times[0])}
    for name, branches in (("", None), ("one standard linear solid: ", 1)):
        fit = fit_relaxation(hold, float(middle), branches=branches)
        missed = fit.force(hold.times, hold.depth)[after] - hold.force[after]
        found |= {
            f"{name}second half off, rms / peak": float(np.sqrt(np.mean(np.square(missed)))) / peak,
            f"{name}second half off, largest / peak": float(np.abs(missed).max()) / peak,
            f"{name}coverage of 90 % intervals": float(np.mean(np.abs(missed) <= NINETY * fit.forecast_sd)),
        }
    return found | {"force that remains in the end / at once": fit_relaxation(hold).relaxed_share}


def judge_grasp(path: Path) -> Row:
    """Slope of one grasp.

    Raises:
        ValueError: the file can't be read, or tells no slope.
    """
    slope = fit_grasp(read_grasp(path))
    return {"slope 2 to 8 N (N/mm)": slope.stiffness, COMPLIANCE: slope.compliance, "its sd": slope.sd}


@dataclass(frozen=True)
class GraspName:
    """What a file's name says, such as 2023-12-06__green_ball_softer_1.csv."""

    day: str
    """Before the double underscore; empty where there is none."""
    thing: str
    """The object, without the number of the grasp."""

    @classmethod
    def of(cls, stem: str) -> GraspName:
        """Of a file name without its ending."""
        day, split, thing = stem.rpartition("__")
        return cls(day if split else "", re.sub(r"[_-]?\d+$", "", thing))

    @property
    def rank(self) -> int | None:
        """Place in ORDER; None where no word says it."""
        words = [word for word in re.split(r"[_\W]+", self.thing.lower()) if word in ORDER]
        return ORDER.index(words[0]) if words else None

    @property
    def family(self) -> str:
        """The kind of thing: only balls are softer than balls. The last word that is none of ORDER."""
        words = [word for word in re.split(r"[_\W]+", self.thing.lower()) if word and word not in ORDER]
        return words[-1] if words else self.thing


def judge_grasps(compliances: Mapping[GraspName, list[float]]) -> dict[str, Row]:
    """Measures by object and day, and by kind and day whether its objects rank as named.

    Args:
        compliances: of all grasps of an object on a day [mm/N].
    """
    found: dict[str, Row] = {}
    medians = {name: float(np.median(grasps)) for name, grasps in compliances.items()}
    for name, grasps in compliances.items():
        found[f"{name.day} {name.thing}".strip()] = {
            "grasps": len(grasps),
            "slope 2 to 8 N, median (N/mm)": 1 / medians[name] if medians[name] > 0 else float("inf"),
            "compliance, median (mm/N)": medians[name],
        }
    ranked = [name for name in medians if name.rank is not None]
    for day, family in sorted({(name.day, name.family) for name in ranked}):
        group = [name for name in ranked if (name.day, name.family) == (day, family)]
        named = sorted(group, key=lambda name: (name.rank, name.thing))
        pairs = [(one, two) for i, one in enumerate(named) for two in named[i + 1 :] if one.rank != two.rank]
        if not pairs:
            continue
        right = sum(medians[one] > medians[two] for one, two in pairs)
        found[f"{day} {family}: order".strip()] = {
            "objects, softest first as found": " < ".join(
                name.thing for name in sorted(group, key=lambda name: -medians[name])
            ),
            "pairs that rank as named": right,
            "pairs": len(pairs),
            "all rank as named": "yes" if right == len(pairs) else "no",
        }
    return found
