"""Training the posterior by light: it learns what sequences tell, goes on from its drawn ones, and is calibrated."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from palpate.command import train
from palpate.common.files import file_sha256
from palpate.data.contact.features import FEATURES
from palpate.data.contact.light_features import LIGHT_FEATURES
from palpate.estimators.network import light_training
from palpate.estimators.network.light_calibration import QUANTITIES, main
from palpate.estimators.network.light_draws import LightDraws, draw_light
from palpate.estimators.network.light_training import DRAWN, WEIGHTS, Disturbed, light_loss, new_light_posterior
from palpate.estimators.network.training import descend
from palpate.models.calibration import LightCalibration
from palpate.models.calibration_fit import fit_light
from palpate.models.onnx_export import calibrate_light
from palpate.models.onnx_session import PosteriorModel

FIT = ["fit", "-c", "configs/light.yaml", "--light.sheets=1", "--light.steps=4", "--light.workers=0", "--light.output"]


@pytest.fixture(scope="module")
def draws() -> LightDraws:
    return LightDraws.joined([part for part in map(draw_light, range(3)) if part is not None])


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("light")
    assert train.main([*FIT, str(folder)]) == 0
    return folder


def test_batches_are_disturbed_anew_and_keep_their_parameters(draws: LightDraws) -> None:
    one, other = Disturbed(draws, 0), Disturbed(draws, 0)
    (vectors, logs), (same, _) = one(16), other(16)
    torch.testing.assert_close(vectors, same)
    assert torch.isfinite(vectors).all()
    assert not torch.equal(one(16)[0], vectors)
    known = {tuple(row) for row in draws.logs.astype(np.float32).tolist()}
    assert {tuple(row) for row in logs.tolist()} <= known


def test_training_lowers_the_loss_of_what_it_saw(draws: LightDraws) -> None:
    torch.manual_seed(0)
    posterior, batches = new_light_posterior(), Disturbed(draws, 0)
    posterior.standardise(batches(256)[0])
    losses = list(descend(posterior, lambda _: light_loss(posterior, batches(128)), 60, 1e-3))
    assert np.mean(losses[-5:]) < np.mean(losses[:5]) - 1


def test_training_keeps_its_sequences_until_it_is_done(tmp_path: Path, monkeypatch, trained: Path) -> None:
    assert {WEIGHTS, DRAWN} & {path.name for path in trained.iterdir()} == {WEIGHTS}

    def broken(*_):
        raise KeyboardInterrupt

    command = [*FIT, str(tmp_path)]
    with monkeypatch.context() as patch:
        patch.setattr(light_training, "light_loss", broken)
        assert train.main(command) == 130
    assert {WEIGHTS, DRAWN} & {path.name for path in tmp_path.iterdir()} == {DRAWN}
    monkeypatch.setattr(light_training, "draw_light", broken)
    assert train.main(command) == 0
    first, second = (torch.load(folder / WEIGHTS, weights_only=True) for folder in (trained, tmp_path))
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert train.main(command) == 2  # a finished training isn't replaced


def test_the_posterior_by_light_is_added_and_calibrated_within_the_file(tmp_path, posterior, trained, capsys) -> None:
    bare, plain, output = posterior.path, tmp_path / "plain.onnx", tmp_path / "calibrated.onnx"
    assert main(["--model", str(bare), "--light", str(trained / WEIGHTS), "--output", str(plain)]) == 0
    contact = np.random.default_rng(0).normal(size=(2, FEATURES)).astype(np.float32)
    for one, other in zip(PosteriorModel(bare)(contact), PosteriorModel(plain)(contact), strict=True):
        np.testing.assert_array_equal(one, other)
    # Errors of 0.5 around a mean where the network states 0.3: 0.16 are added to every quantity's variance.
    errors = np.random.default_rng(1).normal((0.2, 0.0, -0.3), 0.5, (4000, 3))
    results = tmp_path / "results"
    results.mkdir()
    (results / "run.json").write_text(json.dumps({"model_sha256": file_sha256(plain)}))
    rows = [{"explained": 1} | {f"{name}_sd": 0.3 for name in QUANTITIES} for _ in errors]
    for row, found in zip(rows, errors.tolist(), strict=True):
        row |= {f"{name}_error": error for name, error in zip(QUANTITIES, found, strict=True)}
    (results / "results.jsonl").write_text("\n".join(map(json.dumps, rows)))
    assert main(["--model", str(plain), "--results", str(results), "--output", str(output)]) == 0
    light = np.zeros((1, LIGHT_FEATURES), np.float32)
    (mean, covariance), (same, before) = (PosteriorModel(path).by_light(light) for path in (output, plain))
    np.testing.assert_allclose((same - mean)[0], (0.2, 0.2, -0.1), atol=0.04)
    added = (covariance - before)[0]
    # log k_d is log k_s and the ratio's logarithm, so that its variance takes both.
    np.testing.assert_allclose(added, 0.16 * np.array([[1, 1, 1], [1, 2, 1], [1, 1, 2]]), atol=0.03)
    capsys.readouterr()
    with pytest.raises(ValueError, match="no uncalibrated posterior by light"):
        calibrate_light(output, tmp_path / "no.onnx", LightCalibration())
    for arguments, said in (
        (["--model", str(bare), "--results", str(results)], "was not made with"),
        (["--model", str(plain), "--light", str(trained / WEIGHTS)], "has a posterior by light already"),
    ):
        assert main([*arguments, "--output", str(tmp_path / "no.onnx")]) == 1
        assert said in capsys.readouterr().err
    assert not (tmp_path / "no.onnx").exists()


def test_few_videos_do_not_calibrate() -> None:
    with pytest.raises(ValueError, match="needs 40 or more"):
        fit_light(np.zeros((39, 3)), np.ones((39, 3)))
