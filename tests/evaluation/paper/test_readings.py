"""Readings of what the paper leaves open, against closed forms and limits."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from palpate.data.synthetic.scene import draw_scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.evaluation.paper import readings as module
from palpate.evaluation.paper.readings import (
    COLUMNS,
    ERROR,
    REFERENCE_ERROR,
    THETA,
    Reading,
    draw_contacts,
    farthest,
    foundation_for,
    main,
    measure,
    measure_settling,
    motions,
    readings,
)
from palpate.physics.mesh import grid_mesh

SMALL = SceneSettings(width=86, height=48, grid_width=86, grid_height=48)


@pytest.fixture(scope="module")
def scenes():
    return [draw_scene(SMALL, np.random.default_rng(seed)) for seed in range(3)]


@pytest.fixture(scope="module")
def flat(scenes):
    """A flat sheet, pressed in the middle: its springs resist a small force by their geometry only, so not at all."""
    row, column = np.mgrid[:21, :21]
    points = np.stack([(column - 10) * 0.01, (row - 10) * 0.01, np.full(row.shape, 0.5)], axis=-1)
    return dataclasses.replace(scenes[0], mesh=grid_mesh(points, np.ones(row.shape, bool)), vertex=10 * 21 + 10)


def test_a_flat_sheet_on_a_foundation_moves_as_one_mass(flat):
    """m ẍ + k_d ẋ + a·k_s x = F until 0.25 s, then 0; semi-implicit Euler is of first order in Δt."""
    stiffness, damping, force = 0.5, 0.2, -1e-6
    (path,) = motions(Reading(anchor=1.0), [flat], np.array([[stiffness, damping, force]]))
    times, mass = Reading().mechanics.times, 0.001
    rates = np.roots([mass, damping, stiffness])

    def response(since):
        """To a force that starts at 0."""
        first, second = rates
        shape = (second * np.exp(first * since) - first * np.exp(second * since)) / (first - second)
        return np.where(since > 0, force / stiffness * (1 + shape), 0)

    expected = response(times) - response(times - 0.25)
    np.testing.assert_allclose(path @ [0, 0, -1], expected, atol=0.03 * np.abs(expected).max())


def test_directions_are_away_from_the_camera_towards_it_and_across(scenes):
    [scene] = scenes[:1]
    inward, outward, along = (Reading(direction=each).press(scene).direction for each in module.DIRECTIONS)
    assert -inward[2] > 0.9  # n points towards the camera, at −z, and a negative force away from it
    np.testing.assert_allclose(outward, -inward)
    assert abs(along @ inward) < 1e-6
    assert np.linalg.norm(along) == pytest.approx(1)


def test_the_outline_s_contact_is_the_nearest_point_of_the_rim(scenes):
    for scene in scenes:
        vertex = Reading(place="outline").press(scene).vertex
        apart = np.linalg.norm(scene.mesh.pixels - scene.mesh.pixels[scene.vertex], axis=1)
        assert scene.mesh.rim[vertex]
        assert apart[vertex] == apart[scene.mesh.rim].min()
        assert Reading().press(scene).vertex == scene.vertex


def test_a_small_force_far_from_the_rim_does_not_feel_it(scenes):
    theta = np.array([[0.05, 0.5, -0.01]] * 3)
    fixed, free = (motions(Reading(boundary=each), scenes, theta) for each in ("fixed", "free"))
    np.testing.assert_allclose(free, fixed, rtol=1e-3, atol=1e-3 * np.abs(fixed).max())
    theta = np.tile(THETA, (3, 1))
    held, loose = (motions(Reading(boundary=each, place="outline"), scenes, theta) for each in ("fixed", "free"))
    assert np.abs(loose - held).max() > 0.05 * np.abs(held).max()


def test_errors_allow_no_farther_motion_than_the_triangle_inequality():
    """Of motions that reach it exactly: u, d and u_r on one line, |u − d|² and |d − u_r|² the paper's errors."""
    reference = 0.03
    u = farthest(reference)
    d = u - math.sqrt(ERROR)
    assert (u - d) ** 2 == pytest.approx(ERROR)
    assert (d - reference) ** 2 == pytest.approx(REFERENCE_ERROR)


def test_a_stronger_foundation_settles_sooner_and_one_of_a_given_time_is_found(scenes):
    theta = np.tile(THETA, (3, 1))
    found = foundation_for(0.6, scenes, theta)
    assert 0 < found < 1
    assert measure_settling(Reading(anchor=found + 1e-3), scenes, theta) <= 0.6
    assert measure_settling(Reading(anchor=found - 1e-3), scenes, theta) >= 0.6


def test_a_row_says_what_was_simulated(scenes):
    theta = np.tile(THETA, (3, 1))
    row = measure(Reading(anchor=1.0), scenes, theta)
    assert tuple(row) == COLUMNS
    distance = np.linalg.norm(motions(Reading(anchor=1.0), scenes, theta), axis=2)
    assert row["peak"] == pytest.approx(np.median(distance.max(axis=1)))
    assert row["median of highest peak"] == pytest.approx(np.median(distance, axis=0).max() / distance.max())
    assert row["|u| at the end"] == pytest.approx(math.sqrt(np.square(distance[:, -1]).mean()))
    assert row["after start [s]"] == pytest.approx(row["after release [s]"] + 0.25)


def test_every_reading_is_compared_once():
    assert len(readings()) == len(set(readings())) == 15


def test_the_door_prints_a_row_a_reading(scenes, monkeypatch, capsys):
    monkeypatch.setattr(module, "draw_contacts", lambda count, seed: (scenes[:count], np.tile(THETA, (count, 1))))
    monkeypatch.setattr(module, "readings", lambda: [Reading(), Reading(anchor=1.0)])
    assert main(["--contacts", "1"]) == 0
    out = capsys.readouterr().out
    assert out.count("\n| ") == 4
    assert "At rest 0.9 s after the start" in out


def test_contacts_spread_as_the_paper_s_estimates():
    scenes, theta = draw_contacts(2, 1)
    assert len(scenes) == len(theta) == 2
    assert (np.abs(theta - THETA) < 5 * module.SPREAD).all()
    np.testing.assert_array_equal(draw_contacts(2, 1)[1], theta)
