"""The instrument network learns, and its exported form is the same."""

import math
from pathlib import Path

import onnx
import onnxruntime
import pytest
import torch
from lightning.pytorch import Trainer
from torch.utils.data import DataLoader, TensorDataset

from palpate.data.training.instruments.datamodule import InstrumentData
from palpate.models.checkpoint import CheckpointError
from palpate.models.instruments.module import InstrumentSegmentation, PictureBatch, segmentation_loss
from palpate.models.instruments.network import COARSE, FROZEN, SURE, InstrumentNet, TwoLooks


def batch(count: int = 4) -> tuple[torch.Tensor, torch.Tensor]:
    """Pictures whose bright half is instrument."""
    picture = 0.2 * torch.rand(count, 3, 64, 96, generator=torch.Generator().manual_seed(0))
    tool = torch.zeros(count, 64, 96, dtype=torch.int64)
    tool[:, :, 48:] = 1
    picture[:, :, :, 48:] += 0.6
    return picture, tool


def test_loss_is_the_closed_form_of_sure_and_unsure_answers():
    picture, tool = batch(1)
    target = torch.nn.functional.avg_pool2d(tool.float()[:, None], 2)
    right = 40 * (2 * target - 1)
    assert segmentation_loss(right, PictureBatch(picture, tool), 3.0) == pytest.approx(0, abs=1e-3)
    unsure = torch.zeros_like(right)
    # log 2 from the entropy, and Dice of a half everywhere.
    dice = 1 - (target.sum() + 30) / (0.5 * target.numel() + target.sum() + 30)
    found = segmentation_loss(unsure, PictureBatch(picture, tool), 3.0)
    assert found.item() == pytest.approx(0.6931472 + dice.item(), rel=1e-5)


def test_pixels_that_nobody_labelled_do_not_count():
    picture, tool = batch(1)
    logits = torch.randn(1, 1, 32, 48, generator=torch.Generator().manual_seed(1))
    tool[:, :, :24] = 255
    before = segmentation_loss(logits, PictureBatch(picture, tool), 1.0)
    changed = logits.clone()
    changed[:, 0, :, :12] += 5.0
    assert segmentation_loss(changed, PictureBatch(picture, tool), 1.0) == pytest.approx(before.item(), rel=1e-6)


def trained(folder: Path) -> tuple[InstrumentSegmentation, float]:
    """A network after a few steps, and its IoU."""
    torch.manual_seed(0)
    module = InstrumentSegmentation(average=0.5, learning_rate=3e-3)
    trainer = Trainer(max_steps=24, logger=False, enable_checkpointing=False, enable_progress_bar=False,
                      enable_model_summary=False, default_root_dir=folder, accelerator="cpu")  # fmt: skip
    data = TensorDataset(*(torch.cat([each] * 40) for each in batch()))
    trainer.fit(module, DataLoader(data, 4), DataLoader(TensorDataset(*batch()), 4))
    [found] = trainer.validate(module, DataLoader(TensorDataset(*batch()), 4), verbose=False)
    return module, found["val/iou"]


@pytest.mark.slow
def test_training_learns(tmp_path):
    assert trained(tmp_path)[1] > 0.8


@pytest.mark.slow
def test_the_exported_file_agrees(tmp_path):
    file, data = tmp_path / "instruments.onnx", InstrumentData(validation=6, batch_size=2, size=(96, 160))
    assert "written in 8-bit numbers" in trained(tmp_path)[0].export(file, data)
    again = TwoLooks(InstrumentSegmentation(weights=file.with_suffix(".pt")).network.eval())
    picture = next(iter(data.val_dataloader()))[0]
    with torch.inference_mode():
        expected = again(picture).numpy()
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    found = session.run(None, {"picture": picture.numpy()})[0]
    assert ((found > 0) == (expected > 0)).mean() > 0.98  # in 8-bit numbers
    weights = [entry.raw_data for entry in onnx.load(file).graph.initializer if len(entry.raw_data) > 1e4]
    assert len(set(weights)) == len(weights) > 10  # both looks share them


def test_a_pretrained_encoder_keeps_its_first_stages_and_its_statistics(tmp_path):
    torch.manual_seed(0)
    given = InstrumentNet().encoder.state_dict()
    torch.save(
        {f"_{name}": weight for name, weight in given.items()} | {"_fc.bias": torch.zeros(9)}, tmp_path / "a.pth"
    )
    module = InstrumentSegmentation(backbone=tmp_path / "a.pth")
    module.train()
    segmentation_loss(module.network(batch(2)[0]), PictureBatch(*batch(2)), 3.0).backward()
    with torch.no_grad():
        for weights in module.parameters():
            if weights.grad is not None:
                weights -= 0.1 * weights.grad
    changed = {name for name, weight in module.network.encoder.state_dict().items() if not weight.equal(given[name])}
    assert changed
    assert {int(name[0]) for name in changed} == {FROZEN + 1, FROZEN + 2, FROZEN + 3, FROZEN + 4}
    assert not [name for name in changed if "running" in name]
    with pytest.raises(CheckpointError, match=r"b\.pth holds no such weights"):
        InstrumentSegmentation(weights=tmp_path / "b.pth")


def test_output_has_half_the_size():
    assert InstrumentNet()(torch.zeros(2, 3, 64, 96)).shape == (2, 1, 32, 48)


@pytest.mark.parametrize(("fine", "coarse"), [(2.0, 5.0), (5.0, 2.0)])
def test_an_instrument_is_what_one_look_of_two_is_sure_of(fine, coarse):
    def network(picture: torch.Tensor) -> torch.Tensor:
        height, width = picture.shape[2:]
        return torch.full((1, 1, height // 2, width // 2), coarse if (height, width) == COARSE else fine)

    found = TwoLooks(network)(torch.zeros(1, 3, 224, 384))
    assert found.shape == (1, 1, 112, 192)
    torch.testing.assert_close(found, torch.full_like(found, 5.0 - math.log(SURE / (1 - SURE))))
