"""What a sequence beside a robot shows of presses: the surface at rest, contacts, forces, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from palpate.data.source.layout import InputError
from palpate.data.source.sequence import moved
from palpate.estimators.cloud_shape import CloudShape
from palpate.estimators.palpation.bench import Bench
from palpate.estimators.palpation.presses import BELOW, RIM, _closed, read_presses
from palpate.estimators.palpation.scene import Scene, read_scene
from tests.palpated import BODY, RADIUS, SHIFT, TURN, write_palpation

PRESSES = [(0.8, (0.2, 1.0)), (1.2, (0.3, 4.0))]
COARSE: dict[str, Any] = {"cells": 4, "edge": None, "law": "linear"}


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two presses, by a coarse body."""
    return write_palpation(tmp_path_factory.mktemp("palpated"), PRESSES, **COARSE)


@pytest.fixture(scope="module")
def scene(sequence: Path) -> Scene:
    return read_scene(sequence)


def test_presses_are_found_in_the_robot_s_frame(sequence: Path) -> None:
    (vertices, _), palpations, settings, upright, floor, _ = read_presses(sequence)
    np.testing.assert_allclose(upright[:3, 2], TURN[:, 2], atol=2e-3)
    standing = moved(vertices, np.linalg.inv(upright))
    assert floor == (2, 0.0)
    assert standing[:, 2].min() == pytest.approx(-BELOW)
    assert np.median(standing[standing[:, 2] > 0, 2]) == pytest.approx(BODY.height, abs=2e-4)
    for (force, place), each in zip(PRESSES, palpations, strict=True):
        contact, normal = BODY.contact(*place)
        np.testing.assert_allclose(each.contact, contact @ TURN.T + SHIFT, atol=3e-4)
        np.testing.assert_allclose(each.force, -force * TURN @ normal, atol=1e-6)
        on_body = (moved(each.points, each.pose) - SHIFT) @ TURN
        assert np.abs(on_body[:, :2]).max() < BODY.size / 2 - RIM * 5e-4
        assert np.linalg.norm(on_body[:, :2] - contact[:2], axis=1).min() > RADIUS - 1e-3
    # 5,000 points of a press by 48,000 at rest.
    used = max(len(each.points) for each in palpations)
    assert settings.widened == pytest.approx(np.sqrt(1 + used / (8 * 6000)))


def test_the_body_reaches_from_the_surface_to_its_support(scene: Scene) -> None:
    nodes = (scene.skin.body.rest - SHIFT) @ TURN
    assert nodes[:, 2].min() == pytest.approx(0.0, abs=4e-4)
    upper = nodes[nodes[:, 2] > 0.9 * BODY.height, 2]
    assert np.median(upper) == pytest.approx(BODY.height, abs=1e-4)
    assert upper.max() == pytest.approx(BODY.height, abs=8e-4)  # a corner that few points show
    assert np.ptp(nodes[:, :2], axis=0) == pytest.approx([BODY.size] * 2, rel=0.04)
    held = scene.held.all(axis=1)
    assert np.ptp(nodes[held, 2]) < 1e-3
    assert scene.skin.body.volumes.sum() == pytest.approx(BODY.size**2 * BODY.height, rel=0.03)
    # Turned as the nodes are, the gradients of shape functions give a turn no strain.
    turned = scene.skin.body.rest @ (TURN - np.eye(3)).T
    gradient = scene.skin.body.deformation(turned)
    np.testing.assert_allclose(gradient, np.broadcast_to(TURN, gradient.shape), atol=1e-9)


def test_a_pose_that_a_robot_knows_is_kept(scene: Scene) -> None:
    """A flat surface would slide under the tool."""
    bench = Bench(scene.skin, scene.held, scene.palpations, "corotational")
    for pose, each in zip(bench.poses, scene.palpations, strict=True):
        assert pose is each.pose
    assert 3e-4 < bench.noise < 4e-4


def test_a_closed_surface_holds_what_lies_under_it() -> None:
    random = np.random.default_rng(4)
    points = np.column_stack([random.uniform(0, 0.04, (4000, 2)), np.full(4000, 0.002)])
    mesh = CloudShape(points, "cloud").mesh(0.002)
    closed = trimesh.Trimesh(*_closed(mesh, 0.012), process=False)
    assert closed.is_watertight
    assert closed.is_winding_consistent
    area = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).area
    assert abs(closed.volume) == pytest.approx(0.01 * area, rel=1e-4)


def test_a_wrench_in_another_frame_is_told(tmp_path: Path) -> None:
    """Quaternions with w first turned the force by 48°, and E was 2.3 times too high after two of the fit's steps."""
    path = write_palpation(tmp_path, PRESSES[:1], **COARSE)
    head, *rows = (tmp_path / "poses.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    lines = [",".join([*row[:4], row[7], *row[4:7]]) for row in cells]
    (tmp_path / "poses.csv").write_text("\n".join([head, *lines]))
    with pytest.raises(
        InputError, match=r"sequence\.yaml: a force is over 45° off the tissue's normal; check its frame"
    ):
        read_presses(path)


def test_forces_that_are_late_are_told(tmp_path: Path) -> None:
    path = write_palpation(tmp_path, PRESSES[:1], **COARSE)
    head, *rows = (tmp_path / "forces.csv").read_text().splitlines()
    times, forces = zip(*(row.split(",", 1) for row in rows), strict=True)
    late = [f"{float(time) + 0.3},{force}" for time, force in zip(times, forces, strict=True)]
    (tmp_path / "forces.csv").write_text("\n".join([head, rows[0], *late]))
    with pytest.raises(InputError, match=r"the tip is 0.01 m off the tissue while it presses; put forces and poses on"):
        read_presses(path)


def test_presses_that_no_cloud_shows_are_told(tmp_path: Path) -> None:
    path, nothing = write_palpation(tmp_path, PRESSES[:1], **COARSE), np.empty((0, 3))
    for number in (0, 1):
        np.savez(tmp_path / f"clouds/{number:03d}.npz", points=nothing)
    assert len(read_presses(path)[1][0].points) > 1000
    for number in range(8, 14):
        np.savez(tmp_path / f"clouds/{number:03d}.npz", points=nothing)
    with pytest.raises(InputError, match=r"sequence\.yaml: no cloud shows the press at 1\.[1-3] s; give"):
        read_presses(path)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"forces": None, "thickness": None}, "palpation needs forces, and the thickness of the tissue"),
        ({"forces": "none.csv"}, "shows no press after tissue at rest"),
        ({"thickness": 25.0}, "sequence.yaml: grip_radius or thickness can't be the tissue's; check `unit`"),
        ({"grip_radius": 15.0}, "grip_radius or thickness can't be the tissue's"),
        ({"grip_radius": 15e-6}, "grip_radius or thickness can't be the tissue's"),
    ],
)
def test_what_is_missing_is_said(tmp_path: Path, changed: dict[str, object], said: str) -> None:
    path = write_palpation(tmp_path, PRESSES[:1], **COARSE, **changed)
    (tmp_path / "none.csv").write_text("time_s,Fx,Fy,Fz\n0,1,1,1\n5,1,1,1\n")
    with pytest.raises(InputError, match=said):
        read_scene(path)
