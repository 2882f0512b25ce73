"""What the motion determines of the fields: nothing unless the instrument explains it, and then what is true."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import spearmanr

from palpate.estimators.online.determined import uniform
from palpate.estimators.online.driven import DrivenTissue
from palpate.estimators.online.session import Method
from palpate.estimators.online.settings import Start
from palpate.estimators.online.surface import Surface, make_surface
from palpate.estimators.result import LEAST_SKILL
from palpate.physics.load import Grip
from palpate.physics.pbd.simulation import simulate
from palpate.physics.pbd.stiffness import Stiffness
from tests.estimators.online.test_driven import AWAY, CAMERA, GEOMETRY, HEIGHT, POINTS, SETTINGS, driven, first_frame

STEPPING = dataclasses.replace(SETTINGS.stepping, time_step=4.0, foundation=0.02)
WAY = np.array([-32.0, 0.0])
"""Motion of the grip [px]."""
FOLLOWING = 0.1
"""Standard deviation of followed points by axis [px]."""


@pytest.fixture(scope="module")
def sheet() -> Surface:
    return make_surface(first_frame(), CAMERA, GEOMETRY, 250)


def stiffness(sheet: Surface) -> np.ndarray:
    """True stiffness against stretch, shape [N]: the upper half is four times as stiff."""
    return np.where(sheet.pixels[:, 1] < HEIGHT / 2, 4.0, 1.0)


def followed(sheet: Surface, frames: int = 40) -> np.ndarray:
    """Tracks of a pull of that sheet, shape [frames, P, 2] [px]."""
    body, gripped = sheet.body, sheet.gripped
    rest, usual = body.rest[gripped], uniform(body, 1.0, 0.01)
    shares = np.linspace(0, 1, frames + 1)[1:, None]
    way = np.stack([sheet.lift(sheet.pixels[gripped] + share * WAY, rest[:, 2]) - rest for share in shares])
    fields = Stiffness(stiffness(sheet), usual.shape, usual.volume)
    states = simulate(body, fields, Grip(gripped, way), STEPPING).positions[0, 1:]
    inside, places = sheet.places(POINTS)
    moved = np.full((frames, len(POINTS), 2), np.nan)
    moved[:, inside] = [sheet.project(places @ state) - sheet.project(places @ body.rest) for state in states]
    return moved + np.random.default_rng(0).normal(scale=FOLLOWING, size=moved.shape)


def taken(sheet: Surface, moved: np.ndarray, **settings) -> DrivenTissue:
    """The tissue once these frames are taken in."""
    tissue = driven(sheet, stepping=STEPPING, start=Start(distance=2.0), **settings)
    for frame in moved:
        tissue.step(frame)
    return tissue


def test_what_is_known_is_true_and_both_optimisers_agree_on_it(sheet: Surface) -> None:
    """One posterior tells both, whatever steps the frames along: these do differ."""
    moved, true = followed(sheet), stiffness(sheet)
    found, known, states = [], [], []
    for optimizer in ("adam", "gauss-newton"):
        tissue = taken(sheet, moved, method=Method(optimizer=optimizer))
        sd, (distance, shape) = tissue.determined()
        assert tissue.alone.skill > 0.9
        assert not shape.any()  # nothing tells how the sheet bends
        assert distance.mean() > 0.1
        assert not (distance & ~tissue.stretched).any()
        log = np.log(tissue.session.fields.distance)
        assert spearmanr(log[distance], true[distance])[0] > 0.7
        among = tissue.stretched
        off = log - log[among].mean() - np.log(true) + np.log(true)[among].mean()
        assert np.sqrt(np.mean(np.square(off / sd[0])[distance])) < 1.3
        found.append(log)
        known.append(distance)
        states.append(tissue.session.positions)
    np.testing.assert_array_equal(*found)
    assert (known[0] & known[1]).mean() > 0.1
    assert (known[0] != known[1]).mean() < 0.05  # tissue stretches a little otherwise
    assert np.abs(states[0] - states[1]).max() > 1e-6


def test_nothing_is_known_where_the_instrument_does_not_explain_the_motion(sheet: Surface) -> None:
    """Equal motion with a path that is invented: tissue stretches in the simulation, by nothing that was
    observed."""
    moved, rest = followed(sheet, 8), sheet.body.rest[sheet.gripped, 2]
    tissue = driven(sheet, stepping=STEPPING, led=True)
    for index, frame in enumerate(moved):
        tissue.step(frame, led=sheet.lift(sheet.pixels[sheet.gripped] - (index + 1) / 8 * WAY, rest))
    assert tissue.stretched.any()
    assert tissue.alone.skill < LEAST_SKILL
    assert not tissue.determined()[1].any()


def test_what_a_sheet_does_not_do_tells_no_field(sheet: Surface) -> None:
    """Motion that dies away as a drawn curve: the instrument explains most of it, and tissue has stretched."""
    moved = np.linspace(0.1, 1, 10)[:, None, None] * WAY * np.exp(-np.square(AWAY / 45) / 2)[:, None]
    tissue = taken(sheet, moved)
    assert tissue.stretched.mean() > 0.3
    assert tissue.alone.skill > 0.5
    assert not tissue.determined()[1].any()


def test_the_prediction_is_the_simulation_that_is_never_taken_to_what_is_seen(sheet: Surface) -> None:
    moved = followed(sheet, 4)
    tissue = taken(sheet, moved, method=Method("PBD"))
    shown = tissue.shown(tissue.session.positions[None])[0]
    np.testing.assert_allclose(tissue.alone.predicted, shown, atol=1e-9)
    seen = moved[:, tissue.around]
    course = np.array(tissue.alone.course)
    assert len(course) == 5
    np.testing.assert_allclose(course[1:, 0], np.sqrt(np.square(seen).sum(axis=2).mean(axis=1)), rtol=1e-9)
    np.testing.assert_allclose(course[-1, 2], np.sqrt(np.square(seen[-1] - shown).sum(axis=1).mean()), rtol=1e-9)
    left = np.square(course[1:, 2]).sum() / np.square(course[1:, 0]).sum()
    assert tissue.alone.skill == pytest.approx(1 - np.sqrt(left))
    unseen = tissue.step(np.full_like(POINTS, np.nan))
    assert unseen.gap is None
    assert np.isnan(tissue.alone.course[-1]).all()
    assert tissue.alone.skill == pytest.approx(1 - np.sqrt(left))
