"""Checkpoints that can't be used get a sentence, and none is followed into another network."""

import os
import pickle
import zipfile
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch

from palpate.data.contact.features import FEATURES
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES
from palpate.models import checkpoint as checkpoints
from palpate.models.module import PhysicsInformedGAN
from palpate.models.onnx_session import SHIPPED, PosteriorModel
from palpate.models.posterior import ContactPosterior
from palpate.physics.mechanics import RECOMMENDED, Bounds, Mechanics

SETTINGS = {"window": 1, "width": 4, "residual_blocks": 1, "decoder": "direct", "head": "parameters"}
SETTINGS |= {"bounds": asdict(Bounds()), "mechanics": asdict(Mechanics(steps=40, load_steps=10))}


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    module = PhysicsInformedGAN(width=4, residual_blocks=1, mechanics=Mechanics(steps=40, load_steps=10))
    path = tmp_path / "last.ckpt"
    whole = {"state_dict": module.state_dict(), "hyper_parameters": dict(module.hparams), "callbacks": {}}
    torch.save(whole | {"pytorch-lightning_version": "2.6.6"}, path)
    return path


def test_the_same_model_passes_and_where_it_starts_does_not_matter(checkpoint: Path):
    checkpoints.require_same_model(checkpoint, SETTINGS)
    checkpoints.require_same_model(checkpoint, SETTINGS | {"bounds": asdict(Bounds(initial=(0.2, 0.2, -1.0)))})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 8}, r"model\.width = 4 and the configuration says 8"),
        ({"decoder": "physics"}, r"model\.decoder = direct"),
        ({"head": "posterior"}, r"model\.head = parameters and the configuration says posterior"),
        ({"window": 2}, r"model\.window = 1"),
        ({"bounds": asdict(Bounds(force=(-6.0, 0.0)))}, r"model\.bounds\.force = \[-10\.0, 0\.0\]"),
        ({"mechanics": asdict(Mechanics(steps=60, load_steps=10))}, r"model\.mechanics\.steps = 40"),
    ],
)
def test_another_model_is_refused_by_name(checkpoint: Path, change: dict, message: str):
    with pytest.raises(checkpoints.CheckpointError, match=message):
        checkpoints.require_same_model(checkpoint, SETTINGS | change)


def test_unusable_files(checkpoint: Path, tmp_path: Path):
    with pytest.raises(checkpoints.CheckpointError, match="does not exist"):
        checkpoints.read_checkpoint(tmp_path / "nothing.ckpt")
    broken = tmp_path / "broken.ckpt"
    whole = checkpoint.read_bytes()
    flipped = bytes(byte ^ 255 for byte in whole)
    for content in (b"", b"not a checkpoint", whole[:-1000], whole[: len(whole) // 2], os.urandom(3000), flipped):
        broken.write_bytes(content)
        with pytest.raises(checkpoints.CheckpointError, match="not a readable checkpoint"):
            checkpoints.read_checkpoint(broken)
    for foreign in ({"weights": torch.zeros(2)}, {"state_dict": {}, "hyper_parameters": 3}, {"state_dict": 3}):
        torch.save(foreign, broken)
        with pytest.raises(checkpoints.CheckpointError, match="another program"):
            checkpoints.read_checkpoint(broken)
    good = torch.load(checkpoint, weights_only=True)
    for wrong in ({"callbacks": 5}, {checkpoints.VERSION: 5}):  # Lightning fails with
        torch.save(good | wrong, broken)
        with pytest.raises(checkpoints.CheckpointError, match="another program"):
            checkpoints.read_checkpoint(broken)
    torch.save(good | {"hyper_parameters": good["hyper_parameters"] | {"bounds": "x"}}, broken)
    with pytest.raises(checkpoints.CheckpointError, match=r"model\.bounds\.stiffness = None"):
        checkpoints.require_same_model(broken, SETTINGS)


def test_files_damaged_inside(checkpoint: Path, tmp_path: Path):
    """Whatever part of one is garbage, cut short or gone, the sentence is the same."""
    with zipfile.ZipFile(checkpoint) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    (pickled,) = (name for name in parts if name.endswith("/data.pkl"))
    root, damaged = pickled.rpartition("/")[0], tmp_path / "damaged.ckpt"
    noise = np.random.default_rng(0)
    changes = [
        {pickled: content}
        for content in (None, b"", parts[pickled][:-100], parts[pickled][: len(parts[pickled]) // 2], noise.bytes(900))
    ]
    changes += [{pickled: b"\x80\x02" + b"]" * 100_000 + b"a" * 99_999 + b"."}]
    changes += [{f"{root}/{name}": content} for name, content in (("version", b"9" * 30), ("byteorder", b"x"))]
    changes += [{name: parts[name][:5] for name in parts if "/data/" in name}, dict.fromkeys(parts)]
    for change in changes:
        with zipfile.ZipFile(damaged, "w") as file:
            for name, content in (parts | change).items():
                if content is not None:
                    file.writestr(name, content)
        with pytest.raises(
            checkpoints.CheckpointError, match=r"damaged\.ckpt is not a readable checkpoint; give one that"
        ):
            checkpoints.read_checkpoint(damaged)


BOX = torch.from_numpy(Bounds((0.05, 1.0), (0.005, 0.5), (-0.3, -0.01), (0.4, 0.08, -0.1)).log_box)


@pytest.fixture
def pretrained(tmp_path: Path) -> tuple[Path, ContactPosterior]:
    """A file as `palpate.estimators.network.training` writes it, and what it was written from."""
    torch.manual_seed(1)
    posterior = ContactPosterior(7, BOX)
    posterior.standardise(torch.randn(20, 7))
    torch.save(posterior.state_dict(), tmp_path / "posterior.pt")
    return tmp_path / "posterior.pt", posterior


def test_a_pretrained_posterior_answers_as_it_did_with_any_picture(pretrained):
    path, trained = pretrained
    torch.manual_seed(2)
    posterior = ContactPosterior(7, BOX, picture=16)
    contact, picture = torch.randn(3, 7), torch.randn(3, 16)
    assert not torch.allclose(posterior(contact, picture)[0], trained(contact)[0])
    checkpoints.load_posterior(posterior, path)
    for value, expected in zip(posterior(contact, picture), trained(contact), strict=True):
        assert torch.equal(value, expected)


def test_the_shipped_posterior_is_taken_over_as_it_was_exported() -> None:
    """The mean is the file's; the covariance is what it was before it was calibrated."""
    posterior = ContactPosterior(FEATURES + SEQUENCE_FEATURES, torch.from_numpy(RECOMMENDED.log_box))
    checkpoints.load_posterior(posterior, SHIPPED)
    contact = posterior.centre + posterior.scale * torch.randn(5, len(posterior.centre))
    mean, _, bound = PosteriorModel(SHIPPED)(contact.numpy())
    with torch.no_grad():
        found, factor = posterior.eval()(contact)[0], posterior.expected_bound_factor(contact)
    np.testing.assert_allclose(found, mean, atol=1e-5)
    np.testing.assert_allclose(factor @ factor.mT, bound, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("content", [b"", b"nothing of the kind"])
def test_an_exported_posterior_that_is_none_gets_a_sentence(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.onnx"
    posterior = ContactPosterior(7, BOX)
    with pytest.raises(checkpoints.CheckpointError, match=r"other\.onnx can't be read"):
        checkpoints.load_posterior(posterior, path)
    path.write_bytes(content)
    with pytest.raises(checkpoints.CheckpointError, match=r"other\.onnx is no exported contact posterior; give one"):
        checkpoints.load_posterior(posterior, path)
    with pytest.raises(checkpoints.CheckpointError, match="holds no contact posterior of this version"):
        checkpoints.load_posterior(posterior, SHIPPED)


def test_a_pretrained_posterior_must_fit(pretrained, checkpoint: Path, tmp_path: Path):
    path, _ = pretrained
    torch.save({"entry.weight": [1, 2]}, tmp_path / "list.pt")
    with pytest.raises(
        checkpoints.CheckpointError, match=r"nothing\.pt does not exist; give a file that train.py fit -c"
    ):
        checkpoints.load_posterior(ContactPosterior(7, BOX), tmp_path / "nothing.pt")
    for foreign in (checkpoint, tmp_path / "list.pt"):
        with pytest.raises(checkpoints.CheckpointError, match="holds no contact posterior of this version"):
            checkpoints.load_posterior(ContactPosterior(7, BOX), foreign)
    with pytest.raises(checkpoints.CheckpointError, match="holds no contact posterior of this version"):
        checkpoints.load_posterior(ContactPosterior(8, BOX), path)
    torch.save([1, 2], tmp_path / "list.pt")
    with pytest.raises(checkpoints.CheckpointError, match="not a readable checkpoint"):
        checkpoints.load_posterior(ContactPosterior(7, BOX), tmp_path / "list.pt")
    wider = BOX.clone()
    wider[1, 2] = torch.log(torch.tensor(0.6))
    with pytest.raises(
        checkpoints.CheckpointError, match=r"upper bounds .* 1, 0\.5, 0\.3, and model\.bounds say 1, 0\.5, 0\.6"
    ):
        checkpoints.load_posterior(ContactPosterior(7, wider), path)


class Evil:
    """Unpickled as usual, it would end the process."""

    def __reduce__(self) -> tuple:
        return os._exit, (7,)


def test_a_pickle_that_runs_code_is_refused_and_nothing_else_is_said(tmp_path, recwarn):
    with zipfile.ZipFile(tmp_path / "evil.ckpt", "w") as archive:
        archive.writestr("archive/data.pkl", pickle.dumps(Evil()))
        archive.writestr("archive/version", "3")
    with pytest.raises(checkpoints.CheckpointError, match=r"evil\.ckpt is not a readable checkpoint"):
        checkpoints.read_checkpoint(tmp_path / "evil.ckpt")
    assert not recwarn
