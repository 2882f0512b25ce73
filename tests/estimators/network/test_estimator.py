"""The exported contact posterior on prepared clips: what every frame gets, and that streams and whole clips agree."""

import dataclasses
import math

import numpy as np
import pytest

from palpate.data.contact.depth_sequence import SequenceRecorder
from palpate.data.contact.interaction import Interaction, InteractionBuilder
from palpate.data.contact.motion import LOST
from palpate.data.contact.sequence_features import dent_features
from palpate.data.prepared import PreparedFrame
from palpate.data.synthetic.clip import SyntheticClip
from palpate.data.synthetic.source import open_synthetic
from palpate.estimators.contract import Preparation
from palpate.estimators.estimate import NoEstimate, PressResult
from palpate.estimators.network.estimator import NO_NOISE, TOO_EARLY, UNEXPLAINED, NetworkEstimator, NetworkSettings
from palpate.estimators.network.fits import MECHANICS
from palpate.estimators.network.misfit import LARGEST_MISFIT, compared
from palpate.estimators.oblique import HIDDEN_ERROR, LARGEST_ANGLE, OBLIQUE
from palpate.estimators.onset import BETWEEN, STAMP
from palpate.estimators.result import values_of
from palpate.physics.identifiability import NINETY
from palpate.physics.load import held
from palpate.physics.mechanics import RECOMMENDED, theta_of
from palpate.physics.msd.simulation import simulate
from palpate.physics.observation import Observation
from tests.estimators.sessions import SIZE, clip_info, follow


@pytest.fixture(scope="module")
def network(posterior) -> NetworkEstimator:
    """An untrained posterior at work."""
    return NetworkEstimator(posterior, NetworkSettings(onset=STAMP))


@pytest.fixture(scope="module")
def contact(pressed, frames: list[PreparedFrame]) -> Interaction:
    """The clip's run of contact, as it was observed to its end, without its depth-change sequence."""
    return built(pressed, frames, None)


@pytest.fixture(scope="module")
def with_sequence(pressed, frames: list[PreparedFrame]) -> Interaction:
    """Contact with its depth-change sequence."""
    return built(pressed, frames, SIZE)


def built(pressed: SyntheticClip, frames: list[PreparedFrame], size: tuple[int, int] | None) -> Interaction:
    onset, *after = frames[pressed.motion.onset_frame :]
    found, seen = onset.geometry, (onset, clip_info().geometry)
    place = found.mesh, found.vertex
    recorders = {"depth": SequenceRecorder.of(*place, found.noise, size, onset)} if size else {}
    run = InteractionBuilder(*place, found.normal, found.noise, *seen, MECHANICS.seconds, recorders)
    for frame in after:
        assert frame.track_start == onset.frame.index
        run.add(frame)
    return run.build(MECHANICS)


def estimated(network: NetworkEstimator, contact: Interaction) -> PressResult:
    """Estimate of a contact at 25 frames a second."""
    return network.start(clip_info()).estimate(contact, None)


WIDTHS = RECOMMENDED.log_box[1] - RECOMMENDED.log_box[0]


def added_by(misfit: float, information: np.ndarray) -> np.ndarray:
    """Covariance by which an estimate that explains its motion so badly is widened, in the box."""
    return np.linalg.inv(information / misfit**2 + np.diag(12 / WIDTHS**2))


def moved(contact: Interaction, displacement: np.ndarray, noise: float | None = None) -> Interaction:
    """Contact of the same instants with other displacements [N, 3], and maybe another noise."""
    noise = contact.noise if noise is None else noise
    return contact.having(point=contact.observation.moved(displacement, noise))


def prepared_roughly(network: NetworkEstimator, clip: SyntheticClip) -> list[PreparedFrame]:
    """Without smoothing, which leaves the noise unknown."""
    settings = network.preparation(Preparation())
    rough = dataclasses.replace(settings, geometry=dataclasses.replace(settings.geometry, smoothing=0.0))
    return list(open_synthetic(clip, rough))


def test_every_frame_has_its_row(network: NetworkEstimator, pressed, frames: list[PreparedFrame]) -> None:
    results, _ = follow(network.start(clip_info()), frames)
    assert [item.frame for item in results] == list(range(28))
    onset, release = pressed.motion.onset_frame, pressed.motion.release_frame
    for item in results:
        values = values_of(item)
        if item.status != "ok":
            assert (item.estimate, item.verdict, "stiffness_sd" in values) == (None, "", False)
            continue
        assert onset <= item.frame < release
        if item.frame < onset + 2:  # too little motion was observed
            assert (item.estimate, item.verdict, item.detail) == (None, "undetermined", TOO_EARLY)
            continue
        assert item.verdict in ("determined", "ratios", "undetermined")
        low, high = values["stiffness_low"], values["stiffness_high"]
        assert low < values["stiffness"] < high
        log_sd = math.log(high / low) / (2 * NINETY)
        expected = values["stiffness"] * math.exp(log_sd**2 / 2) * math.sqrt(math.expm1(log_sd**2))
        assert values["stiffness_sd"] == pytest.approx(expected)
    early, late = (results[at].estimate.numbers.force_bound for at in (onset + 2, release - 1))
    assert early > late


def test_a_stream_ends_where_the_whole_clip_would(network, pressed, frames, with_sequence) -> None:
    """The last frame in contact is told exactly what a clip cut off there is told."""
    onset, last = pressed.motion.onset_frame, pressed.motion.release_frame - 1
    streamed = follow(network.start(clip_info()), frames)[0][last].estimate
    seconds = (last - onset) / 25
    cut = with_sequence.observed(with_sequence.observation.times <= seconds + 1e-6)
    load = dataclasses.replace(cut.load, factor=held(round(seconds / MECHANICS.time_step), MECHANICS.steps))
    found = estimated(network, dataclasses.replace(cut, load=load))
    np.testing.assert_allclose(streamed.theta, found.theta, rtol=1e-5)
    np.testing.assert_allclose(streamed.covariance, found.covariance, rtol=1e-5)


def test_without_a_noise_level_there_is_no_estimate(network: NetworkEstimator, pressed) -> None:
    results, (run,) = follow(network.start(clip_info()), prepared_roughly(network, pressed))
    assert (run.estimate, run.detail) == (None, NO_NOISE)
    touched = {(item.verdict, item.estimate, item.detail) for item in results if item.status == "ok"}
    assert touched == {("undetermined", None, NO_NOISE)}


@pytest.mark.parametrize("noise", [math.nan, math.inf, 0.0])
def test_a_noise_level_is_a_positive_number(network: NetworkEstimator, contact: Interaction, noise: float) -> None:
    with pytest.raises(NoEstimate) as refused:
        network.as_trained(moved(contact, contact.moved, noise))
    assert str(refused.value) == NO_NOISE


def test_one_observation_is_too_early(posterior, frames: list[PreparedFrame]) -> None:
    sessions = (
        NetworkEstimator(posterior, NetworkSettings(onset=STAMP, horizon=horizon)).start(clip_info())
        for horizon in (1, 2)
    )
    early, enough = (follow(session, frames)[1][0] for session in sessions)
    assert (early.estimate, early.detail) == (None, TOO_EARLY)
    assert len(early.interaction.observation) == 1
    assert np.isfinite(enough.estimate.theta).all()


def remarked(frames: list[PreparedFrame]) -> list[PreparedFrame]:
    """Frames with a remark in every frame in contact."""
    return [dataclasses.replace(frame, detail=LOST if frame.in_contact else "") for frame in frames]


def test_remarks_stay_beside_what_the_network_says(network, pressed, frames, monkeypatch) -> None:
    monkeypatch.setattr("palpate.estimators.network.estimator.largest_misfit", lambda _: 1.0)
    results, _ = follow(network.start(clip_info()), remarked(frames))
    onset, release = pressed.motion.onset_frame, pressed.motion.release_frame
    assert [item.detail for item in results[onset : onset + 2]] == [f"{LOST} {TOO_EARLY}"] * 2
    misfits = [item.estimate.misfit for item in results[onset + 2 : release]]
    assert min(misfits) < 1 < max(misfits)
    expected = [LOST if misfit <= 1 else f"{LOST} {UNEXPLAINED.format(misfit)}" for misfit in misfits]
    assert [item.detail for item in results[onset + 2 : release]] == expected
    assert {item.detail for item in results[:onset]} == {""}
    blind, _ = follow(network.start(clip_info()), remarked(prepared_roughly(network, pressed)))
    assert {item.detail for item in blind} == {"", f"{LOST} {NO_NOISE}"}


@pytest.mark.parametrize(
    ("load", "told"),
    [(0.24, 25), (0.48, 25), (0.52, 12), (5.0, 12), (0.12, 3)],
    ids=["shortest", "longest", "longer: its beginning", "far longer", "shorter: as far as it lasted"],
)
def test_presses_unlike_the_training_s_are_told_in_part(network, contact, load, told) -> None:
    observation = Observation.of_point(contact.vertex, np.arange(1, 26) / 25, np.ones((25, 3)), 0.001)
    factor = held(round(load / MECHANICS.time_step), round(6 / MECHANICS.time_step))
    press = dataclasses.replace(contact.load, factor=factor)
    found = network.as_trained(dataclasses.replace(contact.having(point=observation), load=press)).observation
    np.testing.assert_array_equal(found.times, observation.times[:told])
    np.testing.assert_array_equal(found.displacement, observation.displacement[:, :told])


def test_a_motion_that_is_not_explained_widens_the_intervals(network: NetworkEstimator, contact: Interaction) -> None:
    still, sure = (moved(contact, contact.moved, noise) for noise in (1.0, 1e-5))
    explained, found = (estimated(network, each) for each in (still, sure))
    raw, own = (network.model(dent_features(each, 0.0)[None], None)[1][0] for each in (still, sure))
    assert explained.misfit < 1  # next to such noise every motion is explained
    np.testing.assert_array_equal(explained.covariance, raw)
    assert found.misfit > LARGEST_MISFIT
    added = added_by(found.misfit, found.information)
    np.testing.assert_allclose(found.covariance, own + added, rtol=1e-6)
    assert (np.diag(added) <= np.square(WIDTHS) / 12 + 1e-12).all()  # never wider than the prior


def test_a_motion_across_the_force_is_no_misfit(network: NetworkEstimator, contact: Interaction) -> None:
    """A measured normal that is off by some degrees would look like it; the network is not determined of it either."""
    across = np.cross(contact.direction, [1.0, 0.0, 0.0])
    straight, aside = (estimated(network, each) for each in (contact, moved(contact, contact.moved + 0.05 * across)))
    assert aside.misfit == pytest.approx(straight.misfit, rel=1e-4)
    np.testing.assert_allclose(aside.theta, straight.theta, rtol=1e-4)


def aslant(contact: Interaction, degrees: float) -> Interaction:
    """A contact moved aside, so that its direction lies that far from the line of sight; its motion stays."""
    normal, mesh = np.asarray(contact.direction, np.float64), contact.mesh
    ray = -0.5 * normal + 0.5 * math.tan(math.radians(degrees)) * np.linalg.svd(normal[None])[2][1]
    vertices = (mesh.vertices - mesh.vertices[contact.vertex] + ray).astype(np.float32)
    return dataclasses.replace(contact, mesh=dataclasses.replace(mesh, vertices=vertices))


def test_a_press_aslant_to_the_line_of_sight_widens_the_intervals(network, contact) -> None:
    calm = moved(contact, 0 * contact.moved, 0.003)
    first = estimated(network, aslant(calm, 0.0))
    path = simulate(first.theta, contact.mesh, contact.load, MECHANICS)
    # What it answers to is explained only if it moves so.
    still = moved(contact, path[contact.observation.steps(MECHANICS.time_step)], 0.003)
    angles = LARGEST_ANGLE - 0.1, LARGEST_ANGLE + 0.1
    facing, oblique = (estimated(network, aslant(still, degrees)) for degrees in angles)
    assert max(facing.misfit, oblique.misfit) < LARGEST_MISFIT < HIDDEN_ERROR / 0.003
    assert (facing.course.view_angle, oblique.course.view_angle) == pytest.approx(angles, abs=1e-3)
    np.testing.assert_allclose(oblique.theta, facing.theta, rtol=1e-3)
    added = added_by(5, oblique.information)
    np.testing.assert_allclose(oblique.covariance, facing.covariance + added, rtol=0.01, atol=1e-3)
    # So does what decides the verdict.
    expected = np.linalg.inv(facing.expected_information) + added
    np.testing.assert_allclose(np.linalg.inv(oblique.expected_information), expected, rtol=0.01, atol=1e-3)


def test_frames_of_an_oblique_press_say_so(network, pressed, frames, monkeypatch) -> None:
    monkeypatch.setattr("palpate.estimators.network.estimator.view_angle", lambda _: 17.4)
    onset, release = pressed.motion.onset_frame, pressed.motion.release_frame
    results, (run,) = follow(network.start(clip_info()), frames)
    told = OBLIQUE.format(17.4)
    assert "at 17° to the line of sight" in told
    details = [item.detail for item in results]
    assert all(detail.endswith(told) for detail in details[onset + 2 : release])
    assert not any(told in detail for detail in details[: onset + 2] + details[release:])
    assert run.detail.endswith(told)


def test_the_network_is_told_how_well_the_instants_are_known(network, contact, with_sequence) -> None:
    """It answers once, for all instants together, with or without a depth-change sequence."""
    for onset, within in ((STAMP, 0.0), (BETWEEN, 0.04)):
        told = NetworkEstimator(network.model, NetworkSettings(onset=onset))
        for seen in (contact, with_sequence):
            found, features = estimated(told, seen), dent_features(seen, within)
            assert features[-2:].tolist() == [within / 0.04, seen.sequence is not None]  # in frames
            logs, covariance, _ = (values[0] for values in told.model(features[None], None))
            np.testing.assert_allclose(found.theta, theta_of(logs), rtol=1e-6)
            misfit, information, _ = compared(seen, MECHANICS, logs, covariance, within)
            assert (found.misfit, found.misfit > LARGEST_MISFIT) == (misfit, True)
            np.testing.assert_array_equal(found.information, information)
            np.testing.assert_allclose(found.covariance, covariance + added_by(misfit, information), rtol=1e-6)
