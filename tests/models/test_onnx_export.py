"""Export and its parity with torch, on the file, over several batch sizes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from models.generator import Generator
from models.onnx_export import export
from models.onnx_file import ParityError
from models.onnx_session import ParameterModel
from physics.mechanics import Bounds

SIZE = (24, 40)


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> tuple[Generator, Path, float]:
    torch.manual_seed(0)
    generator = Generator(3, width=8, residual_blocks=1, bounds=Bounds(force=(-0.3, 0.0), initial=(0.5, 0.1, -0.05)))
    path = tmp_path_factory.mktemp("export") / "größe.onnx"
    return generator, path, export(generator, path, SIZE, {"config_sha256": "abc", "preprocessing_version": 1})


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


def test_metadata_is_complete_and_no_weights_lie_beside_the_file(exported):
    _, path, _ = exported
    metadata = ParameterModel(path).metadata
    assert metadata["input"] == {"window": 3, "height": 24, "width": 40}
    assert metadata["config_sha256"] == "abc"
    assert metadata["units"]["stiffness"].startswith("scene units")
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_runs_where_torch_can_t_be_imported(exported, tmp_path):
    generator, path, _ = exported
    depth = torch.rand(7, 3, *SIZE)
    np.save(tmp_path / "depth.npy", depth.numpy())
    program = f"""
import json, sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("torch", "lightning", "kornia", "mlflow", "matplotlib", "onnx"):
            raise ImportError(name + " is blocked")
sys.meta_path.insert(0, Blocked())
import numpy as np
from models.onnx_session import ParameterModel
model = ParameterModel({str(path)!r})
depth = np.load({str(tmp_path / "depth.npy")!r})
print(json.dumps([model(depth[:batch]).tolist() for batch in (1, 2, 7)]))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    with torch.inference_mode():
        expected = generator.estimate(depth).numpy()
    for batch, theta in zip((1, 2, 7), json.loads(done.stdout), strict=True):
        np.testing.assert_allclose(theta, expected[:batch], atol=1e-5, rtol=0)


def test_a_file_that_differs_from_torch_is_never_left(tmp_path, monkeypatch):
    monkeypatch.setattr("models.onnx_export.parity", lambda estimator, model: 0.01)
    with pytest.raises(ParityError, match=r"differs from torch by 0\.01"):
        export(Generator(width=4, residual_blocks=0), tmp_path / "parameters.onnx", SIZE, {})
    assert list(tmp_path.iterdir()) == []


def test_a_file_tells_no_paths_of_the_machine_that_wrote_it(tmp_path):
    export(Generator(width=4, residual_blocks=0), tmp_path / "parameters.onnx", SIZE, {})
    written = (tmp_path / "parameters.onnx").read_bytes()
    assert b"site-packages" not in written
    assert b"generator.py" not in written
