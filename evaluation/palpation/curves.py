"""What measured forces tell, judged on what was kept back from the fits.

Judges every CSV file under --data whose columns it knows, whatever its name: probes of a region (probe, contact_x …,
depth_mm, fn_N) and indentations that are held (t_s, force_N, displacement_mm). Writes table.csv (file, measure, value);
what the measures mean is in docs/reports/palpation.md.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palpate.common.files import all_below
from palpate.estimators.estimate import NINETY
from palpate.estimators.palpation import Hold, Probe, fit_region, fit_relaxation, read_hold, read_probes
from palpate.estimators.palpation.curves import HOLD, LEAST, PROBES, kind_of
from palpate.estimators.palpation.region import LEAST_PROBES
from palpate.estimators.palpation.stiffening import fit_stiffening, told
from palpate.evaluation.harness import Measurements, Row

FOLDS = 5
"""Parts of a region, each of which is left out once."""


@dataclass(frozen=True)
class Curves(Measurements):
    """Tables of forces in a folder and below, by their paths there."""

    data: Path
    """folder of the data"""

    def __post_init__(self) -> None:
        """Raise a ValueError where there is nothing to judge."""
        if not self.wanted:
            kinds = "; or ".join(map(", ".join, JUDGES))
            raise ValueError(
                f"{self.data} holds no CSV file with the columns of any of: {kinds}; give --data that does."
            )

    @functools.cached_property
    def wanted(self) -> Mapping[str, Callable[[], Row]]:
        """Tables of known columns."""
        below = all_below(self.data) if self.data.is_dir() else []
        found = [(path, JUDGES.get(kind_of(path) or ())) for path in below if path.suffix.lower() == ".csv"]
        return {path.relative_to(self.data).as_posix(): functools.partial(work, path) for path, work in found if work}

    def record(self) -> Mapping[str, Any]:
        """When every file was changed last."""
        return {f"file {name}": (self.data / name).lstat().st_mtime_ns for name in self.wanted}


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
    return found | larger_halves([(probe.depth, probe.force) for probe in probes])


def larger_halves(curves: Sequence[tuple[np.ndarray, np.ndarray]]) -> Row:
    """Measures of forces over the larger half of curves' depths, which rise, foretold from the smaller."""
    parts = []
    for depth, force in curves:
        half = depth <= (depth[0] + depth[-1]) / 2
        if half.sum() >= LEAST:
            middle, low, high = fit_stiffening(depth[half], force[half]).force(depth[~half])
            inside = (low <= force[~half]) & (force[~half] <= high)
            parts.append((inside, told(middle, low, high), np.abs(middle / force[~half] - 1) <= 0.25))
    held, known, near = np.concatenate(parts, axis=1) if parts else np.zeros((3, 0), bool)
    shares = {"coverage of 90 % intervals": held, "determined": known}
    shares |= {"coverage where determined": held[known], "within 25 % where determined": near[known]}
    return {f"larger half, {name}": float(share.mean()) for name, share in shares.items() if len(share)}


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
    way = (np.cumsum(hold.held) <= 1) & (np.diff(np.maximum.accumulate(hold.depth), prepend=-np.inf) > 0)
    found |= larger_halves([(hold.depth[way], hold.force[way])])
    return found | {"force that remains in the end / at once": fit_relaxation(hold).relaxed_share}


JUDGES: dict[tuple[str, ...], Callable[[Path], Row]] = {PROBES: judge_probing, HOLD: judge_relaxation}
"""By the columns of a table."""
