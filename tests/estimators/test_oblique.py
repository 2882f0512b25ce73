"""Presses aslant to the line of sight: their angle, the error that they may hide, and how much wider intervals get."""

import dataclasses
import math

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.estimators import oblique
from palpate.estimators.estimate import PressCourse, PressResult
from palpate.physics.load import Press
from palpate.physics.observation import Observation
from tests.physics.sheets import sheet

MESH = sheet(5, 5)
BOX = np.log([[0.05, 0.005, 0.01], [1.0, 0.5, 0.3]])
THETA = np.array([0.3, 0.03, -0.05])
ESTIMATE = PressResult(THETA, 0.01 * np.eye(3), information=100 * np.eye(3), noise=0.001, misfit=1.0)


def seen_at(angle: float) -> PressResult:
    return dataclasses.replace(ESTIMATE, course=PressCourse(view_angle=angle))


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("angle", [0.0, 1e-4, 4.0, 30.0, 90.0])
def test_the_angle_is_that_between_ray_and_direction_either_way(angle: float, sign: int) -> None:
    ray = np.array([0.3, -0.4, 1.2]) / 1.3
    across = np.cross(ray, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    turn = math.radians(angle)
    vertices = MESH.vertices.astype(np.float64)
    mesh = dataclasses.replace(MESH, vertices=vertices - vertices[12] + 0.5 * ray)
    direction = sign * (math.cos(turn) * ray + math.sin(turn) * across)
    seen = Observation.of_point(12, np.array([0.04]), np.zeros((1, 3)), 0.001)
    contact = Interaction(mesh, Press.at(12, direction, np.ones(8)), {"point": seen}, 0.005)
    assert oblique.view_angle(contact) == pytest.approx(angle, abs=1e-9)


@pytest.mark.parametrize(("deep", "angle", "hidden"), [(0.03, 5.0, False), (0.03, 8.0, True), (0.003, 30.0, False)])
def test_only_steep_walls_hide_the_bottom_of_a_dent(deep: float, angle: float, hidden: bool) -> None:
    """A wall a cell away hides it where its depth · tan(angle) exceeds that cell."""
    rest = np.stack([*np.mgrid[:5, :5], np.zeros((5, 5))], axis=-1).reshape(-1, 3) * 0.003
    moved = np.zeros((2, 25, 3))
    moved[1, 12, 2] = deep
    assert oblique.hides_bottom(rest, moved, np.array([0.0, 0.0, -1.0]), angle) == hidden
    moved[1, :, 2] = deep
    assert not oblique.hides_bottom(rest, moved, np.array([0.0, 0.0, -1.0]), angle)


def test_only_oblique_contacts_are_expected_to_hide_an_error() -> None:
    for facing in (ESTIMATE, seen_at(0.2), seen_at(oblique.LARGEST_ANGLE)):
        assert not oblique.is_oblique(facing)
        assert oblique.effective_misfit(facing) == 1.0
        assert oblique.remark(facing) == ""
    aslant = seen_at(12.4)
    assert oblique.is_oblique(aslant)
    assert oblique.effective_misfit(aslant) == pytest.approx(oblique.HIDDEN_ERROR / 0.001) == pytest.approx(15)
    # A misfit that was measured to be larger stays; so does one in units of a larger noise.
    assert oblique.effective_misfit(dataclasses.replace(aslant, misfit=17.0)) == 17.0
    assert oblique.effective_misfit(dataclasses.replace(aslant, noise=0.03)) == 1.0
    assert oblique.remark(aslant) == (
        "Tissue is pressed at 12° to the line of sight, so its dent may hide its bottom; intervals are inflated."
    )


def test_widening_adds_the_covariance_of_the_larger_noise_within_the_box() -> None:
    # I = 100: a noise ten times as large leaves 1, the box 12/w². Both covariance and verdict get 1/(1 + 12/w²) more.
    added = 1 / (1 + 12 / (BOX[1] - BOX[0]) ** 2)
    found = oblique.widened(ESTIMATE, 10.0, BOX)
    np.testing.assert_allclose(found.covariance, np.diag(0.01 + added))
    np.testing.assert_allclose(np.linalg.inv(found.expected_information), np.diag(0.01 + added))
    assert (ESTIMATE.verdict, found.verdict) == ("determined", "undetermined")
    unsure = oblique.widened(dataclasses.replace(ESTIMATE, expected_information=4 * np.eye(3)), 10.0, BOX)
    np.testing.assert_allclose(np.linalg.inv(unsure.expected_information), np.diag(0.25 + added))
    # However large the misfit, never wider than the prior besides; and where nothing was known, still finite.
    prior = np.diag((BOX[1] - BOX[0]) ** 2 / 12)
    np.testing.assert_allclose(oblique.widened(ESTIMATE, 1e9, BOX).covariance, ESTIMATE.covariance + prior)
    blind = oblique.widened(dataclasses.replace(ESTIMATE, expected_information=np.zeros((3, 3))), 10.0, BOX)
    assert np.isfinite(blind.expected_information).all()
    assert blind.verdict == "undetermined"
