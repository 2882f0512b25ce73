"""Materials against finite differences, Hooke's law, rotations and closed forms."""

import numpy as np
import pytest

from palpate.physics.fem.laws import LAWS, Material, respond
from tests.physics.fem.bodies import rotation

MU, LAM, STEP = 3.0, 7.0, 1e-6


def gradients(count: int = 6) -> np.ndarray:
    return np.eye(3) + 0.15 * np.random.default_rng(1).normal(size=(count, 3, 3))


@pytest.mark.parametrize("law", LAWS)
def test_stress_and_tangent_are_derivatives_of_the_energy(law: str) -> None:
    at, along = gradients(), np.random.default_rng(2).normal(size=(6, 3, 3))
    more, less = (respond(law, at + sign * STEP * along, MU, LAM) for sign in (1, -1))
    here = respond(law, at, MU, LAM, tangent=True)
    np.testing.assert_allclose((here.stress * along).sum((1, 2)), (more.energy - less.energy) / (2 * STEP), rtol=1e-7)
    found = np.einsum("nij,nj->ni", here.tangent, along.reshape(-1, 9)).reshape(-1, 3, 3)
    np.testing.assert_allclose(found, (more.stress - less.stress) / (2 * STEP), atol=1e-6)
    np.testing.assert_allclose(here.tangent, here.tangent.transpose(0, 2, 1), atol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_all_are_hookes_at_rest_and_linear_in_the_constants(law: str) -> None:
    rest = respond(law, np.eye(3), MU, LAM, tangent=True)
    hooke = respond("linear", np.eye(3), MU, LAM, tangent=True)
    assert abs(rest.energy) < 1e-14
    np.testing.assert_allclose(rest.stress, 0, atol=1e-13)
    np.testing.assert_allclose(rest.tangent, hooke.tangent, atol=1e-12)
    parts = [respond(law, gradients(), mu, lam).stress for mu, lam in ((MU, 0.0), (0.0, LAM))]
    np.testing.assert_allclose(respond(law, gradients(), MU, LAM).stress, sum(parts), atol=1e-12)


@pytest.mark.parametrize("law", ["corotational", "neo_hookean", "stable_neo_hookean"])
def test_energy_does_not_feel_a_rotation_and_stress_turns_with_it(law: str) -> None:
    turn, here = rotation(), respond(law, gradients(), MU, LAM)
    turned = respond(law, turn @ gradients(), MU, LAM)
    np.testing.assert_allclose(turned.energy, here.energy, rtol=1e-11)
    np.testing.assert_allclose(turned.stress, turn @ here.stress, atol=1e-12)
    np.testing.assert_allclose(respond(law, turn, MU, LAM).stress, 0, atol=1e-13)


def test_corotational_is_hooke_along_principal_stretches_and_passes_through_inversion() -> None:
    stretch = np.array([1.2, 0.9, 1.05])
    found = respond("corotational", np.diag(stretch), MU, LAM)
    np.testing.assert_allclose(np.diag(found.stress), 2 * MU * (stretch - 1) + LAM * (stretch - 1).sum(), rtol=1e-12)
    inverted = np.diag([1.0, 1.0, -0.5])
    energy = respond("corotational", inverted, MU, LAM).energy  # R = I is the closest rotation
    assert energy == pytest.approx(MU * 1.5**2 + LAM / 2 * 1.5**2, rel=1e-12)
    assert respond("neo_hookean", inverted, MU, LAM).energy == np.inf
    assert np.isfinite(respond("stable_neo_hookean", inverted, MU, LAM).energy)


def test_constants_are_lames_and_bad_ones_are_refused() -> None:
    material = Material("linear", 2.5, 0.25)
    assert material.lame == (pytest.approx(1.0), pytest.approx(1.0))
    more, less = (Material("linear", 2.5, 0.25 + sign * STEP).lame for sign in (1, -1))
    for found, one, two in zip(material.lame_by_poisson, more, less, strict=True):
        assert found == pytest.approx((one - two) / (2 * STEP), rel=1e-8)
    for arguments, said in (
        (("hookean", 1.0, 0.3), "hookean"),
        (("linear", 0.0, 0.3), "positive"),
        (("linear", 1.0, 0.5), r"0\.5"),
    ):
        with pytest.raises(ValueError, match=said):
            Material(*arguments)
