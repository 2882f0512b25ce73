"""Plans in space on drawn bodies, judged by finite elements: how often intervals and limits of force hold.

    python -m tests.planning.drawn_bodies --bodies 12 --seed 984001

Every seed draws a body (a superellipsoid between ball, bar, slab and block, with waves, held by its foot or its ends),
E, which the planner knows to 10 %, tip, port, α and limit. Linear finite elements that the tip and the shaft press
without friction tell the work and the largest force along the planned path; there is no inertia, so that speed changes
nothing. Where OMPL is installed, its cost stands beside ours.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import importlib.util
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import KDTree

from palpate.common.options import options, require_within
from palpate.physics.fem import Material, find_equilibrium, make_solid, mesh_surface
from palpate.planning.pressing import PressingCosts
from palpate.planning.roadmap import MILLI, Blocked
from palpate.planning.sampled import plan_by_ompl
from palpate.planning.scene import SpaceScene
from palpate.planning.space_map import open_costs, plan_in_space
from palpate.planning.waypoints import waypoints

POISSON = 0.45
YOUNG_LOG_SD = 0.1
CELLS = 10
"""Of the finite elements' mesh along the body's longest side."""
NEAR = 2.2
"""How far from the tip's path nodes may touch, over the radius."""
DEEP = 4.5
"""How far a node may be pushed, over the radius."""
SWAPS = 30
"""Times that the set of touching nodes is changed: to those that press and those that would go through."""


@dataclass(frozen=True)
class Options:
    """Of the command."""

    bodies: int = 12
    """How many are drawn."""
    seed: int = 984001
    """Of the first body; each further one takes the next."""
    ompl_s: float = 20.0
    """For which OMPL looks for a cheaper path; 0 = it isn't asked [s]."""

    def __post_init__(self) -> None:
        require_within(self, bodies=(1, 1000), seed=(0, 2**31), ompl_s=(0, 600))


def draw_body(seed: int, folder: Path) -> tuple[SpaceScene, float, int]:
    """A scene with its mesh in the folder, the body's true E [Pa], and the axis whose ends (2: foot) are held."""
    draws = np.random.default_rng(seed)
    half = draws.uniform([0.045, 0.02, 0.014], [0.06, 0.05, 0.035])
    ball = trimesh.creation.icosphere(5)
    power, waves = draws.uniform(2, 8), draws.uniform(0, 0.08)
    places = ball.vertices / (np.abs(ball.vertices) ** power).sum(axis=1, keepdims=True) ** (1 / power)
    places *= half * (1 + waves * np.cos(draws.uniform(2, 6) * places[:, :1] + draws.uniform(0, 6)))
    mesh = str(folder / f"{seed}.ply")
    trimesh.Trimesh(places, ball.faces).export(mesh)
    radius, young = draws.uniform(0.007, 0.011), 10 ** draws.uniform(3, 4.5)
    level = half[2] + draws.uniform(-1, 0.4) * radius
    start, goal = ((draws.uniform(-0.01, 0.01), side * (half[1] + 2.5 * radius), level) for side in (-1, 1))
    ratio = draws.uniform(0.1, 1) * 0.3 / (MILLI * young * radius**3)
    limit, port = draws.uniform(3, 9) * young * radius**2, (*draws.uniform(-0.04, 0.04, 2), 0.2)
    told = young * np.exp(YOUNG_LOG_SD * draws.normal())
    given = mesh, start, goal, port, limit, told, YOUNG_LOG_SD
    scene = SpaceScene(*given, poisson=POISSON, tip_radius=radius, alpha=ratio / (1 + ratio))
    return scene, young, int(draws.choice([0, 2]))


def simulated(costs: PressingCosts, tips: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Forces [N] and stored energies [J] with the tip at places [M, 3], for E = 1 Pa, shapes [M]."""
    surface = trimesh.load_mesh(costs.scene.mesh)
    meshed = mesh_surface(surface.vertices, surface.faces, cells=CELLS)
    body = make_solid(meshed.nodes, meshed.tetrahedra, order=2)
    rest, along = body.rest, body.rest[:, axis]
    low, high = along.min() + 0.15 * np.ptp(along), along.max() - 0.15 * np.ptp(along)
    held = (along < low) | ((along > high) & (axis == 0))
    one, two, three = body.faces.T
    ab, bc, ca = (KDTree(rest).query((rest[a] + rest[b]) / 2)[1] for a, b in ((one, two), (two, three), (three, one)))
    faces = np.array([[one, ab, ca], [ab, two, bc], [ca, bc, three], [ab, bc, ca]]).swapaxes(1, 2).reshape(-1, 3)
    normals = trimesh.Trimesh(rest, faces, process=False).vertex_normals
    used = np.setdiff1d(faces, np.flatnonzero(held))
    near = used[KDTree(tips).query(rest[used])[0] < NEAR * costs.radius]
    at, outwards = rest[near], normals[near]
    settled = find_equilibrium(body, Material("linear", 1.0, POISSON), np.repeat(held[:, None], 3, axis=1))
    forces = np.zeros((*rest.shape, len(near)))
    forces[near, :, np.arange(len(near))] = outwards
    gives = np.einsum("ni,nij->nj", outwards, settled.moved_by(forces)[near])
    gives = (gives + gives.T) / 2 + 1e-9 * np.trace(gives) / len(near) * np.eye(len(near))
    pushes, depths = np.zeros((2, len(tips))), np.linspace(0, DEEP * costs.radius, 241)
    points = at[:, None] - depths[:, None] * outwards[:, None]
    for row, tip in enumerate(tips):
        axis_to = (costs.port - tip) / np.linalg.norm(costs.port - tip)
        gone = np.maximum((points - tip) @ axis_to, 0)
        inside = np.linalg.norm(points - tip - gone[..., None] * axis_to, axis=2) < costs.radius
        # A node goes to where it leaves the instrument for good, if it is within it at rest.
        pushed = np.where(inside[:, 0], depths[240 - inside[:, ::-1].argmax(axis=1)], 0.0)
        touching, found = pushed > 0, np.zeros(len(near))
        for _ in range(SWAPS):
            found[:] = 0
            found[touching] = np.linalg.solve(gives[np.ix_(touching, touching)], pushed[touching])
            wanted = np.where(touching, found > 0, pushed - gives @ found > 1e-6 * costs.radius)
            if (wanted == touching).all():
                break
            touching = wanted
        pushes[:, row] = np.linalg.norm(found @ outwards), found @ gives @ found / 2
    return pushes[0], pushes[1]


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge; returns the exit status."""
    chosen, held, ratios = options(Options, arguments, "tests.planning.drawn_bodies", __doc__), [], []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(chosen.seed, chosen.seed + chosen.bodies):
            scene, young, axis = draw_body(seed, Path(folder))
            try:
                costs, _ = open_costs(scene, Path(folder))
                plan = plan_in_space(costs)
            except Blocked as error:
                print(f"{seed}: {error}", flush=True)
                continue
            rows, (low, high) = waypoints(costs, plan), costs.interval(plan)
            force, energy = young * np.array(simulated(costs, rows[:, 1:4], axis))
            cost = scene.alpha * MILLI * (np.abs(np.diff(energy)).sum() + energy[-1] - energy[0]) / 2
            cost, peak = cost + (1 - scene.alpha) * plan.way, rows[:, 8:].max(axis=0)
            held.append([low <= cost <= high, peak[1] <= force.max() <= peak[2], force.max() <= scene.limit_N])
            said = (
                f"{seed}: cost {plan.cost:.2f} ({low:.2f} to {high:.2f}), simulated {cost:.2f}; force {peak[0]:.3f} N"
            )
            said += f" ({peak[1]:.3f} to {peak[2]:.3f}), simulated {force.max():.3f}, limit {scene.limit_N:.3f}"
            if chosen.ompl_s and importlib.util.find_spec("ompl"):
                ratios.append(plan_by_ompl(costs, chosen.ompl_s).cost / plan.cost)
                said += f"; OMPL's cost over ours {ratios[-1]:.3f}"
            print(said, flush=True)
    counts = np.sum(held, axis=0) if held else np.zeros(3)
    print("of {}: cost's interval holds {:g}, largest force's {:g}, limit kept {:g}".format(len(held), *counts))
    return 0


if __name__ == "__main__":
    run_door(main)
