"""Contacts without pictures: the cropped mesh moves like the whole, and draws keep to their ranges."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from data.simulated_contacts import FINE, REACH, crop_mesh, draw_contacts
from data.synthetic_scene import draw_scene
from data.synthetic_settings import SceneSettings
from physics.msd_kernel import simulate

SETTINGS = SceneSettings(width=214, height=120)


def test_a_cropped_mesh_moves_like_the_whole() -> None:
    scene = draw_scene(SETTINGS, np.random.default_rng(3))
    mesh, vertex = crop_mesh(scene.mesh, scene.vertex, REACH)
    assert len(mesh.vertices) < len(scene.mesh.vertices)
    np.testing.assert_array_equal(mesh.vertices[vertex], scene.mesh.vertices[scene.vertex])
    theta = np.array([1.0, 0.01, -0.05])  # the fastest waves of the ranges
    exact = dataclasses.replace(FINE, window_error=0.0)
    whole = simulate(theta, scene.mesh, scene.vertex, scene.direction, exact, load_steps=160)
    cropped = simulate(theta, mesh, vertex, scene.direction, exact, load_steps=160)
    assert np.abs(cropped - whole).max() < 1e-3 * np.abs(whole).max()


def test_draws_keep_to_their_ranges() -> None:
    contacts = draw_contacts(SETTINGS, 11, 4, 0.005)
    assert len({tuple(contact.theta) for contact in contacts}) == len(contacts) == 4
    for contact in contacts:
        stiffness, damping, force = contact.theta
        assert 0.2 <= stiffness <= 1.0
        assert 0.01 <= damping <= 0.3
        assert -0.3 <= force <= -0.03
        moved = np.linalg.norm(contact.case.displacement, axis=1).max()
        assert moved <= SETTINGS.peak_displacement[1] * 1.01
        assert 0.25 / 0.005 - 4 <= contact.case.load_steps <= 0.5 / 0.005 + 4
        np.testing.assert_allclose((contact.case.steps + 1) * 0.005, np.arange(1, 26) / 25)


def test_a_press_may_outlast_the_second_that_is_told() -> None:
    long = dataclasses.replace(SETTINGS, press_seconds=(1.2, 1.3))
    for contact in draw_contacts(long, 11, 2, 0.005):
        case = contact.case
        assert 240 <= case.load_steps <= 260
        loaded = simulate(contact.theta, case.mesh, case.vertex, case.direction, FINE, load_steps=FINE.steps)
        np.testing.assert_allclose(case.displacement, loaded[15::16], atol=1e-7)


def test_the_same_seed_gives_the_same_contacts() -> None:
    first, again = (draw_contacts(SETTINGS, 5, 2, 0.005) for _ in range(2))
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.theta, two.theta)
        np.testing.assert_array_equal(one.case.displacement, two.case.displacement)
    assert not np.array_equal(first[0].theta, draw_contacts(SETTINGS, 6, 1, 0.005)[0].theta)


def test_motions_follow_the_fitted_simulator() -> None:
    contact = draw_contacts(SETTINGS, 7, 1, 0.005)[0]
    case = contact.case
    coarse = dataclasses.replace(FINE, time_step=0.005, steps=200)
    path = simulate(contact.theta, case.mesh, case.vertex, case.direction, coarse, load_steps=case.load_steps)
    assert np.abs(path[case.steps] - case.displacement).max() < 5e-4


@pytest.mark.parametrize("reach", [2, 5])
def test_the_cut_edge_is_held(reach: int) -> None:
    scene = draw_scene(SETTINGS, np.random.default_rng(3))
    mesh, vertex = crop_mesh(scene.mesh, scene.vertex, reach)
    edge = np.abs(mesh.pixels - mesh.pixels[vertex]).max(axis=1) == reach
    assert edge.any()
    assert mesh.rim[edge].all()
