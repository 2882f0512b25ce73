"""The exported contact posterior on prepared clips: what every frame gets, and that streams and whole clips agree."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
import pytest
import torch

from data.clip import ClipStream
from data.contact_features import FEATURES, contact_features
from data.contact_motion import FRAYED, LOST
from data.prepared import PreparedFrame
from data.samples import ContactCase, SampleSettings, contact_cases
from data.synthetic import make_clip
from data.synthetic_settings import SceneSettings
from data.synthetic_source import open_synthetic, prepare_synthetic
from estimators.contact_fits import BOUNDS, MECHANICS
from estimators.contact_network import LARGEST_MISFIT, NO_NOISE, TOO_EARLY, UNEXPLAINED, ContactNetwork
from estimators.estimate import NINETY, NoEstimate
from estimators.oblique import HIDDEN_ERROR, LARGEST_ANGLE, OBLIQUE
from evaluation.calibration import metadata
from evaluation.recovery import PREPARE
from models.posterior import ContactPosterior
from models.posterior_export import export_posterior
from models.posterior_session import PosteriorModel
from physics.msd_kernel import simulate


@pytest.fixture(scope="module")
def network(tmp_path_factory) -> ContactNetwork:
    """An untrained posterior, exported."""
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("model")
    weights = folder / "posterior.pt"
    posterior = ContactPosterior(FEATURES, torch.tensor(BOUNDS.log_box), width=16, blocks=1)
    torch.save(posterior.state_dict(), weights)
    export_posterior(posterior, folder / "contact.onnx", metadata(weights))
    return ContactNetwork(PosteriorModel(folder / "contact.onnx"))


@pytest.fixture(scope="module")
def clip():
    """A small synthetic clip in memory."""
    return make_clip(SceneSettings(width=214, height=120, depth_noise=0.001, frames=28, press_seconds=(0.3, 0.3)), 4)


def test_every_frame_has_its_row(network: ContactNetwork, clip) -> None:
    stream: ClipStream = open_synthetic(clip, PREPARE)
    results = [result.estimate for result in network.run(stream)]
    assert [item.frame for item in results] == list(range(28))
    onset, release = clip.motion.onset_frame, clip.motion.release_frame
    for item in results:
        if item.status != "ok":
            assert (item.stiffness, item.verdict, item.stiffness_sd) == (None, "", None)
            continue
        if item.frame < onset + 2:  # too little motion was seen
            assert (item.stiffness, item.verdict) == (None, "undetermined")
            assert item.detail == TOO_EARLY
            continue
        assert onset <= item.frame < release
        assert item.verdict in ("determined", "ratios", "undetermined")
        low, high = item.stiffness_low, item.stiffness_high
        assert low < item.stiffness < high
        log_sd = math.log(high / low) / (2 * NINETY)
        expected = item.stiffness * math.exp(log_sd**2 / 2) * math.sqrt(math.expm1(log_sd**2))
        assert item.stiffness_sd == pytest.approx(expected)
    assert results[onset + 2].force_bound > results[release - 1].force_bound


def test_a_stream_ends_where_the_whole_clip_would(network: ContactNetwork, clip) -> None:
    """The last frame in contact is told exactly what a clip cut off there is told."""
    last = clip.motion.release_frame - 1
    stream = open_synthetic(clip, PREPARE)
    streamed = [result.estimate for result in network.run(stream)][last]
    prepared = prepare_synthetic(clip, PREPARE)
    samples = SampleSettings(observation="trajectory", mechanics=MECHANICS)
    onset, case = next(iter(contact_cases(prepared, samples).items()))
    seen = case.steps <= round((prepared.times[last] - prepared.times[onset]) / MECHANICS.time_step) - 1
    cut = dataclasses.replace(case, steps=case.steps[seen], displacement=case.displacement[seen])
    cut = dataclasses.replace(cut, load_steps=int(cut.steps[-1]) + 1)
    found = network.estimate(cut, None, None)
    assert streamed.stiffness == pytest.approx(found.theta[0], rel=1e-5)
    assert streamed.force == pytest.approx(-found.theta[2], rel=1e-5)


def test_without_a_noise_level_there_is_no_estimate(network: ContactNetwork, clip) -> None:
    rough = dataclasses.replace(PREPARE, geometry=dataclasses.replace(PREPARE.geometry, smoothing=0.0))
    found = network.estimate_clip(prepare_synthetic(clip, rough))
    assert found
    assert all(isinstance(item, NoEstimate) and str(item) == NO_NOISE for item in found.values())
    results = [result.estimate for result in network.run(open_synthetic(clip, rough))]
    touched = [item for item in results if item.status == "ok"]
    assert touched
    assert all(item.verdict == "undetermined" and item.stiffness is None for item in touched)
    assert {item.detail for item in touched} == {NO_NOISE}


@pytest.mark.parametrize("noise", [math.nan, math.inf, 0.0])
def test_a_noise_level_is_a_positive_number(network: ContactNetwork, clip, noise: float) -> None:
    samples = SampleSettings(observation="trajectory", mechanics=MECHANICS)
    (case,) = contact_cases(prepare_synthetic(clip, PREPARE), samples).values()
    with pytest.raises(NoEstimate) as refused:
        network._told(dataclasses.replace(case, noise=noise))
    assert str(refused.value) == NO_NOISE


def test_one_observation_is_too_early(network: ContactNetwork, clip) -> None:
    prepared = prepare_synthetic(clip, PREPARE)
    early, enough = (network.estimate_clip(prepared, frames)[clip.motion.onset_frame] for frames in (1, 2))
    assert isinstance(early, NoEstimate)
    assert str(early) == TOO_EARLY
    assert np.isfinite(enough.theta).all()


def test_what_is_wrong_with_a_contact_is_told_beside_why_it_has_no_estimate(
    network: ContactNetwork, clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Outlines that disagree with the depth are a remark of the onset's frame."""
    monkeypatch.setattr("data.contact_motion.frayed_share", lambda *_: 0.25)
    results = [result.estimate for result in network.run(open_synthetic(clip, PREPARE))]
    onset = clip.motion.onset_frame
    assert results[onset].detail == f"{FRAYED.format(share=0.25)} {TOO_EARLY}"
    assert (results[onset].verdict, results[onset].stiffness) == ("undetermined", None)
    assert results[onset + 1].detail == TOO_EARLY


class Remarked:
    """A clip stream of which every frame in contact has a remark."""

    def __init__(self, stream: ClipStream) -> None:
        self.stream = stream

    def __getattr__(self, name: str) -> object:
        return getattr(self.stream, name)

    def __iter__(self) -> Iterator[PreparedFrame]:
        for prepared in self.stream:
            prepared.detail = LOST if prepared.in_contact else ""
            yield prepared


def test_remarks_stay_beside_what_the_network_says(
    network: ContactNetwork, clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, estimate = [], network.estimate
    monkeypatch.setattr(network, "estimate", lambda *told: found.append(estimate(*told)) or found[-1])
    results = [result.estimate for result in network.run(Remarked(open_synthetic(clip, PREPARE)))]
    onset, release = clip.motion.onset_frame, clip.motion.release_frame
    assert [item.detail for item in results[onset : onset + 2]] == [f"{LOST} {TOO_EARLY}"] * 2
    misfits = [item.misfit for item in found]
    assert min(misfits) > LARGEST_MISFIT  # an untrained network explains nothing
    expected = [f"{LOST} {UNEXPLAINED.format(misfit)}" for misfit in misfits]
    assert [item.detail for item in results[onset + 2 : release]] == expected
    assert {item.detail for item in results[:onset]} == {""}
    rough = dataclasses.replace(PREPARE, geometry=dataclasses.replace(PREPARE.geometry, smoothing=0.0))
    blind = [result.estimate.detail for result in network.run(Remarked(open_synthetic(clip, rough)))]
    assert set(blind) == {"", f"{LOST} {NO_NOISE}"}


@pytest.mark.parametrize(
    ("load", "told"),
    [
        (0.24, 25),  # the shortest press of the training, and what followed
        (0.48, 25),
        (0.52, 12),  # longer: its beginning
        (5.0, 12),
        (0.12, 3),  # shorter: as far as it lasted
    ],
)
def test_presses_unlike_the_training_s_are_told_in_part(network: ContactNetwork, clip, load: float, told: int) -> None:
    samples = SampleSettings(observation="trajectory", mechanics=MECHANICS)
    (case,) = contact_cases(prepare_synthetic(clip, PREPARE), samples).values()
    steps = np.arange(7, 200, 8)
    motion = np.ones((25, 3), np.float32)
    case = dataclasses.replace(
        case, load_steps=round(load / 0.005), steps=steps, displacement=motion, weight=motion[:, 0]
    )
    network.mechanics = network.trained
    np.testing.assert_array_equal(network._told(case).steps, steps[:told])
    np.testing.assert_array_equal(network._told(case).displacement, motion[:told])


def test_a_motion_that_is_not_explained_widens_the_intervals(network: ContactNetwork, clip) -> None:
    samples = SampleSettings(observation="trajectory", mechanics=MECHANICS)
    (case,) = contact_cases(prepare_synthetic(clip, PREPARE), samples).values()
    network.mechanics = network.trained
    still = dataclasses.replace(case, noise=1.0)  # next to such noise every motion is explained
    explained = network.estimate(still, None, None)
    raw = network.model(contact_features(still, MECHANICS.time_step)[None], None)[1][0]
    assert explained.misfit < 1
    np.testing.assert_array_equal(explained.covariance, raw)
    sure = dataclasses.replace(case, noise=1e-5)
    found = network.estimate(sure, None, None)
    raw = network.model(contact_features(sure, MECHANICS.time_step)[None], None)[1][0]
    assert found.misfit > LARGEST_MISFIT
    box = BOUNDS.log_box
    added = np.linalg.inv(found.information / found.misfit**2 + np.diag(12 / (box[1] - box[0]) ** 2))
    np.testing.assert_allclose(found.covariance, raw + added, rtol=1e-6)
    assert (np.diag(added) <= (box[1] - box[0]) ** 2 / 12 + 1e-12).all()  # never wider than the prior


def test_a_motion_across_the_force_is_no_misfit(network: ContactNetwork, clip) -> None:
    """A measured normal that is off by some degrees would look like it; the network is not told of it either."""
    samples = SampleSettings(observation="trajectory", mechanics=MECHANICS)
    (case,) = contact_cases(prepare_synthetic(clip, PREPARE), samples).values()
    network.mechanics = network.trained
    across = np.cross(case.direction, [1.0, 0.0, 0.0])
    sideways = dataclasses.replace(case, displacement=(case.displacement + 0.05 * across).astype(np.float32))
    straight, moved = (network.estimate(item, None, None) for item in (case, sideways))
    assert moved.misfit == pytest.approx(straight.misfit, rel=1e-4)
    np.testing.assert_allclose(moved.theta, straight.theta, rtol=1e-4)


def aslant(case: ContactCase, degrees: float) -> ContactCase:
    """A contact moved aside, so that its direction lies that far from the line of sight; its motion stays."""
    normal = np.asarray(case.direction, np.float64)
    ray = -0.5 * normal + 0.5 * math.tan(math.radians(degrees)) * np.linalg.svd(normal[None])[2][1]
    vertices = (case.mesh.vertices - case.mesh.vertices[case.vertex] + ray).astype(np.float32)
    return dataclasses.replace(case, mesh=dataclasses.replace(case.mesh, vertices=vertices))


def test_a_press_aslant_to_the_line_of_sight_widens_the_intervals(network: ContactNetwork, clip) -> None:
    samples = SampleSettings(observation="trajectory", mechanics=MECHANICS)
    (case,) = contact_cases(prepare_synthetic(clip, PREPARE), samples).values()
    network.mechanics = network.trained
    calm = dataclasses.replace(case, displacement=0 * case.displacement, noise=0.003)
    first = network.estimate(aslant(calm, 0.0), None, None)
    path = simulate(
        first.theta, case.mesh, case.vertex, case.direction, network.trained, load_steps=case.load_steps
    )  # what it answers to is explained only if it moves so
    still = dataclasses.replace(calm, displacement=path[case.steps].astype(np.float32), noise=0.003)
    angles = LARGEST_ANGLE - 0.1, LARGEST_ANGLE + 0.1
    facing, oblique = (network.estimate(aslant(still, degrees), None, None) for degrees in angles)
    assert max(facing.misfit, oblique.misfit) < LARGEST_MISFIT < HIDDEN_ERROR / 0.003
    assert (facing.view_angle, oblique.view_angle) == pytest.approx(angles, abs=1e-3)
    np.testing.assert_allclose(oblique.theta, facing.theta, rtol=1e-3)
    box = BOUNDS.log_box
    added = np.linalg.inv(oblique.information / 5**2 + np.diag(12 / (box[1] - box[0]) ** 2))
    np.testing.assert_allclose(oblique.covariance, facing.covariance + added, rtol=0.01, atol=1e-3)
    # So does what decides the verdict.
    decisive = np.linalg.inv(facing.decisive) + added
    np.testing.assert_allclose(np.linalg.inv(oblique.decisive), decisive, rtol=0.01, atol=1e-3)


def test_a_press_that_began_between_frames_is_known_less(network: ContactNetwork, clip) -> None:
    """Estimates as if it had begun at five instants of two frames' time, taken together; so for the verdict."""
    samples = SampleSettings(observation="trajectory", mechanics=MECHANICS)
    prepared = prepare_synthetic(clip, PREPARE)
    (case,) = contact_cases(prepared, samples).values()
    case = dataclasses.replace(case, noise=0.03)
    unsure = ContactNetwork(network.model, "between")
    for estimator in (network, unsure):
        estimator.estimate_clip(prepared)  # matches the clip's frame rate
    steps = round(1 / (25 * network.mechanics.time_step))
    shifted = []
    for delay in (-steps, -steps // 2, 0, steps // 2, steps):
        kept = case.steps >= delay
        parts = {name: getattr(case, name)[kept] for name in ("displacement", "weight")}
        shifted.append(network.estimate(dataclasses.replace(case, steps=case.steps[kept] - delay, **parts), None, None))
    found = unsure.estimate(case, None, None)
    assert found.misfit == min(item.misfit for item in shifted) < LARGEST_MISFIT
    logs = np.log(np.abs([item.theta for item in shifted]))
    np.testing.assert_allclose(np.log(np.abs(found.theta)), logs.mean(axis=0), rtol=1e-6)
    apart = np.cov(logs.T, bias=True)
    assert apart[0, 0] > 1e-6
    inside = np.mean([item.covariance for item in shifted], axis=0)
    np.testing.assert_allclose(found.covariance, inside + apart, rtol=1e-5)
    inside = np.mean([np.linalg.inv(item.decisive) for item in shifted], axis=0)
    np.testing.assert_allclose(np.linalg.inv(found.decisive), inside + apart, rtol=1e-4)


def test_frames_of_an_oblique_press_say_so(network: ContactNetwork, clip, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("estimators.contact_network.view_angle", lambda _: 17.4)
    onset, release = clip.motion.onset_frame, clip.motion.release_frame
    results = [result.estimate for result in network.run(open_synthetic(clip, PREPARE))]
    told = OBLIQUE.format(17.4)
    assert "at 17° to the line of sight" in told
    details = [item.detail for item in results]
    assert all(detail.endswith(told) for detail in details[onset + 2 : release])
    assert not any(told in detail for detail in details[: onset + 2] + details[release:])
