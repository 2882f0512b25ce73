"""One method on one pull: what is counted, and which methods fit."""

import dataclasses

import numpy as np
import pytest
from scipy.sparse import eye_array

from benchmarks.online import compare
from benchmarks.online.compare import BATCH, HORIZON, STARTS, fit_batch, run_case
from benchmarks.online.sequences import SEQUENCES, Pull
from palpate.estimators.online.objective import Chamfer, Objective, Tracks
from palpate.estimators.online.session import Method, Session
from palpate.physics.pbd.stiffness import Stiffness
from tests.physics.pbd.particles import sheet

FRAMES, EVERY = 14, 3
BODY = sheet(5, 4, pinned_rows=1)
GRIPPED = np.array([18, 19])
PLACES = BODY.rest[GRIPPED] + np.linspace(0.2, 1, 6)[:, None, None] * np.array([0.002, 0.006, 0.003])


@pytest.fixture(scope="module")
def pull() -> Pull:
    return SEQUENCES["thin-shell-1"].pull(64, 100, FRAMES)


def test_a_case_is_what_its_session_does(pull: Pull) -> None:
    case = run_case(pull, STARTS["k2"], "PBD", "both", EVERY)
    assert len(case["chamfer"]) == FRAMES
    np.testing.assert_array_equal(case["ahead"], [2])
    assert np.isnan(case["rank"])
    objective = Objective(pull.body, pull.gripped)
    fields = Stiffness(*(np.full(pull.body.count, value) for value in STARTS["k2"]))
    session = Session(objective, fields, Method("PBD"))
    for frame in range(3):
        session.step(pull.places[frame], [])
    states = session.ahead(pull.places[3 : 3 + HORIZON])
    gaps = [
        np.linalg.norm(objective.mapped(state, pull.matches(at, "both")).deformation)
        for at, state in enumerate(states, start=3)
    ]
    assert case["gap"][0] == pytest.approx(np.mean(gaps))
    near = [np.linalg.norm(pull.body.rest - point, axis=1).argmin() for point in pull.points[0, pull.keypoints]]
    errors = [
        np.linalg.norm((state - pull.body.rest)[near] - (pull.points[at + 1] - pull.points[0])[pull.keypoints], axis=1)
        for at, state in enumerate(states, start=3)
    ]
    assert case["keypoint"][0] == pytest.approx(np.mean(errors))
    apart = np.linalg.norm(session.positions[pull.visible][:, None] - pull.clouds[2], axis=2)
    squares = [np.square(apart.min(axis=axis)).mean() for axis in (0, 1)]
    assert case["chamfer"][2] == pytest.approx(np.sqrt(sum(squares)))


@pytest.mark.acceptance
@pytest.mark.parametrize("name", ["thin-shell-1", "volume-2"])
def test_stiff_and_soft_exchanged_are_found_exchanged(name: str) -> None:
    """A field that looks alike whatever the truth, as stiffer towards the gripper, ranks well with one of two."""
    own = SEQUENCES[name]
    pull = dataclasses.replace(own, stiff=lambda rest: ~own.stiff(rest)).pull(120, 50, own.frames)
    assert run_case(pull, STARTS["k2"], "PBD-RM-ON", "tracks", 40)["rank"] > 0.7


def test_only_methods_that_fit_change_the_field(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "EPOCHS", 2)
    pull = SEQUENCES["thin-shell-1"].pull(40, 60, FRAMES)
    for name in (BATCH, "PBD-RM", "PBD-RM-ON"):
        case = run_case(pull, STARTS["k3"], name, "tracks", EVERY)
        assert np.isnan(case["rank"]) == (name == "PBD-RM")  # of a uniform field there is none


def uniform(distance: float) -> Stiffness:
    return Stiffness(np.full(BODY.count, distance), np.full(BODY.count, 0.01))


@pytest.mark.parametrize("kind", ["tracks", "chamfer"])
def test_epochs_bring_fields_nearer_to_what_was_observed(kind: str) -> None:
    """DiffCloud's way."""
    objective = Objective(BODY, GRIPPED)
    seen = objective.stepped(uniform(2.0), BODY.rest, PLACES).positions[0, 1:]
    all_of = eye_array(BODY.count).tocsr()
    matches = [[Tracks(all_of, state) if kind == "tracks" else Chamfer(state, np.unique(BODY.faces))] for state in seen]
    fields, left = fit_batch(objective, uniform(0.5), PLACES, matches, 0.1)
    assert len(left) == 25
    assert left[-1] < 0.3 * left[0]
    free = ~BODY.pinned
    assert np.mean(fields.distance[free]) > 1.0
    edge = BODY.layout.rest[BODY.kinds[0]].mean()
    apart = objective.stepped(uniform(0.5), BODY.rest, PLACES).positions[0, 1:] - seen
    if kind == "tracks":
        assert left[0] == pytest.approx(np.square(apart).sum() / (6 * BODY.count * edge**2))
