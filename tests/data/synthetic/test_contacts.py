"""Contacts without pictures: the cropped mesh moves like the whole, and draws keep to their ranges."""

import dataclasses

import numpy as np
import pytest

from palpate.data.synthetic.contacts import CROP_RADIUS, FINE_MECHANICS, draw_contacts
from palpate.data.synthetic.scene import Scene, crop_mesh, draw_scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.physics.load import Press, held
from palpate.physics.msd.simulation import simulate

SETTINGS = SceneSettings(width=214, height=120)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return draw_scene(SETTINGS, np.random.default_rng(3))


def test_a_cropped_mesh_moves_like_the_whole(scene: Scene) -> None:
    mesh, kept, _ = crop_mesh(scene.mesh, scene.vertex, CROP_RADIUS)
    vertex = int(np.flatnonzero(kept == scene.vertex)[0])
    assert len(mesh.vertices) < len(scene.mesh.vertices)
    np.testing.assert_array_equal(mesh.vertices[vertex], scene.mesh.vertices[scene.vertex])
    theta = np.array([1.0, 0.01, -0.05])  # the fastest waves of the ranges
    exact = dataclasses.replace(FINE_MECHANICS, window_error=0.0)
    whole, cropped = (
        simulate(theta, sheet, Press.at(pressed, scene.direction, held(160, FINE_MECHANICS.steps)), exact)
        for sheet, pressed in ((scene.mesh, scene.vertex), (mesh, vertex))
    )
    assert np.abs(cropped - whole).max() < 1e-3 * np.abs(whole).max()


def test_the_same_seed_gives_the_same_contacts() -> None:
    first, again = (draw_contacts(SETTINGS, 5, 2, 0.005) for _ in range(2))
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.theta, two.theta)
        np.testing.assert_array_equal(one.interaction.moved, two.interaction.moved)
    assert not np.array_equal(first[0].theta, draw_contacts(SETTINGS, 6, 1, 0.005)[0].theta)


def test_sequences_show_the_motion_beside_the_tool() -> None:
    """A pixel of the grid's size shows the vertex that lies there; one of larger pictures the mean of several."""
    plain = draw_contacts(SETTINGS, 11, 1, 0.005)[0]
    assert plain.interaction.sequence is None
    contacts = [contact.interaction for contact in draw_contacts(SETTINGS, 11, 8, 0.005, sequence=True)]
    assert {contact.sequence.size for contact in contacts} == {(214, 120), (854, 480)}
    for contact in contacts:
        sequence, moved = contact.sequence, contact.moved[:, 2]
        assert (sequence.change.shape, sequence.noise.total) == ((25, 15, 15), 0.0)
        np.testing.assert_array_equal(sequence.times, contact.observation.times)
        exact = sequence.size == (214, 120)
        np.testing.assert_allclose(sequence.change[:, 7, 7], moved, atol=1e-5 if exact else 0.3 * moved.max())
        # The tool is there until the frame whose time stamp says that it has let go.
        touches = sequence.times < contact.load_seconds - 1e-9
        hidden = ~np.isfinite(sequence.change)
        assert hidden[touches].any(axis=(1, 2)).all()
        assert not hidden[~touches].any()
        assert hidden.mean(axis=(1, 2)).max() < 0.3


def test_presses_begin_within_a_frame_of_their_stamps() -> None:
    """The first three frames' motion, in which no press ends, is that of a press that began so much later."""
    began, tried = [], np.linspace(-0.04, 0.04, 161)
    for contact in draw_contacts(SETTINGS, 11, 12, 0.005, within=0.04):
        seen = contact.interaction
        assert seen.load_seconds == pytest.approx(0.04 * round(seen.load_seconds / 0.04))  # as the stamps say
        pressed = simulate(contact.theta, seen.mesh, Press.at(seen.vertex, seen.direction, np.ones(64)), FINE_MECHANICS)
        along = np.concatenate([[0.0], pressed @ seen.direction])
        since = seen.observation.times[:3] - tried[:, None]
        left = np.interp(since, FINE_MECHANICS.time_step * np.arange(65), along) - seen.along[:3]
        misfits = np.abs(left).max(axis=1)
        assert misfits.min() < 0.01 * np.abs(along).max()
        began.append(tried[misfits.argmin()])
    # Evenly spread from -0.04 s to 0.04 s.
    assert min(began) < -0.015 < 0.015 < max(began)


def test_motions_follow_the_fitted_simulator() -> None:
    contact = draw_contacts(SETTINGS, 7, 1, 0.005)[0]
    seen = contact.interaction
    coarse = dataclasses.replace(FINE_MECHANICS, time_step=seen.time_step, steps=seen.load.steps)
    path = simulate(contact.theta, seen.mesh, seen.load, coarse)
    assert np.abs(path[seen.observation.steps(seen.time_step)] - seen.moved).max() < 5e-4


@pytest.mark.parametrize("reach", [2, 5])
def test_the_cut_edge_is_held(scene: Scene, reach: int) -> None:
    mesh, _, cut = crop_mesh(scene.mesh, scene.vertex, reach)
    edge = np.abs(mesh.pixels - scene.mesh.pixels[scene.vertex]).max(axis=1) == reach
    np.testing.assert_array_equal(cut, edge)
    assert edge.any()
    assert mesh.rim[edge].all()
