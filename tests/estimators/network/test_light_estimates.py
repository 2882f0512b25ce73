"""Presses without depth, which the network leaves to the fit of their shading."""

import dataclasses

import numpy as np
import pytest

from palpate.data.prepared import PreparedFrame
from palpate.data.shading.light import FINE
from palpate.data.shading.sequence import MARGIN, REACH, SIDE
from palpate.estimators import runs
from palpate.estimators.contract import Preparation
from palpate.estimators.estimate import LightFit
from palpate.estimators.network.estimator import NetworkEstimator, NetworkSettings
from palpate.models.onnx_session import SHIPPED, PosteriorModel
from tests.estimators.estimates import ESTIMATE
from tests.estimators.sessions import SIZE, clip_info, follow, prepared_frame, touched
from tests.lit_contacts import facing


@pytest.fixture(scope="module")
def network() -> NetworkEstimator:
    return NetworkEstimator(PosteriorModel(SHIPPED))


@pytest.fixture(scope="module")
def watched() -> list[PreparedFrame]:
    """Tissue at rest for six frames, and pressed for ten, in which it darkens."""
    mesh, vertex = facing()
    rest = np.random.default_rng(3).normal(-1, 0.1, (3, FINE * SIZE[1], FINE * SIZE[0])).astype(np.float32)
    first = FINE * (mesh.pixels[vertex] - REACH - MARGIN)
    window = ..., *(slice(max(begin, 0), begin + SIDE) for begin in first)
    frames = [prepared_frame(index, "no_contact", make_light=lambda: rest) for index in range(6)]
    found = touched(mesh, vertex, np.array([0.0, 0.0, -1.0]), 0.001)
    known = {"track_start": 6, "track_position": mesh.vertices[vertex], "consecutive": True}
    for index in range(6, 16):
        light = rest.copy()
        light[window] -= 0.03 * (index - 6)
        frames.append(prepared_frame(index, "ok", found, make_light=lambda light=light: light, **known))
    return frames


def test_frames_have_no_estimate_and_the_whole_press_is_fitted(network, watched, monkeypatch) -> None:
    fitted = dataclasses.replace(ESTIMATE, light=LightFit())
    monkeypatch.setattr(runs, "fit_shading", lambda contact, _: (contact, fitted, (np.zeros(1), np.zeros(1))))
    frames, (run,) = follow(network.start(clip_info()), watched)
    assert run.estimate is fitted
    assert [frame.estimate for frame in frames] == [None] * 16
    assert all(frame.contact and runs.WHOLE in frame.detail for frame in frames[6:])


def test_fast_prepares_every_third_frame(network) -> None:
    fast = NetworkEstimator(network.model, NetworkSettings(rate="fast"))
    assert [each.preparation(Preparation()).every for each in (network, fast)] == [1, 3]


@pytest.mark.parametrize("observation", ["brightness"])
def test_light_is_asked_of_the_direct_estimator(observation) -> None:
    with pytest.raises(ValueError, match="give one of depth"):
        NetworkSettings(observation=observation)
