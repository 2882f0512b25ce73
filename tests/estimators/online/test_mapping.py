"""Residual mapping: it finds a known deformation, and its adjoint equals finite differences."""

from itertools import product

import numpy as np
import pytest
from scipy.sparse import csr_array, eye_array

from palpate.estimators.online.objective import Chamfer, Mapping, Tracks, map_residual
from palpate.physics.pbd.potential import Potential
from tests.physics.pbd.particles import block, sheet


def energy_of(body, stiffness=0.3) -> Potential:
    weights = np.full(len(body.layout.rest), stiffness)
    weights[body.kinds[1]] = 0.0
    return Potential(body, weights)


def slope_at(place: tuple[int, int], weights: np.ndarray, state: np.ndarray, *told) -> float:
    """Derivative of the deformation's weighted sum by one coordinate of one particle, by differences."""
    step = np.zeros_like(state)
    step[place] = 1e-8
    up, down = ((weights * map_residual(state + each, *told).deformation).sum() for each in (step, -step))
    return (up - down) / 2e-8


def sunk(points: np.ndarray) -> np.ndarray:
    """A smooth dent of 1.5 mm."""
    apart = points[:, :2] - points[:, :2].mean(axis=0)
    return points + 1.5e-3 * np.exp(-((apart / 0.012) ** 2).sum(axis=1))[:, None] * [0, 0, 1]


@pytest.mark.parametrize("match", ["chamfer", "tracks", "both"])
def test_a_known_deformation_is_found(match):
    body = sheet(12, 12)
    truth = sunk(body.rest)
    chamfer, tracks = Chamfer(truth, np.unique(body.faces)), Tracks(eye_array(body.count).tocsr(), truth)
    matches, off = {"chamfer": ([chamfer], 0.1), "tracks": ([tracks], 0.1), "both": ([chamfer, tracks], 0.05)}[match]
    found = map_residual(body.rest, matches, energy_of(body, 0.01), body.pinned, Mapping())
    assert (np.diff(found.values) <= 1e-15).all()
    error = np.linalg.norm(found.deformation - (truth - body.rest), axis=1).max()
    assert error < off * 1.5e-3


def test_particles_below_the_surface_follow_by_the_energy():
    body = block((4, 4, 2))
    top = np.flatnonzero(np.isclose(body.rest[:, 2], body.rest[:, 2].max()))
    truth = body.rest[top] + [0, 0, 1e-3]
    found = map_residual(body.rest, [Chamfer(truth, top)], energy_of(body, 0.3), body.pinned, Mapping(200))
    moved = found.deformation[:, 2]
    assert moved[top] == pytest.approx(1e-3, abs=2e-4)
    middle = np.isclose(body.rest[:, 2], 0.005)
    assert moved[middle].mean() > 0.4e-3
    without = map_residual(body.rest, [Chamfer(truth, top)], energy_of(body, 0.0), body.pinned, Mapping(200))
    assert np.abs(without.deformation[middle]).max() == 0


@pytest.mark.parametrize("pinned_rows", [0, 1])
def test_the_adjoint_equals_finite_differences(pinned_rows):
    """Free particles; the cloud is dense, so that a step of the difference changes no pair."""
    body, random = sheet(6, 6, pinned_rows=pinned_rows), np.random.default_rng(0)
    state = body.rest + 3e-4 * random.normal(size=body.rest.shape)
    cloud = sunk(body.rest)
    places = csr_array((np.ones(5), (np.arange(5), [7, 14, 15, 22, 30])), shape=(5, body.count))
    observed = cloud[[7, 14, 15, 22, 30]] + 2e-4
    observed[2] = np.nan
    matches = [Chamfer(cloud, np.unique(body.faces)), Tracks(places, observed)]
    how, weights = Mapping(), random.normal(size=state.shape)
    energy = energy_of(body)
    mapped = map_residual(state, matches, energy, body.pinned, how)
    assert not mapped.deformation[body.pinned].any()  # what is held stays
    assert np.abs(mapped.deformation).max() > 1e-4
    found = mapped.pulled_back(weights)
    for place in product(np.flatnonzero(~body.pinned), (0, 2)):
        expected = slope_at(place, weights, state, matches, energy, body.pinned, how)
        assert found[place] == pytest.approx(expected, rel=1e-4, abs=1e-5)


def test_points_crowded_on_few_particles_of_a_large_sheet_do_not_diverge():
    """At the paper's rate each of these four particles overshoots 50-fold in every step."""
    body, random = sheet(20, 20), np.random.default_rng(0)
    crowded = np.array([188, 189, 208, 209])
    shares = random.dirichlet(np.ones(4), size=200)
    places = csr_array((shares.ravel(), np.tile(crowded, 200), 4 * np.arange(201)), shape=(200, body.count))
    truth = body.rest + np.array([0, 0, 1e-3])
    matches, energy = [Tracks(places, places @ truth)], energy_of(body, 0.05)
    found = map_residual(body.rest, matches, energy, body.pinned, Mapping())
    assert (np.diff(found.values) <= 1e-15).all()
    assert found.deformation[crowded, 2] == pytest.approx(1e-3, rel=0.1)
    weights = random.normal(size=truth.shape)
    adjoint = found.pulled_back(weights)
    for place in ((188, 2), (190, 2), (230, 2)):
        expected = slope_at(place, weights, body.rest, matches, energy, body.pinned, Mapping())
        assert adjoint[place] == pytest.approx(expected, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize(("name", "value"), [("steps", 0), ("rate", 0.0), ("rate", np.inf)])
def test_a_mapping_out_of_range_is_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} is"):
        Mapping(**{name: value})


RANDOM = np.random.default_rng(0)
POINTS, CLOUD = RANDOM.normal(size=(20, 3)), RANDOM.normal(size=(90, 3))
SEEN = np.array([0, 3, 4, 7, 11, 19])
SHARES = RANDOM.dirichlet(np.ones(20), size=8)


def terms():
    observed = RANDOM.normal(size=(8, 3))
    observed[2] = np.nan
    return {"chamfer": Chamfer(CLOUD, SEEN), "tracks": Tracks(csr_array(SHARES), observed)}


@pytest.mark.parametrize("seen", [SEEN, np.array([2])])
def test_chamfer_is_that_of_brute_force(seen):
    """Wherever particles go from one call to the next: which of them is nearest is remembered."""
    term, points, random = Chamfer(CLOUD, seen), POINTS, np.random.default_rng(1)
    for way in (0.0, 1e-3, 0.05, 0.05, 1.0, 1e-3):
        points = points + way * random.normal(size=points.shape)
        apart = np.square(points[seen][:, None] - CLOUD).sum(axis=2)
        expected = apart.min(axis=1).mean() + apart.min(axis=0).mean()
        value, slope, _ = term.slope(points)
        assert value == pytest.approx(expected, rel=1e-12)
        np.testing.assert_allclose(slope, Chamfer(CLOUD, seen).slope(points)[1], atol=1e-12)


def test_followed_points_count_where_they_are_seen():
    observed = SHARES @ POINTS + 0.1
    observed[[1, 5]] = np.nan
    assert Tracks(csr_array(SHARES), observed).slope(POINTS)[0] == pytest.approx(0.03, rel=1e-12)


@pytest.mark.parametrize("name", ["chamfer", "tracks"])
def test_derivatives_equal_finite_differences(name):
    term, direction = terms()[name], RANDOM.normal(size=POINTS.shape)
    (up, above, _), (down, below, _) = (term.slope(POINTS + sign * 1e-6 * direction) for sign in (1, -1))
    _, gradient, curved = term.slope(POINTS)
    assert (gradient * direction).sum() == pytest.approx((up - down) / 2e-6, rel=1e-7)
    curved = np.diag(curved) if curved.ndim == 1 else curved
    np.testing.assert_allclose(curved @ direction, (above - below) / 2e-6, atol=1e-8)


def test_a_simulation_that_has_diverged_is_said():
    for value in (np.nan, np.inf, -np.inf):
        with pytest.raises(ValueError, match="not finite"):
            Chamfer(CLOUD, SEEN).slope(np.where(np.arange(20)[:, None] == 7, value, POINTS))
