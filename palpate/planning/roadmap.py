"""A probabilistic road map over places of the tip, and the cheapest way through it.

It is Kavraki 1996 and Dijkstra 1959, with the cost of Frank 2010's equation 5, α·deformation + (1 - α)·way. At α = 1
all ways that touch nothing cost 0, so ties are broken by length. The search adds a minute part of the way to the cost,
and whole ways are compared by the pair of cost and way. Afterwards places are left out as long as that lowers this
price.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from palpate.planning.cost_table import CostTable
from palpate.planning.scene import PlanScene

MILLI = 1000.0
DIGITS = 9
"""Decimals to which the deformation by a line [mJ] is rounded, so that rounding errors in the table decide no tie."""

TIE = 1e-12
"""Part of the way [mm] that counts as cost in the search: less than DIGITS tell apart over half a metre."""


class Blocked(ValueError):
    """Error where there is no way; the message says why."""


@dataclass(frozen=True, eq=False)
class Plan:
    """A way; P places."""

    places: np.ndarray
    """Places from start to goal, shape [P, 2], in space [P, 3] [m]."""
    deformation: float
    """[mJ]."""
    way: float
    """[mm]."""
    cost: float
    """α·deformation + (1 - α)·way."""

    @classmethod
    def of(cls, places: np.ndarray, deformation: float, alpha: float) -> "Plan":
        """Return the plan of a way, by its places [P, 2] or [P, 3] [m] and its deformation [mJ]."""
        way = float(MILLI * np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
        return cls(places, deformation, way, float(weighed(alpha, np.array(deformation), np.array(way))))

    @property
    def price(self) -> tuple[float, float]:
        """Key by which ways are compared, as tuples are: cost, then way."""
        return self.cost, self.way


class EdgeCosts:
    """Costs of straight lines in a scene."""

    def __init__(self, scene: PlanScene, tables: Mapping[str, CostTable]) -> None:
        self.scene, self.tables = scene, tables

    def deformation(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return the work on tissue along lines [K, 2] → [K, 2], infinite through obstacles, shape [K] [mJ].

        A line that leaves the tissue behind it has pushed it as far as it goes.
        """
        total, radius = np.zeros(len(starts)), self.scene.tip_radius
        for obstacle in self.scene.obstacles:
            total[np.isfinite(obstacle.met(starts, ends, radius))] = np.inf
        lengths = np.linalg.norm(ends - starts, axis=1)
        for kind, piece in self.scene.pieces:
            met = piece.met(starts, ends, radius)
            which = np.flatnonzero(np.isfinite(met))
            if not len(which):
                continue
            way = (ends[which] - starts[which]) / lengths[which, None]
            tip = piece.inside_frame(starts[which] + met[which, None] * way)
            turn = np.arctan2(way[:, 1], way[:, 0]) - np.radians(piece.degrees)
            table, through = self.tables[kind], piece.clearance(ends[which]) >= radius
            pressed = np.where(through, table.lengths[-1], lengths[which] - met[which])
            work = MILLI * table.cost(np.clip(tip, -piece.half, piece.half), turn, pressed)
            total[which] += np.round(work, DIGITS)
        return total

    def plan(self, places: np.ndarray) -> Plan:
        """Return the cost of a way, its places [P, 2] given."""
        return Plan.of(places, float(self.deformation(places[:-1], places[1:]).sum()), self.scene.alpha)


def weighed(alpha: float, deformation: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Return the cost of equation 5, infinite through obstacles also where α is 0."""
    open_ways = np.isfinite(deformation)
    return np.where(open_ways, alpha * np.where(open_ways, deformation, 0) + (1 - alpha) * way, np.inf)


def find_plan(costs: EdgeCosts) -> Plan:
    """Find the cheapest way, of equally cheap ones the shortest.

    Args:
        costs: of the scene's lines.

    Raises:
        Blocked: start or goal lie in tissue or an obstacle or outside, or no line leads there.
    """
    scene = costs.scene
    solid = [piece for _, piece in scene.pieces] + list(scene.obstacles)

    def is_free(points: np.ndarray) -> np.ndarray:
        within = ((points >= scene.area[0]) & (points <= scene.area[1])).all(axis=1)
        for piece in solid:
            within = within & (piece.clearance(points) >= scene.tip_radius)
        return np.asarray(within)

    ends = np.array([scene.start, scene.goal])
    for name, place in zip(("start", "goal"), ends, strict=True):
        if not is_free(place[None])[0]:
            raise Blocked(f"the {name} {place.tolist()} is blocked: the tip would touch something there; move it.")
    # 300 places, each with lines to the ten nearest.
    drawn = np.random.default_rng(0).uniform(scene.area[0], scene.area[1], (1200, 2))
    places = np.concatenate([ends, drawn[is_free(drawn)][:300]])
    pairs = np.unique(np.concatenate([neighbours(places, 10), [[0, 1]]]), axis=0)
    plan = cheapest_way(costs, places, pairs, costs.deformation(*places[pairs.T]))
    if plan is None:
        raise Blocked("the goal can't be reached: obstacles close every way to it; move it or open one.")
    return plan


def neighbours(places: np.ndarray, count: int) -> np.ndarray:
    """Return pairs of places of which one is among the other's nearest, each pair once, shape [E, 2]."""
    near = KDTree(places).query(places, k=min(count + 1, len(places)))[1][:, 1:]
    pairs = np.stack([np.repeat(np.arange(len(places)), near.shape[1]), near.ravel()], axis=1)
    return np.unique(np.sort(pairs, axis=1), axis=0)


def cheapest_way(costs: Any, places: np.ndarray, pairs: np.ndarray, deformation: np.ndarray) -> Plan | None:
    """Return the cheapest way from the first place to the second along lines, `shortened`; None = there is none.

    Args:
        costs: of the scene, with its `plan` of a way's places.
        places: shape [P, 2], in space [P, 3] [m].
        pairs: of places that lines join, shape [E, 2].
        deformation: by each line, shape [E] [mJ].
    """
    way = MILLI * np.linalg.norm(np.diff(places[pairs], axis=1)[:, 0], axis=1)
    chain = cheapest_chain(len(places), *pairs.T, weighed(costs.scene.alpha, deformation, way), way)
    return None if chain is None else shortened(costs.plan, places[chain])


def cheapest_chain(count: int, one: np.ndarray, two: np.ndarray, cost: np.ndarray, way: np.ndarray) -> list[int] | None:
    """Return the cheapest chain of nodes from 0 to 1, of equally cheap ones the shortest; None = there is no way.

    Args:
        count: of nodes.
        one, two: nodes that each line joins, shape [E].
        cost, way: of each line, infinite where it is closed, shape [E].
    """
    passable = np.isfinite(cost)
    prices = (cost + TIE * way)[passable], (one[passable], two[passable])
    before = dijkstra(coo_array(prices, (count, count)).tocsr(), directed=False, indices=0, return_predecessors=True)[1]
    chain = [1]
    while chain[-1] > 0:
        chain.append(int(before[chain[-1]]))
    return chain[::-1] if chain[-1] == 0 else None


def shortened(plan_of: Callable[[np.ndarray], Plan], places: np.ndarray) -> Plan:
    """Return the way with places left out where that lowers the price."""
    found = plan_of(places)
    while len(found.places) > 2:
        others = [plan_of(np.delete(found.places, i, axis=0)) for i in range(1, len(found.places) - 1)]
        better = min(others, key=lambda plan: plan.price)
        if not better.price < found.price:
            break
        found = better
    return found
