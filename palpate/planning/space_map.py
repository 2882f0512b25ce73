"""A road map around a body in space, and the way through it.

The map is kept in a file for all starts, goals, moduli, limits and α. Places of its cheapest chain are left out as
long as that lowers the cost, and then moved.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from palpate.common.files import digest_of, file_sha256
from palpate.common.provenance import code_digest
from palpate.data.source.layout import InputError
from palpate.planning.cost_table import kept
from palpate.planning.pressing import PressingCosts, unit_press
from palpate.planning.roadmap import Blocked, Plan, cheapest_way, neighbours, shortened
from palpate.planning.scene import SpaceScene
from palpate.planning.surface import measure

JOINED = 40
"""Number of lines from start and from goal."""


def open_costs(scene: SpaceScene, cache: Path) -> tuple[PressingCosts, bool]:
    """Return a scene's costs with its road map, and whether that was found in the folder; otherwise it is made and
    kept.

    Raises:
        InputError: the mesh can't be used, or start, goal or port lie far from it.
        Blocked: they lie inside the tissue, or the instrument presses over its limit there.
        ForeignFile: a file that is not this program's lies in the folder.
        OSError: the mesh or the folder can't be read or written.
    """
    fields = scene.unit, scene.port, scene.tip_radius, scene.poisson
    version = 2  # of what is in a file
    key = digest_of([version, code_digest("kernels"), file_sha256(Path(scene.mesh)), fields])
    known, found = kept(cache / f"space-{key[:16]}.npz", lambda: _made(scene))
    costs = PressingCosts(scene, known)
    for name in ("start", "goal", "port"):
        place = getattr(costs, name)
        text = f"{name} {place.tolist()}"
        if np.linalg.norm(place - np.clip(place, *costs.corners)) > 1.0:
            raise InputError(f"{text} lies over 1 m from {scene.mesh}; give it in metres.")
        if name != "goal" and costs.distance(place[None])[0] < 0:
            raise Blocked(f"{text} lies inside the tissue; move it out.")
        if name != "port" and not np.isfinite(costs.loads(place[None])[0])[0]:
            raise Blocked(f"at the {text} tip or shaft would go through the tissue; move it or the port.")
        if name != "port" and not np.isfinite(costs.price(place[None], place[None]))[0]:
            raise Blocked(f"at the {text} the force is over limit_N, {scene.limit_N:g}; move it or the port.")
    return costs, found


def plan_in_space(costs: PressingCosts) -> Plan:
    """Find the cheapest way.

    Raises:
        Blocked: no way keeps below the limit.
    """
    known = costs.known
    places = np.concatenate([[costs.start, costs.goal], known["places"]])
    near = KDTree(known["places"]).query(places[:2], k=JOINED)[1] + 2
    joined = np.concatenate([[[0, 1]], np.stack([np.repeat([0, 1], JOINED), near.ravel()], axis=1)])
    fresh = costs.edges(places[joined[:, 0]], places[joined[:, 1]])
    deformation = costs.deformation(*np.concatenate([fresh, known["edges"]], axis=1))
    plan = cheapest_way(costs, places, np.concatenate([joined, known["pairs"] + 2]), deformation)
    if plan is None:
        limit = f"limit_N, {costs.scene.limit_N:g}"
        raise Blocked(f"no way to the goal keeps the force below {limit}; raise it, or move goal or port.")
    return shortened(costs.plan, _moved(costs, plan.places))


def _moved(costs: PressingCosts, places: np.ndarray) -> np.ndarray:
    """Return a way of places [P, 3] with each line halved, and with places moved to where that lowers the cost."""
    draws = np.random.default_rng(0)
    halved = np.linspace(0, len(places) - 1, 2 * len(places) - 1)
    way = np.stack([np.interp(halved, np.arange(len(places)), each) for each in places.T], axis=1)
    # In place of each of the way's places 16 are tried, about 4 radii from it at first and a quarter at last.
    reach = 4.0 * costs.radius
    while reach > 0.25 * costs.radius:
        for i in range(1, len(way) - 1):
            tried = np.concatenate([way[i : i + 1], way[i] + reach * draws.normal(size=(16, 3))])
            ends = np.concatenate([np.broadcast_to(way[j], tried.shape) for j in (i - 1, i + 1)])
            way[i] = tried[costs.price(np.tile(tried, (2, 1)), ends).reshape(2, -1).sum(axis=0).argmin()]
        reach /= 2**0.5
    return way


def _made(scene: SpaceScene) -> dict[str, Any]:
    """Return the content of the file: the arguments of costs, places [N, 3] [m], pairs of them [E, 2] and their `edges`
    [2, E]."""
    known = measure(Path(scene.mesh), scene.unit, scene.tip_radius) | {"press": unit_press(scene.poisson)}
    costs = PressingCosts(scene, known)
    around, count = 8 * scene.tip_radius * np.array([[-1.0], [1.0]]), 3000
    drawn = np.random.default_rng(0).uniform(*(costs.corners + around), (4 * count, 3))
    places = drawn[np.isfinite(costs.loads(drawn)[0])][:count]
    if len(places) < JOINED:
        raise Blocked(f"from port {list(scene.port)} the shaft comes out of the tissue nowhere; move it out.")
    pairs = neighbours(places, 12)
    return known | {"places": places, "pairs": pairs, "edges": costs.edges(*places[pairs.T])}
