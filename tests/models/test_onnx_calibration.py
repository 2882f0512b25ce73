"""Calibrated files: as the formula says, for networks with and without a picture, and with all else as it was."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from palpate.models.calibration import Calibration, Widths
from palpate.models.checkpoint import CheckpointError, load_posterior
from palpate.models.generator import Generator
from palpate.models.onnx_export import ParityError, calibrate, export
from palpate.models.onnx_session import ModelFileError, PosteriorModel
from palpate.models.posterior import ContactPosterior
from palpate.physics.mechanics import Bounds
from tests.inference_inputs import write_model

METADATA = {"input": {"window": 1, "height": 24, "width": 40}}
WHOLE = Widths((1.0, 2.0, 0.5), (1.0, 0.8, 0.5), (0.0, 0.2, 0.1), (0.0, 0.3, -0.2))
BOUNDS = Bounds((0.05, 1.0), (0.005, 0.5), (-0.3, -0.01), (0.4, 0.08, -0.1))


def untrained() -> ContactPosterior:
    return ContactPosterior(10, torch.tensor(BOUNDS.log_box), width=16, blocks=1)


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Path:
    """An exported posterior that takes ten numbers."""
    torch.manual_seed(0)
    posterior = untrained()
    with torch.no_grad():  # the exporter keeps equal weights once
        for weights in posterior.parameters():
            weights += 0.01 * torch.randn(weights.shape)
    posterior.standardise(torch.randn(50, 10) * 3 + 1)
    path = tmp_path_factory.mktemp("plain") / "plain.onnx"
    export(posterior, path, METADATA | {"bounds": dataclasses.asdict(BOUNDS)})
    return path


@pytest.fixture(scope="module")
def calibrated(plain: Path) -> Path:
    """Export calibrated by the observation's noise."""
    calibrate(plain, plain.with_name("calibrated.onnx"), Calibration(WHOLE, noise_features=(8,)))
    return plain.with_name("calibrated.onnx")


def deviations(covariances: np.ndarray) -> np.ndarray:
    return np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))


def correlations(covariances: np.ndarray) -> np.ndarray:
    sd = deviations(covariances)
    return covariances / (sd[:, :, None] * sd[:, None])


def test_standard_deviations_are_widened_by_what_was_seen(plain: Path, tmp_path: Path) -> None:
    pressed = Widths((1.5, 2.0, 1.5), (0.9, 0.8, 0.7), (0.1, 0.1, 0.0))
    calibration = Calibration(WHOLE, pressed, noise_features=(8, 9), known_features=(4, 5), loaded_features=(6, 7))
    assert calibrate(plain, tmp_path / "contact.onnx", calibration) < 1e-5
    before, model = PosteriorModel(plain), PosteriorModel(tmp_path / "contact.onnx")
    assert (before.calibrated, model.calibrated, model.inputs) == (False, True, before.inputs)
    assert model.metadata == before.metadata | {"calibration": json.loads(json.dumps(dataclasses.asdict(calibration)))}
    contact = np.random.default_rng(0).normal(size=(5, 10)).astype(np.float32)
    # Two instants seen, none or one of them after the release; or one alone, under load.
    contact[:, 4:8] = [(1, 1, 1, 1), (1, 1, 1, 0), (1, 1, 1, 1), (1, 0, 1, 0), (1, 1, 1, 0)]
    still = np.array([1, 0, 1, 1, 0], bool)[:, None]
    mean, own, expected = before(contact)
    found, covariance, bound = model(contact)
    np.testing.assert_array_equal(found, mean)
    np.testing.assert_array_equal(bound, expected)
    noise = np.exp(contact[:, 8] + contact[:, 9])[:, None]
    damping = np.exp(mean[:, 1:2] - 0.5 * mean[:, :1])

    def widened(by: Widths) -> np.ndarray:
        factors = noise ** np.array(by.noise) * damping ** np.array(by.damping)
        return np.array(by.scale) * deviations(own) ** np.array(by.power) * factors

    np.testing.assert_allclose(deviations(covariance), np.where(still, widened(pressed), widened(WHOLE)), rtol=1e-4)
    np.testing.assert_allclose(correlations(covariance), correlations(own), atol=1e-4)


def test_widths_bend_within_a_range_of_noise_only(plain: Path, tmp_path: Path) -> None:
    bent = Widths(bend=(0.1, 0.2, -0.1), middle_range=(-0.5, 0.7))
    calibrate(plain, tmp_path / "contact.onnx", Calibration(bent, noise_features=(8,)))
    contact = np.random.default_rng(0).normal(size=(9, 10)).astype(np.float32)
    own, covariance = (PosteriorModel(path)(contact)[1] for path in (plain, tmp_path / "contact.onnx"))
    inside = np.minimum(np.maximum(contact[:, 8:9], -0.5), 0.7)
    assert 0 < np.mean(inside == contact[:, 8:9]) < 1
    factors = np.exp(np.array(bent.bend) * (inside - 0.1) ** 2)
    np.testing.assert_allclose(deviations(covariance), deviations(own) * factors, rtol=1e-4)


def test_presses_of_unknown_instants_are_never_surer_than_others(plain: Path, tmp_path: Path) -> None:
    whole, between = Widths((1.0, 1.0, 1.0)), Widths((2.0, 0.5, 1.5))
    calibrate(plain, tmp_path / "contact.onnx", Calibration(whole, between=between, within_features=(3,)))
    contact = np.random.default_rng(0).normal(size=(2, 10)).astype(np.float32)
    contact[1] = contact[0]
    contact[:, 3] = 0, 1
    own, covariance = (PosteriorModel(path)(contact)[1] for path in (plain, tmp_path / "contact.onnx"))
    expected = [1, 1, 1] * deviations(own)[0], [2, 1, 1.5] * deviations(own)[1]
    np.testing.assert_allclose(deviations(covariance), expected, rtol=1e-4)


def test_a_generators_posterior_is_calibrated_as_well(tmp_path: Path) -> None:
    torch.manual_seed(0)
    generator = Generator(2, 4, 1, BOUNDS, head="posterior", contact_features=10)
    export(generator, tmp_path / "both.onnx", {"input": {"window": 2, "height": 24, "width": 32}})
    calibrate(tmp_path / "both.onnx", tmp_path / "out.onnx", Calibration(Widths((2.0, 3.0, 4.0))))
    random = np.random.default_rng(0)
    inputs = random.normal(size=(3, 10)), random.uniform(size=(3, 2, 24, 32))
    own, covariance = (PosteriorModel(tmp_path / name)(*inputs)[1] for name in ("both.onnx", "out.onnx"))
    np.testing.assert_allclose(covariance, own * np.outer([2, 3, 4], [2, 3, 4]), rtol=1e-4)


def test_weights_of_a_calibrated_file_are_still_those_of_the_network(plain: Path, calibrated: Path) -> None:
    posteriors = [untrained() for _ in range(2)]
    for posterior, path in zip(posteriors, (plain, calibrated), strict=True):
        load_posterior(posterior, path)
    first, second = (posterior.state_dict() for posterior in posteriors)
    assert all(torch.equal(value, second[name]) for name, value in first.items())
    with pytest.raises(CheckpointError, match="holds no contact posterior of this version"):
        load_posterior(ContactPosterior(9, torch.tensor(BOUNDS.log_box)), plain)


def test_what_can_t_be_calibrated_is_refused_and_leaves_no_file(plain, calibrated, tmp_path, monkeypatch) -> None:
    twice = tmp_path / "twice.onnx"
    with pytest.raises(ValueError, match=r"calibrated\.onnx is calibrated already"):
        calibrate(calibrated, twice, Calibration(WHOLE))
    write_model(tmp_path / "parameters.onnx")
    with pytest.raises(ModelFileError, match="takes depth"):
        calibrate(tmp_path / "parameters.onnx", twice, Calibration(WHOLE))
    monkeypatch.setattr("palpate.models.onnx_export.PARITY_TOLERANCE", -1.0)
    with pytest.raises(ParityError, match="differs from torch"):
        calibrate(plain, twice, Calibration(WHOLE))
    assert not twice.exists()
