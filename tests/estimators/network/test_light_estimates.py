"""Estimates by light of the network that ships: what its file says of a brightness sequence, and when nothing."""

import numpy as np
import pytest

from palpate.data.brightness.light import FINE
from palpate.data.brightness.sequence import MARGIN, REACH
from palpate.data.contact.interaction import BRIGHTNESS
from palpate.data.contact.light_features import light_amounts, light_shapes, light_slots
from palpate.data.prepared import PreparedFrame
from palpate.estimators import runs
from palpate.estimators.contract import Chosen
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.network.estimator import BY_NETWORK, LEFT, TOO_DARK, NetworkEstimator
from palpate.estimators.onset import BETWEEN
from palpate.models.onnx_session import SHIPPED, ModelFileError, PosteriorModel
from palpate.physics.identifiability import box_information
from tests.estimators.sessions import SIZE, clip_info, follow, prepared_frame, touched
from tests.lit_contacts import facing, lit_contact

TIMES = np.arange(1, 21) / 25


@pytest.fixture(scope="module")
def network() -> NetworkEstimator:
    return NetworkEstimator(PosteriorModel(SHIPPED), BETWEEN, observation=BRIGHTNESS)


def dent(depth: float) -> np.ndarray:
    """Tissue that darkens in two rings while it is pressed, and recovers [N, L, L]."""
    shapes, inner = light_shapes()
    course = np.where(TIMES < 0.3, 1 - np.exp(-TIMES / 0.1), np.exp(-(TIMES - 0.3) / 0.1))
    found = np.full((len(TIMES), *inner.shape), np.nan)
    found[:, inner] = -depth * course[:, None] * (shapes[:, 1] + shapes[:, 2])
    return found


def test_the_estimate_is_the_files_own(network: NetworkEstimator) -> None:
    contact = lit_contact(TIMES, dent(0.3))
    found = network.lit(contact)
    slots, known = light_slots(contact)
    mean, covariance = network.model.by_light(slots.vectors(known))
    np.testing.assert_allclose(np.log(np.abs(found.theta)), mean[0])
    np.testing.assert_array_equal(found.covariance, covariance[0])
    assert found.theta[2] < 0
    assert found.by_light
    assert found.explained
    # The verdict goes by what the light says, without the prior.
    own = np.linalg.inv(covariance[0]) - box_information(network.bounds.log_box)
    assert np.linalg.eigvalsh(found.verdict_information - own).min() > -1e-6


def test_a_deeper_dent_takes_a_larger_force_for_its_stiffness(network: NetworkEstimator) -> None:
    shallow, deep = (network.lit(lit_contact(TIMES, dent(depth))).theta for depth in (0.1, 0.5))
    assert abs(deep[2] / deep[0]) > 1.3 * abs(shallow[2] / shallow[0])


def test_what_rings_do_not_explain_is_no_press(network: NetworkEstimator) -> None:
    noise = np.random.default_rng(0).normal(0, 0.3, dent(0).shape)
    change = dent(0.05) + noise
    left = np.sqrt(np.square(light_amounts(change).left).mean())
    assert left > 0.25
    found = network.lit(lit_contact(TIMES, change))
    assert found.verdict == "undetermined"
    assert found.refuted.startswith(LEFT.partition(":")[0])


def test_one_frame_is_too_few_and_another_file_knows_nothing_of_light(network: NetworkEstimator, posterior) -> None:
    with pytest.raises(NoEstimate, match=TOO_DARK):
        network.lit(lit_contact(TIMES[:1], dent(0.3)[:1]))
    with pytest.raises(ModelFileError, match="knows nothing of light"):
        NetworkEstimator(posterior, BETWEEN, observation=BRIGHTNESS)
    with pytest.raises(ModelFileError, match="leave --rate fast out"):
        NetworkEstimator(posterior, BETWEEN, rate="fast")


@pytest.fixture(scope="module")
def watched() -> list[PreparedFrame]:
    """Tissue at rest for six frames, and pressed for ten."""
    mesh, vertex = facing()
    normal = np.array([0.0, 0.0, -1.0])
    rest = np.random.default_rng(3).normal(-1, 0.1, (FINE * SIZE[1], FINE * SIZE[0])).astype(np.float32)
    first = FINE * (mesh.pixels[vertex] - REACH - MARGIN)
    frames = [prepared_frame(index, "no_contact", light=rest) for index in range(6)]
    shown = np.nan_to_num(dent(0.3))
    rows, columns = (slice(max(begin, 0), begin + shown.shape[1]) for begin in first)
    found = touched(mesh, vertex, normal, 0.001)
    known = {"track_start": 6, "track_position": mesh.vertices[vertex], "consecutive": True}
    for index, change in enumerate([0 * shown[0], *shown[:9]], start=6):
        light = rest.copy()
        light[rows, columns] += change[max(-first[0], 0) :, max(-first[1], 0) :]
        frames.append(prepared_frame(index, "ok", found, light=light, **known))
    return frames


def test_frames_are_estimated_by_light_as_they_come_and_runs_are_if_that_is_asked_for(network, watched) -> None:
    frames, (run,) = follow(network.start(clip_info()), watched)
    known = [frame for frame in frames if frame.estimate is not None]
    assert [frame.frame for frame in known] == list(range(8, 16))
    assert all(frame.estimate.by_light and BY_NETWORK not in frame.detail for frame in known)
    np.testing.assert_allclose(run.estimate.theta, network.lit(run.interaction).theta)
    # What comes later changes nothing of a frame.
    fewer, _ = follow(network.start(clip_info()), watched[:12])
    np.testing.assert_array_equal(fewer[-1].estimate.theta, frames[11].estimate.theta)


def test_fast_leaves_fits_of_whole_runs_out(network, watched) -> None:
    fast = NetworkEstimator(network.model, BETWEEN, rate="fast")
    assert [each.preparation(Chosen()).every for each in (network, fast)] == [1, 3]
    frames, (run,) = follow(fast.start(clip_info()), watched)
    np.testing.assert_allclose(run.estimate.theta, network.lit(run.interaction).theta)
    assert not any(BY_NETWORK in frame.detail for frame in frames)


def test_by_default_whole_runs_are_fitted(network, watched, monkeypatch) -> None:
    fitted = network.lit(lit_contact(TIMES, dent(0.2)))
    monkeypatch.setattr(runs, "fit_brightness", lambda contact, _: (contact, fitted, (np.zeros(1), np.zeros(1))))
    usual = NetworkEstimator(network.model, BETWEEN)
    frames, (run,) = follow(usual.start(clip_info()), watched)
    assert run.estimate is fitted
    assert [frame.frame for frame in frames if BY_NETWORK in frame.detail] == list(range(8, 16))
