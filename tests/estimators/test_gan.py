"""The parameter network's estimator on a drawn clip with networks whose answer is known."""

import math
from collections import deque
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from palpate.data.clip import ClipStream
from palpate.data.contact.geometry import FrameGeometry
from palpate.data.prepared import PreparedFrame
from palpate.data.source.frames import open_source
from palpate.estimators import gan
from palpate.estimators.contract import ClipInfo, Preparation
from palpate.estimators.gan import GanEstimator
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.estimators.result import values_of
from palpate.models.onnx_session import ModelFileError, ParameterModel
from palpate.physics.load import Press, held
from palpate.physics.mechanics import PARAMETERS, Mechanics
from palpate.physics.msd.simulation import simulate
from tests.estimators.sessions import follow
from tests.inference_inputs import SLOPE, THETA, metadata, write_clip, write_model

FRAMES, ONSET = 9, 4
MECHANICS = Mechanics(steps=40, load_steps=10)


@pytest.fixture(scope="module")
def clip_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("clips") / "clip", FRAMES, ONSET)


class Result(NamedTuple):
    """A prepared frame and what is said of it."""

    prepared: PreparedFrame
    estimate: FrameEstimate

    @property
    def expected(self) -> np.ndarray:
        """θ that the network is written to give here."""
        return np.add(THETA, np.multiply(SLOPE, self.prepared.depth.mean()))


def run(
    clip_folder: Path, folder: Path, *, theta: tuple[float, float, float] = THETA, **changes: object
) -> tuple[ClipStream, list[Result], InteractionEstimate]:
    """Results of the drawn clip with a network of this metadata."""
    window = changes.pop("window", 1)
    model = ParameterModel(write_model(folder / "model.onnx", metadata(window, **changes), theta=theta))
    estimator = GanEstimator(model)
    settings = estimator.preparation(Preparation())
    clip = ClipStream(open_source(clip_folder, settings.layout), settings)
    prepared = list(clip)
    frames, (run_of_contact,) = follow(estimator.start(ClipInfo.of(clip)), prepared)
    return clip, [Result(*pair) for pair in zip(prepared, frames, strict=True)], run_of_contact


@pytest.fixture(scope="module")
def usual(clip_folder: Path, tmp_path_factory) -> tuple[ClipStream, list[Result], InteractionEstimate]:
    """What a network of single frames says, its simulation read at the end."""
    return run(clip_folder, tmp_path_factory.mktemp("usual"))


def pressed(theta: np.ndarray, contact: FrameGeometry, load_steps: int) -> np.ndarray:
    """How far the contact moves in every step, pressed along its normal for so many."""
    press = Press.at(contact.vertex, contact.normal, held(load_steps, MECHANICS.steps))
    return np.linalg.norm(simulate(theta, contact.mesh, press, MECHANICS), axis=1)


def test_every_frame_has_one_result_and_the_networks_parameters_only_in_contact(usual) -> None:
    _, results, _ = usual
    assert [result.estimate.frame for result in results] == list(range(10, 10 + FRAMES))
    assert [result.estimate.status for result in results] == ["no_tool"] + ["no_contact"] * 3 + ["ok"] * 5
    for result in results:
        estimate = result.estimate
        known = [*map(values_of(estimate).get, PARAMETERS), estimate.touch.simulated_displacement]
        assert all((value is not None) == (estimate.status == "ok") for value in known)
        ends = "_sd", "_low", "_high", "_bound"
        assert not any(name.endswith(ends) for name in values_of(estimate))
        assert estimate.contact == (estimate.status == "ok")
        if estimate.contact:
            np.testing.assert_allclose(estimate.estimate.theta, result.expected, rtol=1e-5)
            np.testing.assert_allclose(known[:3], np.abs(result.expected), rtol=1e-5)  # a force is a magnitude
            assert estimate.verdict == "undetermined"
    # In pixels of the source frame the tool is drawn over columns 70-89, its tip in row 42 at the onset.
    assert 66 <= results[ONSET].estimate.touch.contact_u <= 94
    assert 40 <= results[ONSET].estimate.touch.contact_v <= 48


def test_window_repeats_the_first_frame(clip_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen, original = [], ParameterModel.__call__

    def spy(self: ParameterModel, windows: np.ndarray) -> np.ndarray:
        seen.append(windows[0])
        return original(self, windows)

    monkeypatch.setattr(ParameterModel, "__call__", spy)
    _, results, _ = run(clip_folder, tmp_path, window=7)
    depth = [result.prepared.depth for result in results]
    np.testing.assert_array_equal(seen[0], np.stack([depth[0]] * 3 + depth[1:5]))
    np.testing.assert_array_equal(seen[-1], np.stack(depth[2:9]))


def test_simulation_is_read_where_the_model_was_trained(usual) -> None:
    _, results, _ = usual
    for result in results[ONSET:]:
        path = pressed(result.expected, result.prepared.geometry, MECHANICS.load_steps)
        assert result.estimate.touch.simulated_displacement == pytest.approx(path[39], rel=1e-3)
    observed = [result.estimate.touch.observed_displacement for result in results]
    assert observed[ONSET] == pytest.approx(np.linalg.norm(results[ONSET].prepared.displacement))
    assert observed[-1] is None


@pytest.mark.parametrize(("seen", "visible"), [("oi", True), ("oii", True), ("?i", False), ("io?i", False)])
def test_onset_counts_only_where_its_absence_was_seen(seen: str, visible: bool) -> None:
    """Out of contact, in contact, or unknown, frame by frame."""
    verdict = gan._verdict(deque((each == "o", each == "i") for each in seen))
    assert verdict == ("onset_in_view" if visible else "undetermined")


def test_arrow_ends_at_the_contact_and_grows_with_force(usual, clip_folder: Path, tmp_path: Path) -> None:
    clip, results, _ = usual
    estimate = results[-1].estimate
    tail, tip = estimate.touch.arrow
    assert tip == pytest.approx((estimate.touch.contact_u, estimate.touch.contact_v), abs=1e-3)
    # The tail lies outside the tissue along the normal; its distance is 0.3 · z · |F|/max|F|.
    contact, camera = results[-1].prepared.geometry, clip.picture_camera
    point = contact.tissue_point + contact.normal * 0.3 * contact.tissue_point[2] * 0.4
    assert tail[0] == pytest.approx(camera.fx * point[0] / point[2] + camera.cx, abs=1e-2)
    _, weak, _ = run(clip_folder, tmp_path, theta=(0.5, 0.09, -0.1))
    assert math.dist(*weak[-1].estimate.touch.arrow) < math.dist(tail, tip)


def test_numbers_that_are_not_finite_are_an_error(clip_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="gives a number that is not finite"):
        run(clip_folder, tmp_path, theta=(math.nan, 0.1, -0.1))


def test_time_by_stage_starts_anew_for_every_clip(usual, tmp_path: Path) -> None:
    clip, results, _ = usual
    estimator = GanEstimator(ParameterModel(write_model(tmp_path / "model.onnx")))
    for _ in range(2):
        session = estimator.start(ClipInfo.of(clip))
        assert dict(session.seconds) == {}
        follow(session, [result.prepared for result in results])
        assert session.seconds.keys() == {"network", "simulation"}
        assert min(session.seconds.values()) > 0


@pytest.mark.parametrize("theta", [THETA, (0.5, 0.09, 0.0)])
def test_a_run_is_the_geometric_mean_of_its_frames(clip_folder, tmp_path, theta) -> None:
    """Mean of magnitudes, with F pressing; a parameter at 0 counts as 1e-12, and without a force there is no arrow."""
    _, results, run_of_contact = run(clip_folder, tmp_path, theta=theta)
    each = np.array([result.estimate.estimate.theta for result in results[ONSET:]])
    expected = np.exp(np.log(np.maximum(np.abs(each), 1e-12)).mean(axis=0)) * (1, 1, -1)
    np.testing.assert_allclose(run_of_contact.estimate.theta, expected, rtol=1e-6)
    assert (run_of_contact.onset, run_of_contact.onset_frame) == (ONSET, 10 + ONSET)
    assert run_of_contact.load_s is None  # the clip ends in contact
    assert (run_of_contact.estimate.verdict, run_of_contact.estimate.covariance) == ("undetermined", None)
    assert len(run_of_contact.interaction.observation) == FRAMES - ONSET - 1
    assert (results[-1].estimate.touch.arrow is None) == (theta[2] == 0)


def test_a_network_of_trajectories_with_head_parameters_is_refused(tmp_path: Path) -> None:
    model = ParameterModel(write_model(tmp_path / "model.onnx", metadata(1, observation="trajectory")))
    with pytest.raises(ModelFileError, match="observation trajectory and head parameters"):
        GanEstimator(model)
