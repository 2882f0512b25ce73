"""What a direct fit tells besides its parameters: the motion that is drawn, and doubts."""

import dataclasses

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct.estimator import doubts, simulated_motion
from palpate.estimators.estimate import PressCourse
from palpate.estimators.oblique import OBLIQUE
from palpate.physics.load import held
from palpate.physics.mechanics import RECOMMENDED
from palpate.physics.msd.simulation import simulate
from tests.estimators.estimates import CONTACT, ESTIMATE, LOAD_STEPS, MECHANICS

SHIFT = 8 * MECHANICS.time_step


def motion(contact: Interaction = CONTACT, *delays: float) -> tuple[np.ndarray, np.ndarray]:
    return simulated_motion(contact, dataclasses.replace(ESTIMATE, course=PressCourse(*delays)), MECHANICS)


def test_the_simulated_motion_is_the_simulators_along_the_force_from_rest_on() -> None:
    times, path = motion()
    assert (len(times), times[0], times[-1]) == (CONTACT.steps + 1, 0.0, pytest.approx(0.32))
    expected = simulate(ESTIMATE.theta, CONTACT.mesh, CONTACT.load, MECHANICS) @ CONTACT.direction
    np.testing.assert_allclose(path, np.concatenate([[0.0], expected[: CONTACT.steps]]), atol=1e-7)
    # While the force lasts the motion begins with F/m·t²/2, damping and springs being zero at first.
    assert path[1] == pytest.approx(-0.1 / 0.001 * 0.0025**2 / 2, rel=0.1)
    assert (path[1:65] < 0).all()


def test_a_press_that_began_earlier_has_moved_for_longer() -> None:
    (times, plain), (_, early), (_, late) = motion(), motion(CONTACT, -SHIFT, -SHIFT), motion(CONTACT, SHIFT, SHIFT)
    # The same motion, shifted; before a press begins the tissue is at rest.
    assert len(early) == len(plain) + 8
    since = np.linspace(0, times[-1], len(early))
    inside = since <= times[-1] - SHIFT
    expected = np.interp(since[inside] + SHIFT, times, plain)
    np.testing.assert_allclose(early[inside], expected, atol=1e-3 * np.abs(plain).max())
    np.testing.assert_array_equal(late[times < SHIFT], 0.0)
    np.testing.assert_allclose(late[8:], plain[:-8], atol=1e-4 * np.abs(plain).max())


def test_a_release_that_came_later_holds_the_force_for_longer() -> None:
    (_, plain), (_, longer) = motion(), motion(CONTACT, 0.0, SHIFT)
    np.testing.assert_allclose(longer[: LOAD_STEPS + 1], plain[: LOAD_STEPS + 1], rtol=1e-6, atol=1e-9)
    assert not np.allclose(longer[LOAD_STEPS + 2 :], plain[LOAD_STEPS + 2 :], atol=1e-5)
    # One whose release was not observed stays pressed, whatever its other delay.
    pressed = dataclasses.replace(CONTACT.load, factor=held(MECHANICS.steps, MECHANICS.steps))
    _, held_on = motion(dataclasses.replace(CONTACT, load=pressed), 0.0)
    np.testing.assert_allclose(held_on[: LOAD_STEPS + 1], plain[: LOAD_STEPS + 1], rtol=1e-6, atol=1e-9)
    assert (held_on[LOAD_STEPS + 2 :] < plain[LOAD_STEPS + 2 :]).all()


def doubted(**changes) -> str:
    """Doubt about an estimate with these changes."""
    return doubts(dataclasses.replace(ESTIMATE, **changes), RECOMMENDED)


def test_doubts_name_a_misfit_and_parameters_at_their_ranges_end() -> None:
    assert doubted() == doubted(misfit=1.5) == ""
    told = doubted(misfit=2.34, at_bound=np.array([False, False, True]))
    assert told.startswith("The model does not explain the data: they lie 2.3 times the noise from it")
    assert told.endswith("The best fit lies at the end of the force's admissible range, 0.01 to 0.3.")


def test_doubts_name_a_model_that_explains_more_and_delays_at_the_end_of_their_range() -> None:
    assert doubted(refuted="Another explains it better.") == "Another explains it better."
    refuted = dataclasses.replace(ESTIMATE, refuted="Another explains it better.")
    assert (refuted.explained, refuted.verdict, refuted.determined) == (False, "undetermined", ())
    assert ESTIMATE.explained
    assert "begin or end a whole frame" in doubted(course=PressCourse(0.04, at_end=True))
    assert "begun" not in doubted(course=PressCourse(0.01))


def test_doubts_name_a_press_aslant_to_the_line_of_sight_whose_uncertainties_were_widened() -> None:
    misfit = "The model does not explain the data: they lie 7 times the noise from it; don't trust the fit."
    angle = OBLIQUE.format(12.0)
    assert doubted(misfit=7.0, course=PressCourse(view_angle=3.0)) == misfit
    assert doubted(misfit=7.0, course=PressCourse(view_angle=12.0)) == f"{angle} {misfit}"
    assert doubted(misfit=1.0, course=PressCourse(view_angle=12.0)) == angle
