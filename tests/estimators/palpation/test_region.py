"""A region whose stiffness varies smoothly is predicted where it was not probed."""

import numpy as np
import pytest

from palpate.estimators.palpation import Probe, fit_region

DEPTH = np.linspace(0, 3, 8)


def probes(count: int, noise: float, seed: int) -> list[Probe]:
    chance = np.random.default_rng(seed)
    found = []
    for number in range(count):
        place = np.append(chance.uniform(0, 50, 2), 0.0)
        stiff = 0.3 + 0.15 * np.sin(place[0] / 10) + 0.1 * np.cos(place[1] / 12)
        force = stiff * (DEPTH + 0.3 * DEPTH**2) + chance.normal(0, noise, len(DEPTH))
        found.append(Probe(str(number), place, DEPTH, force))
    return found


def test_left_out_probes_are_predicted_and_intervals_hold() -> None:
    some, others = probes(80, 0.02, 0), probes(100, 0.02, 1)
    region = fit_region(some)
    pairs = [region.predict(probe.place, probe.depth) for probe in others]
    errors = np.array([force - probe.force for (force, _), probe in zip(pairs, others, strict=True)])
    plain = np.array([region.stiffness * probe.depth - probe.force for probe in others])
    inside = np.abs(errors) <= np.array([half for _, half in pairs])
    assert np.sqrt(np.mean(errors**2)) < 0.15 * np.sqrt(np.mean(plain**2))
    assert 0.8 < inside.mean() < 0.97


def test_the_mean_stiffness_is_that_of_lines_through_nothing() -> None:
    region = fit_region([Probe(str(i), np.array([i, i % 3, 0.0]), DEPTH, (1 + i % 2) * DEPTH) for i in range(8)])
    assert region.stiffness == pytest.approx(1.5)


def test_a_curve_goes_on_straight_below_what_was_probed() -> None:
    region = fit_region([Probe(str(i), np.array([i, 0.0, 0.0]), DEPTH, 0.2 * DEPTH) for i in range(8)])
    force, half = region.predict(np.array([3.5, 0, 0]), np.array([3.0, 5.0]))
    np.testing.assert_allclose(force, [0.6, 1.0], atol=1e-6)
    assert (half < 1e-3).all()


def test_too_few_probes_are_said() -> None:
    with pytest.raises(ValueError, match="region of 4 probes"):
        fit_region(probes(4, 0.0, 0))
