"""The contact posterior: its box, its covariance, its loss, and the exported file."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from models.calibration import Calibration, Widths
from models.generator import Generator
from models.onnx_file import ParityError
from models.onnx_session import ModelFileError
from models.posterior import ContactPosterior, evidence_loss
from models.posterior_export import export_posterior
from models.posterior_session import PosteriorModel
from physics.mechanics import Bounds

BOX = torch.tensor([[-3.0, -5.0, -4.0], [0.0, -0.7, -1.2]])
METADATA = {"input": {"window": 1, "height": 24, "width": 32}}


@pytest.fixture
def posterior() -> ContactPosterior:
    torch.manual_seed(0)
    return ContactPosterior(10, BOX, width=16, blocks=2)


@settings(max_examples=30, deadline=None)
@given(scale=st.floats(0.1, 1e4), seed=st.integers(0, 1000))
def test_mean_in_the_box_and_covariance_positive(scale: float, seed: int) -> None:
    torch.manual_seed(seed)
    network = ContactPosterior(10, BOX, width=16, blocks=2)
    mean, factor = network(scale * torch.randn(8, 10))
    assert ((mean >= BOX[0]) & (mean <= BOX[1])).all()
    assert (torch.linalg.eigvalsh((factor @ factor.transpose(1, 2)).double()) > 0).all()


def test_the_picture_changes_nothing_at_first() -> None:
    torch.manual_seed(0)
    network = ContactPosterior(10, BOX, width=16, blocks=1, picture=4)
    contact, picture = torch.randn(3, 10), torch.randn(3, 4)
    for with_picture, without in zip(network(contact, picture), network(contact), strict=True):
        torch.testing.assert_close(with_picture, without)
    network.picture.weight.data.normal_()
    assert not torch.allclose(network(contact, picture)[0], network(contact)[0])


def test_inputs_are_standardised_by_their_spread_or_the_least_one() -> None:
    network = ContactPosterior(3, BOX, width=16, blocks=1)
    features = torch.tensor([[1.0, 5.0, 0.0], [3.0, 5.0, 0.2], [5.0, 5.0, 0.4]])  # of spread 2, 0 and 0.2
    network.standardise(features)
    torch.testing.assert_close(network.centre, torch.tensor([3.0, 5.0, 0.2]))
    torch.testing.assert_close(network.scale, torch.tensor([2.0, 0.01, 0.2]))
    network.standardise(features, least=0.3)
    torch.testing.assert_close(network.centre, torch.tensor([3.0, 5.0, 0.2]))
    torch.testing.assert_close(network.scale, torch.tensor([2.0, 0.3, 0.3]))


def test_loss_is_least_at_the_exact_posterior() -> None:
    """For a linear model the bound's optimum is N(H⁻¹(Jᵀd/σ² + Pm), H⁻¹) with H = JᵀJ/σ² + P."""
    generator = np.random.default_rng(1)
    jacobian, prior = generator.normal(size=(12, 3)), np.diag([1.0, 2.0, 3.0])
    observed, noise = generator.normal(size=12), 0.3
    curvature = torch.tensor(jacobian.T @ jacobian / noise**2 + prior)
    exact = torch.linalg.solve(curvature, torch.tensor(jacobian.T @ observed / noise**2))
    mean = exact[None].clone().requires_grad_()
    factor = torch.linalg.cholesky(torch.linalg.inv(curvature))[None].clone().requires_grad_()
    gradient = (curvature @ (mean.detach()[0] - exact))[None]
    evidence_loss(mean, factor, gradient, curvature[None], torch.ones(1)).backward()
    torch.testing.assert_close(mean.grad, torch.zeros_like(mean.grad))
    torch.testing.assert_close(torch.tril(factor.grad[0]), torch.zeros(3, 3, dtype=torch.float64), atol=1e-10, rtol=0)
    for change in (1.1, 0.9):  # and any other covariance is worse
        other = evidence_loss(mean, change * factor, gradient, curvature[None], torch.ones(1))
        assert other > evidence_loss(mean, factor, gradient, curvature[None], torch.ones(1))


def test_gradient_by_the_mean_is_the_misfits() -> None:
    mean = torch.zeros(2, 3, requires_grad=True)
    gradient = torch.tensor([[1.0, -2.0, 3.0], [0.5, 0.0, -1.0]])
    factor, curvature = torch.eye(3).expand(2, 3, 3), torch.eye(3).expand(2, 3, 3)
    evidence_loss(mean, factor, gradient, curvature, torch.tensor([1.0, 0.5])).backward()
    torch.testing.assert_close(mean.grad, gradient * torch.tensor([[0.5], [0.25]]))


def test_exported_file_agrees_and_is_calibrated(posterior: ContactPosterior, tmp_path) -> None:
    posterior.standardise(torch.randn(50, 10) * 3 + 1)
    whole = Widths((1.0, 2.0, 0.5), (1.0, 0.8, 0.5), (0.0, 0.2, 0.1))
    pressed = Widths((1.5, 2.0, 1.5), (0.9, 0.8, 0.7), (0.1, 0.1, 0.0))
    calibration = Calibration(whole, pressed, noise_features=(8, 9), known_features=(4, 5), loaded_features=(6, 7))
    assert export_posterior(posterior, tmp_path / "contact.onnx", METADATA, calibration) < 1e-5
    model = PosteriorModel(tmp_path / "contact.onnx")
    contact = np.random.default_rng(0).normal(size=(5, 10)).astype(np.float32)
    # Two instants seen, none or one of them after the release; or one alone, under load.
    contact[:, 4:8] = [(1, 1, 1, 1), (1, 1, 1, 0), (1, 1, 1, 1), (1, 0, 1, 0), (1, 1, 1, 0)]
    still = np.array([1, 0, 1, 1, 0], bool)[:, None]
    mean, covariance, decisive = model(contact)
    with torch.no_grad():
        expected, factor = posterior(torch.from_numpy(contact))
        bound = posterior.expected_bound_factor(torch.from_numpy(contact))
    np.testing.assert_allclose(mean, expected.numpy(), atol=1e-5)
    plain = (factor @ factor.transpose(1, 2)).numpy()
    sd = np.sqrt(np.diagonal(plain, axis1=1, axis2=2))
    noise = np.exp(contact[:, 8] + contact[:, 9])[:, None]
    whole_sd, pressed_sd = (
        np.array(each.scale) * sd ** np.array(each.power) * noise ** np.array(each.noise) for each in (whole, pressed)
    )
    wanted = np.where(still, pressed_sd, whole_sd)
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)), wanted, rtol=1e-4)
    np.testing.assert_allclose(_correlations(covariance), _correlations(plain), atol=1e-4)
    np.testing.assert_allclose(decisive, (bound @ bound.transpose(1, 2)).numpy(), rtol=1e-4, atol=1e-6)
    assert model.metadata["calibration"] == calibration.document()
    assert model.calibrated
    assert (model.features, model.takes_depth, model.calibrated) == (10, False, True)
    with pytest.raises(ValueError, match=r"expected \[B, 10\]"):
        model(contact[:, :9])


def _correlations(covariances: np.ndarray) -> np.ndarray:
    sd = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    return covariances / (sd[:, :, None] * sd[:, None])


def test_without_calibration_the_covariance_is_the_networks_own(posterior: ContactPosterior, tmp_path) -> None:
    export_posterior(posterior, tmp_path / "contact.onnx", METADATA)
    model = PosteriorModel(tmp_path / "contact.onnx")
    assert not model.calibrated
    _, covariance, _ = model(np.ones((2, 10), np.float32))
    with torch.no_grad():
        factor = posterior(torch.ones(2, 10))[1]
    np.testing.assert_allclose(covariance, (factor @ factor.transpose(1, 2)).numpy(), rtol=1e-4, atol=1e-6)


def test_a_generators_posterior_takes_the_depth_window_too(tmp_path) -> None:
    torch.manual_seed(0)
    bounds = Bounds((0.05, 1.0), (0.005, 0.5), (-0.3, -0.01), (0.4, 0.08, -0.1))
    generator = Generator(2, 4, 1, bounds, head="posterior", contact_features=10)
    generator.head.posterior.picture.weight.data.normal_()
    document = {"input": {"window": 2, "height": 24, "width": 32}}
    assert export_posterior(generator, tmp_path / "both.onnx", document) < 1e-5
    model = PosteriorModel(tmp_path / "both.onnx")
    assert model.takes_depth
    random = np.random.default_rng(0)
    contact, depth = random.normal(size=(3, 10)), random.uniform(size=(3, 2, 24, 32))
    mean, *_ = model(contact, depth)
    assert not np.allclose(mean, model(contact, depth[::-1])[0])  # the picture counts
    with torch.no_grad():
        theta = generator.eval().estimate(torch.tensor(depth).float(), torch.tensor(contact).float())
    np.testing.assert_allclose(np.exp(mean) * (1, 1, -1), theta.numpy(), rtol=1e-4)
    with pytest.raises(ValueError, match="depth windows"):
        model(contact)


def test_files_that_give_verdicts_otherwise_are_refused(posterior: ContactPosterior, tmp_path) -> None:
    """Earlier versions wrote factors of standard deviations instead of expected bounds."""
    document = METADATA | {"calibration": {"whole": {"decisive": [1.0, 1.0, 1.0]}}}
    with pytest.raises(ModelFileError, match="as an earlier version did; export it again"):
        export_posterior(posterior, tmp_path / "old.onnx", document)


def test_large_bounds_are_compared_relative_to_their_size(posterior: ContactPosterior, tmp_path, monkeypatch) -> None:
    """Variances of 7 can't agree to 1e-5 in float32; a difference of as many parts of 1 can."""
    with torch.no_grad():
        posterior.expected_bound.layers[-1].bias[:] = torch.tensor([1.0, 1.0, 1.0, 30.0, 30.0, 30.0])
    exported = export_posterior(posterior, tmp_path / "large.onnx", METADATA)
    model = PosteriorModel(tmp_path / "large.onnx")
    contact = np.ones((1, 10), np.float32)
    assert model(contact)[2].max() > 1000
    assert exported < 1e-5
    plain = PosteriorModel.__call__
    monkeypatch.setattr(
        PosteriorModel, "__call__", lambda *told: (*plain(*told)[:2], plain(*told)[2] * 1.001)
    )  # a thousandth off
    with pytest.raises(ParityError):
        export_posterior(posterior, tmp_path / "off.onnx", METADATA)


def test_another_file_is_refused(tmp_path) -> None:
    path = tmp_path / "text.onnx"
    path.write_text("no network")
    with pytest.raises(ModelFileError, match="not a readable ONNX file"):
        PosteriorModel(path)


def test_the_expected_bound_is_a_network_of_its_own(posterior: ContactPosterior) -> None:
    """The posterior's weights don't change it."""
    contact = torch.randn(4, 10)
    before = posterior.expected_bound_factor(contact)
    for name, weights in posterior.named_parameters():
        if not name.startswith("expected_bound."):
            weights.data.add_(0.1)
    torch.testing.assert_close(posterior.expected_bound_factor(contact), before)
    posterior.standardise(3 * torch.randn(50, 10) + 1)
    assert not torch.allclose(
        posterior.expected_bound_factor(contact), before
    )  # but it sees standardised features, too
