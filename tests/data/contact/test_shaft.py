"""Lengths by a shaft's known diameter: exact projections of cylinders, with noise on their outlines."""

import functools
import math
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from palpate.data.contact.shaft import ShaftRuler, shaft_depth, shaft_edges
from palpate.data.labels import TISSUE, TOOL
from palpate.data.source.camera import Camera
from palpate.physics.identifiability import NINETY

PICTURE, RADIUS = Camera.from_focal(600.0, 854, 480), 0.0025
GRID = PICTURE.scaled(214, 120)
UNIT = 0.13
"""Metres of a scene unit of the frames below."""


@functools.cache
def rays_of(camera: Camera) -> np.ndarray:
    """(x, y, 1) of every pixel, shape [H, W, 3]."""
    rows, columns = np.indices((camera.height, camera.width))
    places = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    return np.stack([*places, np.ones(rows.shape)], axis=-1)


def cylinder(camera: Camera, tip: np.ndarray, axis: np.ndarray, length: float = 0.4) -> np.ndarray:
    """Depth of a cylinder's surface from its tip on, [H, W] [m], by solving for each ray; 0 = not hit."""
    rays = rays_of(camera)
    across, offset = rays - (rays @ axis)[..., None] * axis, tip - (tip @ axis) * axis
    square, middle = (across**2).sum(-1), across @ offset
    root = middle**2 - square * (offset @ offset - RADIUS**2)
    depth = np.where(root > 0, (middle - np.sqrt(np.maximum(root, 0))) / square, 0)
    along = (depth[..., None] * rays - tip) @ axis
    return np.where((root > 0) & (depth > 0) & (along > 0) & (along < length), depth, 0)


@functools.lru_cache(64)
def covered(tip: tuple[float, ...], axis: tuple[float, ...]) -> np.ndarray:
    """Where a shaft is in the picture, [H, W] bool."""
    return cylinder(PICTURE, np.array(tip), np.array(axis)) > 0


def drawn(seed: int, distance: float, tilt: float, noise: float = 0.0) -> tuple[Any, np.ndarray, np.ndarray]:
    """A frame in contact at the tip of a shaft that comes towards the camera, its tip [m] and its mask."""
    generator = np.random.default_rng(seed)
    turn, tilt = generator.uniform(0, 2 * np.pi), math.radians(tilt)
    axis = np.array([math.cos(turn) * math.cos(tilt), math.sin(turn) * math.cos(tilt), -math.sin(tilt)])
    tip = distance * np.array([*generator.uniform(-0.1, 0.1, 2), 1.0])
    mask = covered((*tip,), (*axis,)).astype(np.float32)
    if noise:  # of the outline, some pixels long
        shift = cv2.GaussianBlur(generator.normal(0, 1, (2, 480, 854)).astype(np.float32).transpose(1, 2, 0), (0, 0), 3)
        shift *= noise / shift.std()
        rows, columns = np.indices(mask.shape, np.float32)
        mask = cv2.remap(mask, columns + shift[..., 0], rows + shift[..., 1], cv2.INTER_LINEAR)
    tool = mask > 0.5
    depth, labels = cylinder(GRID, tip, axis) / UNIT, np.full((120, 214), TISSUE, np.uint8)
    labels[depth > 0] = TOOL
    depth[depth == 0] = tip[2] / UNIT
    pixel = np.rint(tip[:2] / tip[2] * [GRID.fx, GRID.fy] + [GRID.cx, GRID.cy]).astype(int)
    geometry = SimpleNamespace(pixel=tuple(pixel), tissue_point=tip / UNIT)
    pictured = np.where(tool, TOOL, TISSUE).astype(np.uint8)
    frame = {"picture_labels": pictured, "has_depth": True, "labels": labels, "depth": depth, "geometry": geometry}
    return SimpleNamespace(**frame), tip, tool


def measured(frames: list[Any], *, guessed: bool = False) -> tuple[float, float] | None:
    """What a ruler tells of a scene unit."""
    clip: Any = SimpleNamespace(picture_camera=PICTURE, camera=GRID, guesses_depth=guessed)
    ruler = ShaftRuler(2 * RADIUS, clip)
    assert list(ruler.watched(frames)) == frames
    return ruler.metres()


@pytest.mark.parametrize("tilt", [0, 30, 60])
@pytest.mark.parametrize("distance", [0.03, 0.07, 0.15])
def test_the_axis_lies_where_it_was_drawn(distance: float, tilt: int) -> None:
    for seed in range(4):
        _, tip, tool = drawn(seed, distance, tilt)
        edges = shaft_edges(tool)
        assert edges is not None
        planes = [edge.plane(PICTURE) for edge in edges]
        found = shaft_depth(planes, RADIUS, tip[None] / tip[2], axis=True)
        assert found == pytest.approx(tip[2], rel=0.012)


def test_the_surface_is_that_of_the_cylinder_and_nothing_lies_beside_it() -> None:
    """Its front stands a radius before its axis, as seen along a ray through the axis."""
    planes = [np.array([0.0, sign * math.cos(0.05), -math.sin(0.05)]) for sign in (1, -1)]
    distance = RADIUS / math.sin(0.05)
    straight, beside = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.2, 1.0]])
    assert shaft_depth(planes, RADIUS, straight, axis=True) == pytest.approx(distance)
    assert shaft_depth(planes, RADIUS, straight, axis=False) == pytest.approx(distance - RADIUS)
    assert np.isnan(shaft_depth(planes, RADIUS, beside, axis=False)).all()
    assert np.isnan(shaft_depth(planes, RADIUS, beside, axis=True)).all()


@pytest.fixture(scope="module", params=[0.0, 0.7])
def far_and_near(request: pytest.FixtureRequest) -> list[Any]:
    """Frames over a fivefold range of distances and 60 degrees of tilt, without and with noise."""
    frames = []
    for seed in range(60):
        generator = np.random.default_rng(1000 + seed)
        distance, tilt = 0.03 * 5 ** generator.uniform(), generator.uniform(0, 60)
        frames.append(drawn(seed, distance, tilt, request.param)[0])
    return frames


@pytest.mark.parametrize("guessed", [False, True])
def test_lengths_are_within_five_percent_and_intervals_hold(far_and_near: list[Any], guessed: bool) -> None:
    errors, sds, unknown = [], [], 0
    for frame in far_and_near:
        found = measured([frame], guessed=guessed)
        if found is None:
            unknown += 1
            continue
        errors.append(math.log(found[0] / UNIT))
        sds.append(found[1])
    assert unknown <= 3
    assert np.quantile(np.abs(errors), 0.95) < 0.05
    assert (np.abs(errors) < NINETY * np.array(sds)).mean() >= 0.88
    assert np.median(sds) < 0.05


def test_frames_are_combined_robustly() -> None:
    frames = [drawn(seed, 0.08, 30, 0.5)[0] for seed in range(7)]
    frames[3].depth *= 2
    found = measured(frames)
    assert found is not None
    assert found[0] == pytest.approx(UNIT, rel=0.02)
    assert found[1] < 0.05


def test_a_shaft_that_is_not_seen_well_tells_nothing() -> None:
    frame, tip, tool = drawn(2, 0.08, 20)
    short = tool & (np.linalg.norm(np.indices(tool.shape).T - tip[:2] / tip[2] * 600 - [426.5, 239.5], axis=-1).T < 35)
    half = np.zeros_like(tool)
    half[:8, 100:600] = True  # one edge beyond the picture
    ragged = tool & (cv2.GaussianBlur(np.random.default_rng(0).normal(0, 1, tool.shape), (0, 0), 6) > 0)
    disc = cv2.circle(np.zeros(tool.shape, np.uint8), (400, 240), 60, 1, -1) > 0
    for mask in (short, half, ragged, disc, np.zeros_like(tool)):
        assert shaft_edges(mask) is None
    frame.picture_labels = np.full_like(frame.picture_labels, TISSUE)
    assert measured([frame]) is None
    frame.picture_labels = None
    assert measured([frame]) is None


def test_without_contact_guessed_depth_tells_nothing() -> None:
    frame, _, _ = drawn(3, 0.08, 20)
    assert measured([frame], guessed=True) is not None
    frame.geometry.pixel = (5, 115)  # far beside the axis
    assert measured([frame], guessed=True) is None
    frame.geometry = None
    assert measured([frame], guessed=True) is None
