"""Export and its parity with torch, on the file, over several batch sizes."""

from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from palpate.common.output import LIST, ForeignFile
from palpate.models import onnx_export
from palpate.models.generator import Generator
from palpate.models.onnx_session import ParameterModel, PosteriorModel
from palpate.models.posterior import ContactPosterior
from palpate.physics.mechanics import Bounds

SIZE = (24, 40)
METADATA = {"input": {"window": 1, "height": 24, "width": 40}}
TWO = {"input": {"window": 2, "height": 24, "width": 32}}
BOUNDS = Bounds((0.05, 1.0), (0.005, 0.5), (-0.3, -0.01), (0.4, 0.08, -0.1))


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> tuple[Generator, Path, float]:
    torch.manual_seed(0)
    generator = Generator(3, width=8, residual_blocks=1, bounds=Bounds(force=(-0.3, 0.0), initial=(0.5, 0.1, -0.05)))
    path = tmp_path_factory.mktemp("export") / "größe.onnx"
    document = {"input": METADATA["input"] | {"window": 3}, "config_sha256": "abc", "preprocessing_version": 1}
    return generator, path, onnx_export.export(generator, path, document)


@pytest.mark.parametrize("batch", [1, 2, 7])
def test_file_equals_torch(exported, batch: int):
    generator, path, reported = exported
    depth = torch.rand(batch, 3, *SIZE)
    with torch.inference_mode():
        expected = generator.estimate(depth).numpy()
    theta = ParameterModel(path)(depth.numpy())
    assert theta.dtype == np.float32
    np.testing.assert_allclose(theta, expected, atol=1e-5, rtol=0)
    assert reported < 1e-5


def test_metadata_is_complete_and_neither_weights_nor_paths_of_this_machine_lie_beside_it(exported):
    _, path, _ = exported
    metadata = ParameterModel(path).metadata
    assert metadata["input"] == {"window": 3, "height": 24, "width": 40}
    assert metadata["config_sha256"] == "abc"
    assert metadata["units"]["stiffness"].startswith("scene units")
    assert {file.name for file in path.parent.iterdir()} == {path.name, LIST}
    written = path.read_bytes()
    assert b"site-packages" not in written
    assert b"generator.py" not in written


@pytest.mark.parametrize("difference", [0.01, float("nan")])
def test_a_file_that_differs_from_torch_is_never_left(exported, tmp_path, difference):
    with pytest.raises(onnx_export.ParityError, match=f"differs from torch by {difference}"):
        onnx_export.write(onnx.load(exported[1]), METADATA, tmp_path / "parameters.onnx", lambda path: difference)
    assert list(tmp_path.iterdir()) == []


def test_another_file_is_never_replaced(exported, tmp_path):
    path = tmp_path / "out.onnx"
    path.write_bytes(b"precious")
    with pytest.raises(ForeignFile, match=r"out\.onnx is not as this program wrote it; move it away"):
        onnx_export.write(onnx.load(exported[1]), METADATA, path, lambda path: 0.0)
    assert path.read_bytes() == b"precious"
    path.unlink()
    for _ in range(2):  # its own file is replaced
        onnx_export.write(onnx.load(exported[1]), METADATA, path, lambda path: 0.0)


@pytest.fixture
def posterior() -> ContactPosterior:
    torch.manual_seed(0)
    return ContactPosterior(10, torch.tensor([[-3.0, -5.0, -4.0], [0.0, -0.7, -1.2]]), width=16, blocks=2)


def test_without_calibration_the_covariance_is_the_networks_own(posterior: ContactPosterior, tmp_path) -> None:
    onnx_export.export(posterior, tmp_path / "contact.onnx", METADATA)
    model = PosteriorModel(tmp_path / "contact.onnx")
    assert not model.calibrated
    mean, covariance, expected_bound = model(np.ones((2, 10), np.float32))
    with torch.no_grad():
        expected, factor = posterior(torch.ones(2, 10))
        bound = posterior.expected_bound_factor(torch.ones(2, 10))
    np.testing.assert_allclose(mean, expected.numpy(), atol=1e-5)
    np.testing.assert_allclose(expected_bound, (bound @ bound.transpose(1, 2)).numpy(), rtol=1e-4, atol=1e-6)
    assert model.inputs == {"contact": (10,)}
    with pytest.raises(ValueError, match=r"expected \[B, 10\]"):
        model(np.ones((2, 9), np.float32))
    np.testing.assert_allclose(covariance, (factor @ factor.transpose(1, 2)).numpy(), rtol=1e-4, atol=1e-6)


def test_a_generators_posterior_takes_the_depth_window_too(tmp_path) -> None:
    torch.manual_seed(0)
    generator = Generator(2, 4, 1, BOUNDS, head="posterior", contact_features=10)
    generator.head.posterior.picture.weight.data.normal_()
    assert onnx_export.export(generator, tmp_path / "both.onnx", TWO) < 1e-5
    model = PosteriorModel(tmp_path / "both.onnx")
    assert model.takes_depth
    random = np.random.default_rng(0)
    contact, depth = random.normal(size=(3, 10)), random.uniform(size=(3, 2, 24, 32))
    mean, *_ = model(contact, depth)
    assert not np.allclose(mean, model(contact, depth[::-1])[0])  # the picture counts
    with torch.no_grad():
        theta = generator.eval().estimate(torch.tensor(depth).float(), torch.tensor(contact).float())
    np.testing.assert_allclose(np.exp(mean) * (1, 1, -1), theta.numpy(), rtol=1e-4)
    with pytest.raises(ValueError, match=r"depth has shape \[\]; expected \[B, 2, 24, 32\]"):
        model(contact)


def test_large_bounds_are_compared_relative_to_their_size(posterior: ContactPosterior, tmp_path, monkeypatch) -> None:
    """Variances of 7 can't agree to 1e-5 in float32; a difference of as many parts of 1 can."""
    with torch.no_grad():
        posterior.expected_bound.layers[-1].bias[:] = torch.tensor([1.0, 1.0, 1.0, 30.0, 30.0, 30.0])
    exported = onnx_export.export(posterior, tmp_path / "large.onnx", METADATA)
    model = PosteriorModel(tmp_path / "large.onnx")
    contact = np.ones((1, 10), np.float32)
    assert model(contact)[2].max() > 1000
    assert exported < 1e-5
    plain = PosteriorModel.run
    # A thousandth off.
    monkeypatch.setattr(PosteriorModel, "run", lambda *given: [*plain(*given)[:2], plain(*given)[2] * 1.001])
    assert onnx_export.parity(onnx_export._Posterior(posterior), model, (1, 24, 40)) > onnx_export.PARITY_TOLERANCE
