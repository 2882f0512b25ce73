"""The amortised estimator on a drawn clip with networks whose answer is known."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from pathlib import Path

import numpy as np
import pytest

from data.clip import ClipStream, stream
from data.frames import open_source
from estimators import amortized
from estimators.amortized import AmortizedEstimator, FrameResult
from estimators.model_settings import preparation_settings
from models.onnx_session import ModelFileError, ParameterModel
from physics.mechanics import Mechanics
from physics.msd_kernel import simulate
from tests.inference_inputs import SLOPE, THETA, metadata, write_clip, write_model

FRAMES, ONSET = 9, 4
MECHANICS = Mechanics(steps=40, load_steps=10)


@pytest.fixture(scope="module")
def clip_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("clips") / "clip", FRAMES, ONSET)


def run(
    clip_folder: Path, folder: Path, *, theta: tuple[float, float, float] = THETA, **changes: object
) -> tuple[ClipStream, list[FrameResult]]:
    """Results of the drawn clip with a network of this metadata."""
    window = changes.pop("window", 1)
    model = ParameterModel(write_model(folder / "model.onnx", metadata(window, **changes), theta=theta))
    settings = preparation_settings(model)
    clip = stream(open_source(clip_folder, settings.layout), settings)
    return clip, list(AmortizedEstimator(model).run(clip))


def test_every_frame_has_one_result_and_parameters_only_in_contact(clip_folder: Path, tmp_path: Path) -> None:
    _, results = run(clip_folder, tmp_path)
    assert [result.estimate.frame for result in results] == list(range(10, 10 + FRAMES))
    assert [result.estimate.status for result in results] == ["no_tool"] + ["no_contact"] * 3 + ["ok"] * 5
    for result in results:
        estimate = result.estimate
        known = [estimate.stiffness, estimate.damping, estimate.force, estimate.simulated_displacement]
        assert all((value is not None) == (estimate.status == "ok") for value in known)
        assert estimate.stiffness_sd is None
        assert estimate.damping_sd is None
        assert estimate.force_sd is None
        assert estimate.contact == (estimate.status == "ok")


def test_parameters_are_the_networks_and_force_is_a_magnitude(clip_folder: Path, tmp_path: Path) -> None:
    _, results = run(clip_folder, tmp_path)
    for result in results[ONSET:]:
        expected = np.add(THETA, np.multiply(SLOPE, result.prepared.depth.mean()))
        found = [result.estimate.stiffness, result.estimate.damping, result.estimate.force]
        np.testing.assert_allclose(found, np.abs(expected), rtol=1e-5)
        assert result.estimate.force > 0


def test_window_repeats_the_first_frame(clip_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    original = ParameterModel.__call__

    def spy(self: ParameterModel, windows: np.ndarray) -> np.ndarray:
        seen.append(windows[0])
        return original(self, windows)

    monkeypatch.setattr(ParameterModel, "__call__", spy)
    _, results = run(clip_folder, tmp_path, window=7)
    depth = [result.prepared.depth for result in results]
    np.testing.assert_array_equal(seen[0], np.stack([depth[0]] * 3 + depth[1:5]))
    np.testing.assert_array_equal(seen[-1], np.stack(depth[2:9]))


@pytest.mark.parametrize(("observation", "index"), [("final", 39), ("release", 9)])
def test_simulation_is_read_where_the_model_was_trained(
    clip_folder: Path, tmp_path: Path, observation: str, index: int
) -> None:
    _, results = run(clip_folder, tmp_path, observation=observation)
    for result in results[ONSET:]:
        theta = np.add(THETA, np.multiply(SLOPE, result.prepared.depth.mean()))
        contact = result.prepared.geometry
        path = simulate(theta, contact.mesh, contact.vertex, contact.normal, MECHANICS)
        assert result.estimate.simulated_displacement == pytest.approx(np.linalg.norm(path[index]), rel=1e-3)
    observed = [result.estimate.observed_displacement for result in results]
    assert observed[ONSET] == pytest.approx(np.linalg.norm(results[ONSET].prepared.displacement))
    assert observed[-1] is None


def test_trajectory_is_read_at_the_next_frames_time_since_onset(clip_folder: Path, tmp_path: Path) -> None:
    _, results = run(clip_folder, tmp_path, observation="trajectory", window=3)
    onset = results[ONSET].prepared
    for count, result in enumerate(results[ONSET:], start=1):
        # A frame at 25 fps is 8 steps of 5 ms; the load has not ended yet.
        theta = [result.estimate.stiffness, result.estimate.damping, -result.estimate.force]
        contact = onset.geometry
        path = simulate(np.array(theta), contact.mesh, contact.vertex, contact.normal, MECHANICS, load_steps=40)
        assert result.estimate.simulated_displacement == pytest.approx(np.linalg.norm(path[8 * count - 1]), rel=1e-3)
    moved = results[ONSET + 2].prepared.track_position - onset.track_position
    assert results[ONSET + 1].estimate.observed_displacement == pytest.approx(np.linalg.norm(moved))
    assert results[-1].estimate.observed_displacement is None


def test_trajectory_beyond_the_horizon_has_no_displacement(clip_folder: Path, tmp_path: Path) -> None:
    mechanics = dataclasses.asdict(Mechanics(steps=20, load_steps=10))
    _, results = run(clip_folder, tmp_path, observation="trajectory", mechanics=mechanics)
    given = [result.estimate.simulated_displacement is not None for result in results[ONSET:]]
    assert given == [True, True, False, False, False]
    assert ["beyond the model's horizon" in result.estimate.detail for result in results] == [False] * 6 + [True] * 3


def test_verdict_says_whether_the_onset_is_in_the_window(clip_folder: Path, tmp_path: Path) -> None:
    _, single = run(clip_folder, tmp_path)
    assert {result.estimate.verdict for result in single[ONSET:]} == {"undetermined"}
    _, results = run(clip_folder, tmp_path, window=3)
    verdicts = [result.estimate.verdict for result in results]
    assert verdicts == [""] * 4 + ["onset_in_view"] * 2 + ["undetermined"] * 3


@pytest.mark.parametrize(
    ("statuses", "expected"),
    [
        (["no_contact", "ok"], "onset_in_view"),
        (["no_tool", "ok", "ok"], "onset_in_view"),
        (["bad_depth", "ok"], "undetermined"),
        (["ok", "no_contact", "no_mask", "ok"], "undetermined"),
    ],
)
def test_onset_counts_only_where_its_absence_was_seen(statuses: list[str], expected: str) -> None:
    assert amortized._verdict(deque(statuses)) == expected


def test_contact_is_in_pixels_of_the_source_frame(clip_folder: Path, tmp_path: Path) -> None:
    _, results = run(clip_folder, tmp_path)
    # The tool is drawn over columns 70-89 and its tip is the contact's upper edge, row 42 at the onset.
    estimate = results[ONSET].estimate
    assert 66 <= estimate.contact_u <= 94
    assert 40 <= estimate.contact_v <= 48


def test_arrow_ends_at_the_contact_and_grows_with_force(clip_folder: Path, tmp_path: Path) -> None:
    clip, results = run(clip_folder, tmp_path)
    tail, tip = results[-1].arrow
    estimate = results[-1].estimate
    assert tip == pytest.approx((estimate.contact_u, estimate.contact_v), abs=1e-3)
    # The tail lies outside the tissue along the normal; its distance is 0.3 · z · |F|/max|F|.
    contact, camera = results[-1].prepared.geometry, clip.picture_camera
    point = contact.tissue_point + contact.normal * 0.3 * contact.tissue_point[2] * 0.4
    assert tail[0] == pytest.approx(camera.fx * point[0] / point[2] + camera.cx, abs=1e-2)
    _, weak = run(clip_folder, tmp_path, theta=(0.5, 0.09, -0.1))
    assert math.dist(*weak[-1].arrow) < math.dist(tail, tip)
    _, none = run(clip_folder, tmp_path, theta=(0.5, 0.09, 0.0))
    assert none[-1].arrow is None


def test_numbers_that_are_not_finite_are_an_error(clip_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="not finite for frame 14"):
        run(clip_folder, tmp_path, theta=(math.nan, 0.1, -0.1))


def test_time_by_stage_starts_anew_for_every_clip(clip_folder: Path, tmp_path: Path) -> None:
    model = ParameterModel(write_model(tmp_path / "model.onnx"))
    settings, estimator = preparation_settings(model), AmortizedEstimator(model)
    for _ in range(2):
        estimator.seconds["network"] += 100.0
        assert len(list(estimator.run(stream(open_source(clip_folder, settings.layout), settings)))) == FRAMES
        assert 0 < estimator.seconds["network"] < 50
