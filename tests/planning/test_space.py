"""Plans in space: a body's distances, what presses on it cost, ways that keep below a limit, and what is told."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial.transform import Rotation

from palpate import api
from palpate.cli import plan as door
from palpate.planning import space_map
from palpate.planning.press import simulate_press
from palpate.planning.pressing import RADIUS, PressingCosts, unit_press
from palpate.planning.roadmap import Blocked
from palpate.planning.scene import SoftObject, SpaceScene
from palpate.planning.space_map import open_costs, plan_in_space
from palpate.planning.surface import measure
from palpate.planning.waypoints import waypoints

DEPTHS = np.linspace(0, 4, 81)
PRESS = np.stack([DEPTHS, DEPTHS, DEPTHS**2 / 2])
"""A tip that is pushed back by E·R·depth."""
SIZE = np.array([0.08, 0.06, 0.04])
APART = np.array([0.03, 0.0, 0.0])
"""Distance of two balls that overlap [m]."""


@pytest.fixture(scope="module", autouse=True)
def body(tmp_path_factory):
    """A box's file, and presses that need no simulation."""
    path = tmp_path_factory.mktemp("space") / "body.ply"
    trimesh.creation.box(SIZE).export(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(space_map, "unit_press", lambda _: PRESS)
        yield path


@pytest.fixture
def scene(body):
    ends = {"start": (-0.06, 0.0, 0.0), "goal": (0.06, 0.0, 0.0)}
    return SpaceScene(str(body), port=(0.0, 0.0, 0.12), limit_N=1.0, young=5000.0, **ends)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("maps")


def test_distances_are_those_of_a_box(body):
    grid = measure(body, "m", 0.0025)
    costs = PressingCosts(SpaceScene(str(body), *[(0.0, 0.0, 1.0)] * 3, 1.0, 1.0), grid | {"press": PRESS})
    points = np.random.default_rng(0).uniform(*(costs.corners * 0.98), (4000, 3))
    beyond = np.abs(points) - SIZE / 2
    true = np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)
    error = np.abs(costs.distance(points) - true)[true > -0.01]
    assert np.median(error) < 0.02 * grid["step"]  # edges err most
    assert error.max() < 0.6 * grid["step"]


@pytest.mark.parametrize("kind", ["inwards", "turned", "torn", "overlapping", "nested", "repeated", "hole"])
def test_bodies_of_any_triangles_are_measured(kind, tmp_path):
    ball, drawn = trimesh.creation.icosphere(4, 0.02), np.random.default_rng(0)
    vertices, faces = ball.vertices, ball.faces.copy()
    if kind == "inwards":
        faces = faces[:, ::-1]
    elif kind == "turned":
        faces[::3] = faces[::3, ::-1]
    elif kind == "torn":
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
        vertices = vertices + 1e-5 * drawn.normal(size=vertices.shape)
    elif kind == "overlapping":
        faces, vertices = np.concatenate([faces, faces + len(vertices)]), np.concatenate([vertices, vertices + APART])
    elif kind == "nested":
        vertices, faces = np.concatenate([vertices, 0.6 * vertices]), np.concatenate([faces, faces + len(vertices)])
    elif kind == "repeated":
        faces = np.concatenate([faces, faces[:9], [[0, 0, 1], [7, 7, 7]]])
    else:
        faces = faces[1:]
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "ball.ply")
    costs = PressingCosts(SpaceScene("", *[(0.0, 0.0, 1.0)] * 3, 1.0, 1.0), measure(tmp_path / "ball.ply", "m", 0.0025))
    points = drawn.uniform(-0.024, 0.024, (4000, 3))
    true = np.linalg.norm(points, axis=1) - 0.02
    known = true > -0.01
    if kind == "overlapping":  # closer to the other ball the closest place is elsewhere
        known &= points[:, 0] < 0.5 * np.linalg.norm(points, axis=1)
        true = np.minimum(true, np.linalg.norm(points - APART, axis=1) - 0.02)
    assert np.abs(costs.distance(points) - true)[known].max() < 0.6 * costs.known["step"]


@pytest.mark.parametrize("thickness", [0.0005, 0.005, 0.01])
def test_a_fold_is_passed_around_its_rim_and_not_through_it(tmp_path, scene, cache, thickness):
    trimesh.creation.box((0.08, thickness, 0.06)).export(tmp_path / "fold.ply")
    ends = {"start": (0.0, -0.03, 0.0), "goal": (0.0, 0.03, 0.0), "port": (0.0, 0.0, 0.15)}
    costs = open_costs(replace(scene, mesh=str(tmp_path / "fold.ply"), limit_N=5.0, **ends), cache)[0]
    across = np.array([[-0.02, -0.03, 0.01], [-0.02, 0.03, 0.01]])
    assert costs.price(across[:1], across[1:])[0] == np.inf
    way = plan_in_space(costs).places
    at = (way[:-1, 1] * way[1:, 1] <= 0).argmax()
    crossing = way[at] + way[at, 1] / (way[at, 1] - way[at + 1, 1]) * (way[at + 1] - way[at])
    assert 0.029 < crossing[2] < 0.035  # 30 mm is its rim
    with pytest.raises(Blocked, match="tip or shaft would go through the tissue"):  # the shaft is on the other side
        open_costs(replace(costs.scene, port=(0.0, -0.1, 0.1)), cache)


def test_a_straight_press_costs_its_work_and_both_ways_the_same(scene, cache):
    costs = open_costs(scene, cache)[0]
    above, pressed = np.array([[0, 0, 0.026]]), np.array([[0, 0, 0.0185]])
    depth = 0.0025 - (0.0185 - 0.02)
    force, energy = (each[0] * scene.young for each in costs.loads(pressed))
    balls = sum(max(depth - (k * 0.0025), 0) ** np.array([1, 2]) * (1 if k == 0 else 0.5) for k in range(3))
    assert force == pytest.approx(scene.young * 0.0025 * balls[0], rel=0.02)
    assert energy == pytest.approx(scene.young * 0.0025 * balls[1] / 2, rel=0.02)
    assert costs.plan(np.concatenate([above, pressed])).deformation == pytest.approx(1000 * energy, rel=1e-6)
    assert costs.price(above, pressed) == pytest.approx(costs.price(pressed, above))
    assert costs.loads(np.array([[0.0, 0.0, 0.001]]))[0] == np.inf  # deeper than is known


def test_a_shaft_is_looked_at_within_the_grid_of_distances_alone(scene, cache, monkeypatch):
    """From 0.9 m away a query took seconds; loads are those of all balls up to the port."""
    costs, counts = open_costs(replace(scene, port=(0.05, 0.0, 0.9)), cache)[0], []
    tips = np.random.default_rng(0).uniform(*(1.5 * costs.corners), (300, 3))
    tips = np.concatenate([tips, tips - [0, 0, 0.9]])  # half of these shafts go through the whole body
    away, radius = costs.port - tips, costs.radius
    balls = [
        tip + radius * np.arange(np.ceil((far := np.linalg.norm(way)) / radius))[:, None] * way / far
        for tip, way in zip(tips, away, strict=True)
    ]
    depth, force, energy = PRESS * radius ** np.array([[1], [2], [3]])
    for got, told, beyond in zip(costs.loads(tips), (force, energy), (np.inf, energy[-1]), strict=True):
        each = [np.interp(radius - costs.distance(places), depth, told, right=beyond) for places in balls]
        np.testing.assert_allclose(got, [(loads[0] + loads.sum()) / 2 for loads in each], rtol=1e-9, atol=1e-15)
    distance = costs.distance
    monkeypatch.setattr(costs, "distance", lambda points: counts.append(len(points)) or distance(points))
    costs.loads(tips[300:])
    assert counts[0] < 300 * (np.linalg.norm(np.ptp(costs.corners, axis=0)) / radius + 2)


@pytest.mark.parametrize("limit", [0.05, 0.3])
def test_the_limit_holds_between_waypoints_too(scene, cache, limit):
    costs = open_costs(replace(scene, limit_N=limit, alpha=0.1), cache)[0]
    places = plan_in_space(costs).places
    gone = np.linspace(0, len(places) - 1, 5000)
    tips = np.stack([np.interp(gone, np.arange(len(places)), each) for each in places.T], axis=1)
    upper = costs.loads(tips)[0].max() * scene.young * costs.spread
    assert 0.8 * limit < upper < limit
    assert plan_in_space(open_costs(replace(scene, alpha=1.0), cache)[0]).deformation == 0


def test_cost_intervals_are_those_of_a_log_normal_e(scene, cache):
    unsure = open_costs(replace(scene, young_log_sd=0.4, alpha=0.5), cache)[0]
    press = np.array([[0.0, 0.0, 0.026], [0.0, 0.0, 0.0185]])
    found = unsure.plan(press)
    factor = np.exp(1.645 * np.hypot(0.4, 0.56))
    wanted = [found.cost + 0.5 * found.deformation * (each - 1) for each in (1 / factor, factor)]
    assert unsure.interval(found) == pytest.approx(wanted, rel=1e-3)


@pytest.mark.acceptance
def test_cost_intervals_hold_on_simulated_presses_of_other_bodies(scene, cache):
    costs = open_costs(replace(scene, young_log_sd=0.3, alpha=1.0, tip_radius=RADIUS), cache)[0]
    depth, _, work = unit_press(0.45)
    held = []
    drawn = np.exp(0.3 * np.random.default_rng(0).normal(size=200))
    finer = ((0.1, 0.12, 0.12), ("right", "top", "bottom"), (6, 7, 7)), ((0.06, 0.16, 0.16), ("right",), (4, 6, 6))
    for size, sides, cells in finer:
        tissue = SoftObject(size, 1000.0, 0.45, sides, longest=0.03, cells=cells)
        true = simulate_press(tissue, RADIUS, np.array([-size[0] / 2, 0.0]), 0.0).work_at(np.array([0.02, 0.03]))
        told = np.interp([2, 3], depth, work) * 1000 * RADIUS**3
        ratio = true[:, None] * drawn / told[:, None]
        held.append((1 / costs.spread < ratio) & (ratio < costs.spread))
    assert np.mean(held) > 0.88


def test_waypoints_say_when_where_and_how_hard(scene, cache):
    costs = open_costs(scene, cache)[0]
    rows = waypoints(costs, plan := plan_in_space(costs))
    assert rows[-1, 0] == pytest.approx(plan.way / 1000 / scene.speed)
    assert np.linalg.norm(np.diff(rows[:, 1:4], axis=0), axis=1) == pytest.approx(np.diff(rows[:, 0]) * 0.01, abs=1e-5)
    axes = Rotation.from_quat(rows[:, 4:8]).apply([0, 0, 1])
    shaft = rows[:, 1:4] - costs.port
    assert axes == pytest.approx(shaft / np.linalg.norm(shaft, axis=1, keepdims=True), abs=1e-9)
    turned = np.linalg.norm(np.diff(rows[:, 4:8], axis=0), axis=1)
    assert turned.max() < 0.02  # no leap where the shaft points straight down
    assert (rows[:, 9] <= rows[:, 8]).all()
    assert (rows[:, 10] <= scene.limit_N).all()


FILE = {"mesh": "body.ply", "start": [-0.06, 0.0, 0.0], "goal": [0.06, 0.0, 0.0], "port": [0.0, 0.0, 0.12]}
FILE |= {"limit_N": 0.1, "young": 5000.0}


def planned(body, cache, name="scene", **changes):
    path = body.parent / f"{name}.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in (FILE | changes).items() if value is not None}))
    return path, door.main([str(path), "--output", str(body.parent / name), "--cache", str(cache)])


def test_a_palpation_tells_e_and_the_second_start_finds_the_map(body, cache, capsys):
    e = {"young_pa": 4000.0, "young_low_pa": 3000.0, "young_high_pa": 5333.3}
    (body.parent / "calibration.json").write_text(json.dumps(e))
    path, status = planned(body, cache, young=None, calibration="calibration.json")
    assert (status, planned(body, cache, "other", start=[-0.05, 0.02, 0.0])[1]) == (0, 0)
    assert "found in the cache" in capsys.readouterr().err
    told = json.loads((body.parent / "scene" / "plan.json").read_text())
    assert told["young_pa"] == 4000
    assert told["cost_low"] <= told["cost"] <= told["cost_high"]
    assert api.plan(path, cache).cost == told["cost"]
    assert told["straight_cost"] is None  # through the body
    columns, *lines = (body.parent / "scene" / "path.csv").read_text().splitlines()
    assert columns == "time_s,x_m,y_m,z_m,qx,qy,qz,qw,expected_force_N,force_low_N,force_high_N"
    assert [float(cell) for cell in lines[-1].split(",")[1:4]] == pytest.approx(FILE["goal"])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"mesh": "mm.ply"}, "is 80 m long in unit m; give `unit: cm or mm`"),
        ({"mesh": "open.ply"}, "is not closed"),
        ({"tip_radius": 0.0001}, "is 0.08 m long, too large beside a tip of 0.0001 m; cut out the part"),
        ({"mesh": "cm.ply"}, "is 8 m long in unit m; give `unit: cm or mm`"),
        ({"mesh": "none.stl"}, "there is no mesh"),
        ({"mesh": "bad.yaml"}, "is no mesh of triangles"),
        ({"start": [0.0, 0.0, 0.0]}, "start [0.0, 0.0, 0.0] lies inside the tissue"),
        ({"port": [0.0, 0.0, 0.0]}, "from port [0.0, 0.0, 0.0] the shaft comes out of the tissue nowhere; move it out"),
        ({"goal": [60.0, 0.0, 0.0]}, "lies over 1 m from"),
        # Under the body, so that the shaft would lead through it.
        (
            {"goal": [0.0, 0.0, -0.03]},
            "at the goal [0.0, 0.0, -0.03] tip or shaft would go through the tissue; move it",
        ),
        ({"goal": [0.0, 0.0, 0.016]}, "at the goal [0.0, 0.0, 0.016] the force is over limit_N, 0.1"),
        ({"calibration": "calibration.json"}, "each tell E; give one"),
        ({"limit_N": -1.0}, "limit_N"),
    ],
)
def test_bad_input_is_a_sentence(body, cache, capsys, changes, said):
    box = trimesh.creation.box(SIZE)
    trimesh.Trimesh(box.vertices, box.faces[1:]).export(body.parent / "open.ply")
    for unit, scale in (("mm", 1000), ("cm", 100)):
        trimesh.Trimesh(scale * box.vertices, box.faces).export(body.parent / f"{unit}.ply")
    assert planned(body, cache, "bad", **changes)[1] == 1
    assert said in " ".join(capsys.readouterr().err.split())


def test_no_way_below_the_limit_is_a_sentence(scene, cache):
    costs = open_costs(scene, cache)[0]
    costs.known["edges"] = np.full_like(costs.known["edges"], np.inf)
    with pytest.raises(Blocked, match="no way to the goal keeps the force below limit_N, 1; raise it"):
        plan_in_space(costs)
