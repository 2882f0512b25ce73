"""Estimators of the benchmark on clips whose answers are known."""

import numpy as np
import pytest

from estimators.estimate import ContactEstimate, NoEstimate
from evaluation import recovery_estimators
from evaluation.recovery_estimators import Answer, EstimatorSpec, answer_of, open_estimator
from models.onnx_session import ModelFileError


class FakeClip:
    """Five frames, in contact from 1 to 3."""

    track_start = np.array([-1, 1, 1, 1, 1])
    contact = np.array([False, True, True, True, False])
    consecutive, usable = np.ones(5, bool), np.ones(5, bool)

    def __len__(self) -> int:
        return 5

    def depth(self, index: int) -> np.ndarray:
        return np.full((120, 214), index, np.float32)


class FakeModel:
    """θ that depends on the frame alone: e to its index."""

    window, input_size, path = 1, (120, 214), "paper.onnx"

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def __call__(self, windows: np.ndarray) -> np.ndarray:
        return np.exp(windows[:, 0, 0, :1]) * np.array([[1.0, 0.1, -2.0]])


def test_the_constant_answers_the_same_at_every_onset():
    spec = EstimatorSpec("constant", constant=((0.0, -1.0, -2.0), (1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0)))
    (onset, answer), *rest = open_estimator(spec)(FakeClip()).items()
    assert (onset, rest) == (1, [])
    np.testing.assert_allclose(answer.theta, [1.0, np.exp(-1), -np.exp(-2)])
    np.testing.assert_array_equal(answer.covariance, np.diag([1.0, 2.0, 3.0]))


@pytest.mark.parametrize(
    ("misfit", "angle", "warned"), [(1.4, 1.0, False), (1.6, 1.0, True), (1.4, 4.9, False), (1.4, 5.1, True)]
)
def test_an_estimate_warns_of_a_motion_it_does_not_explain_and_of_one_seen_aslant(misfit, angle, warned):
    estimate = ContactEstimate(
        theta=np.array([0.3, 0.05, -0.1]),
        covariance=np.eye(3),
        information=np.eye(3),
        noise=0.001,
        misfit=misfit,
        at_bound=np.zeros(3, bool),
        view_angle=angle,
    )
    assert answer_of(estimate, 1.5).warned is warned


def test_the_papers_network_is_averaged_in_logarithms_over_the_frames_in_contact(monkeypatch):
    monkeypatch.setattr(recovery_estimators, "ParameterModel", FakeModel)
    answer = open_estimator(EstimatorSpec("paper", model="averaged"))(FakeClip())[1]
    assert isinstance(answer, Answer)
    np.testing.assert_allclose(answer.theta, np.exp(2) * np.array([1.0, 0.1, -2.0]), rtol=1e-6)
    assert answer.covariance is None


def test_a_network_without_finite_answer_gives_none(monkeypatch):
    class Broken(FakeModel):
        def __call__(self, windows: np.ndarray) -> np.ndarray:
            return np.full((1, 3), np.nan)

    monkeypatch.setattr(recovery_estimators, "ParameterModel", Broken)
    assert isinstance(open_estimator(EstimatorSpec("paper", model="broken"))(FakeClip())[1], NoEstimate)


def test_a_network_for_another_size_is_refused(monkeypatch):
    class Small(FakeModel):
        input_size = (60, 107)

    monkeypatch.setattr(recovery_estimators, "ParameterModel", Small)
    with pytest.raises(ModelFileError, match="107x60 pixels and the benchmark's has 214x120"):
        open_estimator(EstimatorSpec("paper", model="small"))
