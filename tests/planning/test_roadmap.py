"""Ways through scenes whose costs are known."""

import dataclasses
import itertools

import numpy as np
import pytest

from palpate.planning.cost_table import CostTable, grid_of, mirrored
from palpate.planning.roadmap import Blocked, EdgeCosts, cheapest_chain, find_plan
from palpate.planning.scene import Placed, read_plan_scene
from tests.planning.test_scene import SHIPPED


def costs(work: float, **changed: object) -> EdgeCosts:
    """Every press does the same work in the end, growing with its length."""
    scene = dataclasses.replace(read_plan_scene(SHIPPED), **changed)
    (places, angles), shares = grid_of(scene.objects["curtain"]), np.linspace(0, 1, 41)
    lengths, works = scene.objects["curtain"].longest * shares, np.tile(work * shares, (len(places), 1))
    return EdgeCosts(scene, {"curtain": CostTable(places, angles, lengths, works, 0.0045)})


def test_without_alpha_thecheapest_chain_way_is_taken() -> None:
    found = find_plan(costs(1.0, alpha=0.0))
    assert found.places.tolist() == [[0.025, -0.04], [0.025, 0.04]]
    assert found.way == pytest.approx(80)
    assert found.cost == pytest.approx(80)


def test_dear_tissue_is_passed_in_the_gap_and_cheap_tissue_pushed_through() -> None:
    dear, cheap = find_plan(costs(0.1)), find_plan(costs(0.001))
    assert dear.deformation == 0
    crossing = np.interp(0, dear.places[:, 1], dear.places[:, 0])
    assert abs(crossing) < 0.004
    assert dear.cost < costs(0.1).plan(np.array([[0.025, -0.04], [0.025, 0.04]])).cost
    assert cheap.deformation == pytest.approx(1.0)
    assert len(cheap.places) == 2


def test_a_blocked_goal_is_said() -> None:
    with pytest.raises(Blocked, match=r"the goal .* is blocked"):
        find_plan(costs(1.0, goal=np.array([0.03, 0.0])))
    walls = [Placed((0.0, 0.02), (0.12, 0.002))]
    with pytest.raises(Blocked, match="can't be reached"):
        find_plan(costs(1.0, obstacles=walls))


def test_ways_that_touch_nothing_are_compared_by_their_length() -> None:
    """α = 1: every free way costs 0. Old: one of 204 mm. Around both corners of the gap it is at least 92 mm."""
    found = find_plan(costs(0.1, alpha=1.0))
    assert found.cost == found.deformation == 0
    corner = np.array([0.008, 0.0025]) - 0.005 / np.sqrt(2)  # the tip's centre cuts no more of it than this
    shortest = 2 * 1000 * np.linalg.norm([0.025 - corner[0], 0.04 - corner[1]])
    assert shortest < found.way < 100
    assert find_plan(costs(0.1, alpha=0.999999)).way == pytest.approx(found.way)


def test_equally_deep_presses_are_compared_by_their_length_too() -> None:
    """With the gap closed every way presses once and costs the same, so that at α = 1 the straight one is left."""
    closed = [Placed((0.0, 0.0), (0.016, 0.005))]
    found = find_plan(costs(0.1, alpha=1.0, obstacles=closed))
    assert found.deformation == pytest.approx(100)
    assert found.way == pytest.approx(80)


@pytest.mark.parametrize("free", [0.0, 0.5])
def test_the_search_finds_what_trying_all_finds(free: float) -> None:
    """Prices compared as pairs; `free` is the share of lines that cost nothing, where the way decides."""
    chance = np.random.default_rng(0)
    for _ in range(20):
        places = chance.uniform(size=(7, 2))
        apart = np.linalg.norm(places[:, None] - places, axis=2)
        share = 0.0 if free else 1.0  # of the way in the cost, 1 - α
        work = np.triu(chance.uniform(0, 2, apart.shape) * (chance.uniform(size=apart.shape) >= free), 1)
        price = share * apart + (work + work.T) * apart
        pairs = [[(price[i, j].item(), apart[i, j].item()) for j in range(7)] for i in range(7)]
        one, two = np.triu_indices(7, 1)
        chain = cheapest_chain(7, one, two, price[one, two], apart[one, two])
        ways = [(0, *middle, 1) for n in range(6) for middle in itertools.permutations(range(2, 7), n)]
        best = min(np.sum([pairs[a][b] for a, b in itertools.pairwise(way)], axis=0).tolist() for way in ways)
        assert chain is not None
        found = np.sum([pairs[a][b] for a, b in itertools.pairwise(chain)], axis=0)
        np.testing.assert_allclose(found, best, rtol=1e-12)


def test_presses_from_behind_are_those_of_the_mirror_image() -> None:
    places, angles = mirrored(np.array([[0.1, 0.2], [0.1, -0.2]]), np.array([0.3, 0.3]))
    assert places.tolist() == [[0.1, -0.2], [0.1, -0.2]]
    assert angles.tolist() == [-0.3, 0.3]
