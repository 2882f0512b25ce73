"""E and ν come back from a press whose truth is known, and the covariance says how well."""

import dataclasses
import functools

import numpy as np
import pytest

from benchmarks.palpation.synthetic import BODIES, observe, press
from palpate.data.source.sequence import moved
from palpate.estimators.palpation.bench import Bench, Palpation
from palpate.estimators.palpation.gauss_newton import states_of
from palpate.estimators.palpation.material_fit import NOTHING, FitSettings, fit_material
from palpate.estimators.palpation.registration import MOST_ALIGNED, thinned
from palpate.estimators.palpation.skin import Skin
from palpate.physics.fem import Material

BODY = dataclasses.replace(BODIES["slab"], size=0.08)


@functools.cache
def pressed(force: float):
    return press(BODY, force, (0.1, 0.5), 4, law="corotational")


def observed(force: float, sensor: str = "stereo", seed: int = 3, count: int = 800) -> Palpation:
    """A press by the fit's own mesh and law: what is left is the noise."""
    return observe(*pressed(force), sensor, seed, count=count)


@pytest.fixture(scope="module")
def slab() -> tuple[Skin, np.ndarray, Palpation]:
    return *BODY.skin(4, BODY.size / 20), observed(1.0)


def test_a_start_however_far_off_ends_at_the_truth_after_as_many_simulations(slab) -> None:
    skin, held, seen = slab
    one, two = (fit_material(skin, held, [seen], FitSettings(young=each, model_error=0.0)) for each in (1.0, 1e9))
    assert one.young == pytest.approx(two.young, rel=1e-6)
    assert one.poisson == pytest.approx(two.poisson, abs=1e-6)
    assert one.solves == two.solves <= 6
    assert abs(np.log(one.young / 1e4)) < 3 * one.young_sd < 0.45
    assert abs(one.poisson - 0.42) < 3 * one.poisson_sd
    assert one.noise < 0.0004


def test_the_next_simulation_begins_where_derivatives_say(slab) -> None:
    """What they are off by goes with the square of the change; from there fewer Newton steps lead to rest."""
    skin, held, seen = slab
    bench = Bench(skin, held, [seen])
    (rest,) = bench.rests(Material("corotational", 1e4, 0.4), [None])
    (state,) = states_of(bench, [rest], 1.0)
    assert bench.solves == 1
    off = []
    for change in (np.array([0.02, 0.01]), np.array([0.01, 0.005])):
        begun = state.predicted(change)
        changed = Material("corotational", 1e4 / (1 + change[0]), 0.4 + change[1])
        (there,) = bench.rests(changed, [begun])
        off.append(np.abs(begun - there.displacement).max() / np.abs(rest.displacement).max())
        (plain,) = bench.rests(changed, [rest.displacement])
        assert there.iterations < plain.iterations
        np.testing.assert_allclose(there.displacement, plain.displacement, atol=1e-9)
    assert off[0] < 2e-3
    assert off[0] / off[1] == pytest.approx(4, rel=0.2)


def test_points_whose_sensor_is_not_told_are_fitted_along_the_surface_s_normals(slab) -> None:
    """In the body's own frame, whose origin sees the surface from behind."""
    skin, held, seen = slab
    bare = dataclasses.replace(seen, points=moved(seen.points, seen.pose), pose=np.eye(4))
    bench = Bench(skin, held, [bare])
    np.testing.assert_allclose(np.linalg.norm(bench.sights[0], axis=1), 1)
    assert bench.eyes == [False]
    found = fit_material(skin, held, [bare])
    assert abs(np.log(found.young / 1e4)) < 3 * found.young_sd


def test_one_press_seen_twice_is_simulated_once(slab) -> None:
    skin, held, seen = slab
    bench = Bench(skin, held, [seen, seen])
    one, two = bench.rests(Material("linear", 1e4, 0.3), [None, None])
    assert one is two
    assert bench.solves == 1


def test_errors_of_the_model_widen_the_intervals(slab) -> None:
    skin, held, seen = slab
    sds = [fit_material(skin, held, [seen], FitSettings(model_error=error)).young_sd for error in (0.0, 0.1)]
    assert sds[1] > 1.2 * sds[0]


@pytest.mark.acceptance
def test_noise_at_sharp_edges_does_not_look_like_a_dent(slab) -> None:
    """The mean modulus of five draws of a millimetre is off by less than the spread of one; with the edges by twice."""
    skin, held, _ = slab
    found = [fit_material(skin, held, [observed(1.0, "time of flight", i, 4000)]) for i in range(5)]
    off = np.log([fit.young / 1e4 for fit in found])
    assert abs(off.mean()) < found[0].young_sd
    assert np.abs(off).max() < 3 * found[0].young_sd


def test_a_pose_is_found_by_a_part_of_the_points() -> None:
    points = np.arange(3.0 * (5 * MOST_ALIGNED + 1)).reshape(-1, 3)
    assert 0.8 * MOST_ALIGNED <= len(thinned(points)) <= MOST_ALIGNED
    np.testing.assert_array_equal(thinned(points[:7]), points[:7])


def test_a_force_out_of_the_body_is_refused(slab) -> None:
    skin, held, seen = slab
    turned = dataclasses.replace(seen, force=-seen.force)
    for number, palpations in ((1, [turned]), (2, [seen, turned])):
        with pytest.raises(ValueError, match=rf"the force of palpation {number} points out of the body; give what"):
            fit_material(skin, held, palpations)


def test_nothing_is_determined_by_a_press_that_moves_nothing(slab) -> None:
    """A fiftieth of the force moves the surface by less than the noise."""
    skin, held, _ = slab
    found = fit_material(skin, held, [observed(0.02, "time of flight")])
    assert (found.young_sd > 0.5, found.verdict) == (True, NOTHING)
