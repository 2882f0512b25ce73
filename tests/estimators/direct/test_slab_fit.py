"""What a fit says of a slab, of another damping, and of no slab."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from palpate.data.contact.interaction import Interaction
from palpate.estimators.direct import estimator, slab_fit, slab_motion
from palpate.estimators.direct.contact_fit import LARGEST_MISFIT
from palpate.estimators.direct.estimator import DirectEstimator
from palpate.estimators.direct.slab_fit import BLIND, LOWER, UNLIKE, Valley, descend, fit_slab, settled
from palpate.estimators.direct.slab_motion import SlabMotion
from palpate.estimators.estimate import NINETY, Estimate, NoEstimate
from palpate.estimators.model_errors import MODEL_ERRORS
from palpate.estimators.onset import BETWEEN
from palpate.physics.fem.slab import slab_beneath
from tests.estimators.direct import slabs
from tests.estimators.direct.slabs import COARSE, LOGS, THETA, THICKNESS, TIMES, contact_of, seen, showing
from tests.estimators.direct.test_field import SIDE
from tests.estimators.sessions import clip_info


def coarsely(monkeypatch: pytest.MonkeyPatch, contact: Interaction, cells: tuple[int, int, int]) -> Estimate:
    """A fit by a slab of few elements."""
    monkeypatch.setattr(slab_fit, "slab_beneath", lambda *told, **_: slab_beneath(*told[:4], cells))
    return fit_slab(contact, THICKNESS)[0]


@pytest.fixture(scope="module")
def recovered() -> tuple[Interaction, Estimate]:
    """A contact, and the fit to it."""
    contact = seen(LOGS, 1, COARSE)
    with pytest.MonkeyPatch.context() as patch:
        return contact, coarsely(patch, contact, COARSE)


@pytest.mark.slow
def test_a_fit_recovers_what_made_the_sequence(recovered: tuple[Interaction, Estimate]) -> None:
    found = recovered[1]
    assert found.explained
    assert not found.refuted
    np.testing.assert_array_equal(found.slab.times, TIMES)  # what moves it, for scenes
    assert 0.8 < found.misfit < 1.2
    # Besides what the depth-change sequence tells, law and tip are not the tissue's.
    assert np.linalg.eigvalsh(found.covariance - UNLIKE).min() > 0
    low, high = (found.numbers()[f"force_over_stiffness_{end}"] for end in ("low", "high"))
    assert math.log(high / low) / (2 * NINETY) == pytest.approx(0.12, abs=0.02)
    assert (np.abs(np.log(np.abs(found.theta)) - LOGS) < 2 * NINETY * found.log_sd).all()
    ratios = found.numbers()
    assert ratios["damping_over_stiffness"] == pytest.approx(THETA[1] / THETA[0], rel=0.1)
    assert ratios["force_over_stiffness"] == pytest.approx(-THETA[2] / THETA[0], rel=0.05)


@pytest.mark.slow
def test_a_slab_that_relaxes_is_no_slab_damped_by_mass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slab_fit, "REFUTED", 1.0)  # its misfit is large as well
    found = coarsely(monkeypatch, seen(slabs.RELAXING, 2, COARSE, relaxing=True), COARSE)
    assert found.misfit > LARGEST_MISFIT
    assert found.refuted.startswith("The motion relaxes: a standard linear solid")
    assert not found.explained
    assert (found.verdict, found.determined) == ("undetermined", ())


def test_a_fit_stays_where_a_better_one_cannot_be_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, followed = slabs.empty_problem(), SlabMotion._followed
    slabs.shows(problem, problem.motion.at(LOGS)[0])
    far = LOGS + np.array([3.0, 3.0, 3.0])
    valley = Valley(LOGS, np.eye(3), far, 2 * LOWER)

    def fails_far(self: SlabMotion, logs: np.ndarray, *told: Any) -> Any:
        if logs[0] > LOGS[0] + 2.5:
            raise slab_motion.NoEquilibrium("no equilibrium.")
        return followed(self, logs, *told)

    monkeypatch.setattr(SlabMotion, "_followed", fails_far)
    problem.look(far)
    with pytest.raises(NoEstimate, match="The slab can't be followed where the fit begins"):
        descend(problem, far, problem.motion.box, 1.0)
    monkeypatch.setattr(slab_fit, "follow_valley", lambda *_: valley)
    logs, told, _ = settled(problem)
    assert told is valley
    np.testing.assert_allclose(logs[1:] - logs[0], LOGS[1:] - LOGS[0], atol=0.1)
    assert problem.seen.all()  # it has looked at that fit, not at the other


def test_the_slabs_own_error_is_a_share_of_its_motion_in_rings_and_parts_of_the_time() -> None:
    problem = slabs.empty_problem()
    sunk = np.random.default_rng(1).normal(size=(10, SIDE * SIDE))
    columns = problem.model_errors(sunk)
    assert columns.shape == (SIDE * SIDE, 10, 12)  # three rings, early, held, released and later
    np.testing.assert_allclose(columns.sum(axis=2), MODEL_ERRORS.slab_motion * sunk.T)
    assert ((columns != 0).sum(axis=2) == 1).all()
    middle = columns[(SIDE * SIDE) // 2]
    np.testing.assert_array_equal(np.argmax(middle != 0, axis=1), [0, 0, 1, 1, 1, 2, 2, 3, 3, 3])
    # It costs what a scale of everything would tell, and little of what differs from pixel to pixel.
    problem.look(LOGS)
    moved = problem.patches.shown(problem.patches.sunk(problem.motion.at(LOGS)[0]), problem.covering)
    told = float(np.square(problem.whitened(moved)).sum())
    parts = len(np.unique(np.flatnonzero(np.abs(columns).sum(axis=(0, 1)))))
    assert told < parts / MODEL_ERRORS.slab_motion**2
    assert told > 0.5 / MODEL_ERRORS.slab_motion**2


@pytest.mark.slow
def test_tissue_under_the_tip_does_not_count(recovered, monkeypatch) -> None:
    contact, found = recovered
    rows, columns = np.mgrid[:SIDE, :SIDE] - SIDE // 2
    near = np.hypot(rows, columns) < BLIND
    spoiled = showing(contact, contact.sequence.change + np.where(near, np.float32(0.02), np.float32(0)))
    np.testing.assert_array_equal(coarsely(monkeypatch, spoiled, COARSE).theta, found.theta)


def test_the_estimator_fits_a_slab_where_a_thickness_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    contact, asked = showing(contact_of()), []
    told = Estimate(np.array(THETA), np.eye(3)), (TIMES, TIMES)
    monkeypatch.setattr(estimator, "fit_slab", lambda *given: asked.append(given) or told)
    session = DirectEstimator(BETWEEN, noise=0.002, thickness=THICKNESS).start(clip_info(25.0))
    assert session.fit(contact) is told
    assert asked == [(contact, THICKNESS, 0.04, 0.002)]
    for blind in (contact_of(), dataclasses.replace(contact, sequence=contact.sequence.chosen(np.arange(2)))):
        with pytest.raises(NoEstimate, match="A slab needs the depth around the contact"):
            session.fit(blind)
    for wrong in ({"thickness": 0.0}, {"thickness": math.inf}, {"thickness": 0.1, "observation": "contact"}):
        with pytest.raises(ValueError, match=r"give a positive length|leave --observation contact out"):
            DirectEstimator(BETWEEN, **wrong)


def test_a_slab_that_folds_is_refused_in_a_sentence() -> None:
    contact = seen(LOGS, 1, COARSE)
    sideways = dataclasses.replace(contact.load, direction=np.array([1.0, 0.0, 0.0]))
    with pytest.raises(NoEstimate, match="No slab fits under the tissue: below this surface a slab of"):
        fit_slab(dataclasses.replace(contact, load=sideways), THICKNESS)
