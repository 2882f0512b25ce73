"""One motion under several observations."""

from functools import partial

import numpy as np
import pytest

from palpate.data.shading.sequence import SIDE, ShadingSequence
from palpate.estimators.direct.motion import PressMotion
from palpate.estimators.direct.problem import find_optimum
from palpate.observations.base import JointLikelihood, Observation, Parameter
from palpate.observations.depth import DepthObservation
from palpate.observations.shading import OTHERS, ShadingObservation
from palpate.physics.mechanics import RECOMMENDED
from palpate.physics.observation import Linearised
from tests.estimators.direct.test_field import MECHANICS, contact_of, logs_of


class Line:
    """Vertices that move along x as 1 + logs[0]·time·vertex."""

    def __init__(self, vertices: np.ndarray, times: np.ndarray) -> None:
        self.slopes = np.zeros((len(times), len(vertices), 3, 1))
        self.slopes[:, :, 0, 0] = times[:, None] * vertices

    def at(self, logs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 1 + self.slopes @ logs, self.slopes


class Scaled(Observation):
    """The way of one vertex times a factor that is unknown."""

    nuisance = (Parameter(2.0, 0.5, 3.0, 0.0),)

    def __init__(self, vertex: int, times: list[float]) -> None:
        self.vertices, self.times = np.array([vertex]), np.array(times)

    def linearise(self, moved: np.ndarray, slopes: np.ndarray, logs: np.ndarray) -> Linearised:
        way = moved[:, 0, 0]
        return Linearised(logs[-1] * way, np.column_stack([logs[-1] * slopes[:, 0, 0], way]))


def test_residuals_are_stacked_and_each_has_its_own_parameters() -> None:
    joint = JointLikelihood([Scaled(3, [0.2, 0.4]), Scaled(5, [0.1, 0.4, 0.6])], Line)
    logs = np.array([10.0, 2.0, 3.0])
    ways = np.array([1 + 10 * 0.2 * 3, 1 + 10 * 0.4 * 3, 1 + 10 * 0.1 * 5, 1 + 10 * 0.4 * 5, 1 + 10 * 0.6 * 5])
    residual, jacobian = joint.linearise(logs)
    np.testing.assert_allclose(residual, ways * [2, 2, 3, 3, 3])
    np.testing.assert_allclose(jacobian[:, 1], np.append(ways[:2], [0, 0, 0]))
    np.testing.assert_allclose(jacobian[:, 2], np.append([0, 0], ways[2:]))
    np.testing.assert_allclose(jacobian[:, 0], [2 * 0.6, 2 * 1.2, 3 * 0.5, 3 * 2.0, 3 * 3.0])
    assert joint.press(logs).tolist() == [10.0]
    assert joint.started(np.array([7.0])).tolist() == [7.0, 2.0, 2.0]
    assert joint.misfit(logs) == pytest.approx(3 * np.sqrt(np.square(ways[2:]).mean()))


def test_depth_and_shading_of_one_press_constrain_it_more_than_depth_alone() -> None:
    contact, logs = contact_of(), logs_of()
    generator = np.random.default_rng(0)
    rest, noise = generator.normal(-1, 0.2, (3, SIDE, SIDE)), np.full(3, 0.01)
    dark = contact.having(shading=ShadingSequence(contact.sequence.times, np.tile(rest, (8, 1, 1, 1)), rest, noise))
    shading = ShadingObservation(dark)
    motion = PressMotion(dark, MECHANICS, shading.vertices, shading.times)
    start = np.append(logs, [each.mean for each in shading.nuisance])
    light = np.tile(rest, (8, 1, 1, 1))
    light[..., shading.sheet.inner] = shading.predicted(start, motion.at(logs)[0])[0].reshape(8, 3, -1)
    light += generator.normal(0, 0.01, light.shape)
    assert np.nanmin(light - rest) < -0.1
    both = contact.having(shading=ShadingSequence(shading.times, light.astype(np.float32), rest, noise))
    alone, joint = (
        JointLikelihood(observations, partial(PressMotion, both, MECHANICS))
        for observations in ([DepthObservation(both)], [DepthObservation(both), ShadingObservation(both)])
    )
    alone.look(logs)
    joint.look(start)
    information = joint.information(start)
    more = np.linalg.inv(np.linalg.inv(information)[:3, :3]) - alone.information(logs)
    assert np.linalg.eigvalsh(more).min() > 0
    box = joint.box(RECOMMENDED.log_box)
    assert box.shape == (2, 3 + OTHERS)
    found = find_optimum(joint, start + np.append([0.1, -0.1, 0.1], np.zeros(OTHERS)), box, 12)
    assert np.abs(found.logs[:3] - logs).max() < 0.05
