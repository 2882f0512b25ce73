"""Force at probes that were left out, from the others of their region."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palpate.estimators.palpation import Probe, fit_region
from palpate.estimators.palpation.region import LEAST_PROBES

FOLDS = 5


def judge_probing(probes: Sequence[Probe]) -> dict[str, object]:
    """Measures of a region: errors of left-out probes over those of the region's mean stiffness, and coverage.

    Probes are left out a fifth at a time: drawn at random, and as strips across the region's longest side, where
    most of the left-out ones have no neighbour.

    Raises:
        ValueError: too few probes.
    """
    places = np.array([probe.place for probe in probes])
    along = np.linalg.svd(places - places.mean(axis=0), full_matrices=False)[2][0]
    strips = np.argsort(np.argsort(places @ along)) * FOLDS // len(probes)
    drawn = np.random.default_rng(0).permutation(len(probes)) % FOLDS
    if len(probes) < FOLDS / (FOLDS - 1) * LEAST_PROBES:
        raise ValueError(f"{len(probes)} probes are too few to leave some out; give {2 * LEAST_PROBES}.")
    found: dict[str, object] = {"probes": len(probes)}
    for name, folds in (("random fifths", drawn), ("strips", strips)):
        found |= {f"{measure}, {name}": value for measure, value in _left_out(probes, folds).items()}
    return found


def _left_out(probes: Sequence[Probe], folds: np.ndarray) -> dict[str, float]:
    errors, plain, inside, forces = [], [], [], []
    for fold in range(FOLDS):
        region = fit_region([probe for probe, of in zip(probes, folds, strict=True) if of != fold])
        for probe in (probe for probe, of in zip(probes, folds, strict=True) if of == fold):
            force, half = region.predict(probe.place, probe.depth)
            errors.append(force - probe.force)
            plain.append(region.stiffness * probe.depth - probe.force)
            inside.append(np.abs(errors[-1]) <= half)
            forces.append(probe.force)

    def size(parts: list[np.ndarray]) -> float:
        return float(np.sqrt(np.mean(np.square(np.concatenate(parts)))))

    return {
        "force error, rms (N)": size(errors),
        "that over the mean stiffness's": size(errors) / size(plain),
        "mean absolute error over the mean stiffness's": float(
            np.abs(np.concatenate(errors)).mean() / np.abs(np.concatenate(plain)).mean()
        ),
        "coverage of 90 % intervals": float(np.concatenate(inside).mean()),
    }
