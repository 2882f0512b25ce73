"""The training step: two generators, two discriminators, three optimisers (Bini 2026, sections 3.4 and 3.5).

Sensor noise on the windows that the networks see is optional, and off by default.
"""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict
from itertools import zip_longest
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

import torch
from kornia.augmentation import RandomGaussianNoise
from lightning.pytorch import LightningModule
from lightning.pytorch.core.optimizer import LightningOptimizer
from lightning.pytorch.strategies import DDPStrategy
from torch import Tensor

from palpate.models import losses
from palpate.models.checkpoint import load_posterior
from palpate.models.discriminator import PatchDiscriminator
from palpate.models.generator import Generator
from palpate.models.losses import LossWeights
from palpate.models.onnx_export import export
from palpate.models.onnx_session import SHIPPED
from palpate.models.records import pair_records
from palpate.models.step import TERMS, Step, precise
from palpate.physics.mechanics import PARAMETERS, Bounds, Mechanics
from palpate.physics.msd.batch import PairBatch

Own = TypeVar("Own")


class TrainingDiverged(ValueError):
    """Error: a loss is not finite."""


class PhysicsInformedGAN(LightningModule):
    """CycleGAN over depth maps whose condition θ = [k_s, k_d, F] also drives a mass-spring-damper rollout.

    G_AB predicts forward in time (A = frame t, B = frame t+1), G_BA backward. No label enters: θ is learnt from the
    next depth map and from the contact's observed displacement. Defaults are the paper's.

    `load_from_checkpoint(path)` gives a trained one. With a mixed precision the convolutions alone run in 16 bits.

    Args:
        window: frames in the input window, K.
        width: channels of the networks' first layer.
        residual_blocks: residual blocks of each decoder.
        decoder: direct (paper): the next depth map from features and θ alone. physics: from the current one carried
            along by the rollout of θ.
        head: parameters (paper): θ from the window, trained by the squared displacement error. posterior: θ with its
            covariance from the contact's motion and the window, trained by the evidence bound.
        contact_features: length of the contact's vector, for head posterior; train.py takes it from the data.
        pretrained: weights of head posterior, loaded before training, that configs/contact.yaml trained or
            `palpate.estimators.network.calibration` exported; shipped: those of the program.
        pretrained_rate: share of `learning_rate` at which pretrained heads are trained on; 0 keeps them as they are.
        bounds: admissible box of θ.
        mechanics: constants of the rollout.
        weights: λ of the five loss terms; a term of weight 0 is not computed, and without gan no discriminator trains.
        noise: standard deviation of Gaussian noise on valid pixels of the networks' windows in training [scene units];
            the losses' depth maps have none.
        learning_rate: Adam's rate, for all three optimisers.
        betas: Adam's momentum coefficients.
    """

    CHECKPOINTS: ClassVar[list[dict[str, Any]]] = [
        {"filename": "best", "monitor": "val/physics", "save_on_train_epoch_end": True},
        {"filename": "epoch_{epoch:03d}", "every_n_epochs": 10, "save_top_k": -1, "save_on_train_epoch_end": True},
        {"filename": "last", "every_n_epochs": 1, "save_on_train_epoch_end": True},
    ]
    """Arguments of Lightning's ModelCheckpoint (Bini 2026, section 3.5). `last` isn't `save_last`, which would follow
    the best one only, and comes last because it holds the others' state."""
    REFUSED: ClassVar[dict[str, tuple[tuple, str]]] = {
        "gradient_clip_val": ((None, 0), "three optimisers step by hand; lower model.learning_rate instead"),
        "accumulate_grad_batches": ((1,), "three optimisers step by hand; raise data.loading.batch_size instead"),
        "precision": (
            (None, "32", 32, "32-true", "16", 16, "16-mixed", "bf16", "bf16-mixed"),
            "rollouts are in 32 bits; give 32-true, or bf16-mixed, which has 16 bits in the convolutions alone",
        ),
        "strategy": (
            ("auto", "ddp", "ddp_find_unused_parameters_true"),
            "three optimisers step in turn, and files are written by the first process; give auto or ddp",
        ),
    }
    """Allowed values of the trainer's options, and the reason."""

    def __init__(
        self,
        window: int = 1,
        width: int = 64,
        residual_blocks: int = 9,
        decoder: Literal["direct", "physics"] = "direct",
        head: Literal["parameters", "posterior"] = "parameters",
        contact_features: int = 0,
        pretrained: str | None = None,
        pretrained_rate: float = 0.1,
        bounds: Bounds = Bounds(),  # noqa: B008 (frozen)
        mechanics: Mechanics = Mechanics(),  # noqa: B008
        weights: LossWeights = LossWeights(),  # noqa: B008
        noise: float = 0.0,
        learning_rate: float = 2e-4,
        betas: tuple[float, float] = (0.5, 0.999),
    ) -> None:
        super().__init__()
        bounds, mechanics = _settings(Bounds, bounds), _settings(Mechanics, mechanics)
        weights = _settings(LossWeights, weights)
        if not (learning_rate > 0 and all(0 <= beta < 1 for beta in betas)):
            raise ValueError(
                f"learning_rate is {learning_rate} and betas {list(betas)}; give a positive rate and betas in [0, 1)."
            )
        if not 0 <= noise < math.inf:
            raise ValueError(f"noise is {noise}; give 0 or more.")
        if pretrained is not None and head != "posterior":
            raise ValueError(f"pretrained is {pretrained} and head {head}; it holds weights of head posterior.")
        if not 0 <= pretrained_rate <= 1:
            raise ValueError(f"pretrained_rate is {pretrained_rate}; give a share of learning_rate in [0, 1].")
        shape: dict[str, Any] = {"width": width, "residual_blocks": residual_blocks, "decoder": decoder, "head": head}
        shape["contact_features"] = contact_features
        groups = {"bounds": bounds, "mechanics": mechanics, "weights": weights}
        # Plain values only: a checkpoint must load without running code.
        plain = {name: asdict(settings) for name, settings in groups.items()}
        rates = {"noise": noise, "learning_rate": learning_rate, "betas": list(betas)}
        self.save_hyperparameters({"window": window, **shape, **plain, **rates})
        self.automatic_optimization = False
        self.bounds, self.mechanics, self.weights = bounds, mechanics, weights
        self.learning_rate, self.betas = learning_rate, betas
        self.pretrained, self.pretrained_rate = pretrained, pretrained_rate
        self.generator_ab, self.generator_ba = (Generator(window, bounds=bounds, **shape) for _ in range(2))
        self.discriminator_a = PatchDiscriminator(width)
        self.discriminator_b = PatchDiscriminator(width)
        self.noise = RandomGaussianNoise(std=noise, p=1.0) if noise else None
        self.test_records: list[dict[str, Any]] = []
        """One record a test pair; see `models.records.pair_records`."""
        self._theta: dict[str, list[Tensor]] = {"train": [], "val": []}
        self._validated: list[Tensor] = []

    def setup(self, stage: str) -> None:
        """Let several processes look for parameters without gradient, as each backward pass has some."""
        if isinstance(self.trainer.strategy, DDPStrategy):
            self.trainer.strategy._ddp_kwargs["find_unused_parameters"] = True

    def on_fit_start(self) -> None:
        """Load the pretrained head, unless training resumes from a checkpoint.

        Raises:
            CheckpointError: the file is missing, holds no contact posterior, or was trained with another box.
        """
        if self.pretrained is not None and self.trainer.ckpt_path is None:
            path = SHIPPED if self.pretrained == "shipped" else Path(self.pretrained)
            for generator in (self.generator_ab, self.generator_ba):
                load_posterior(generator.posterior, path)

    def on_train_start(self) -> None:
        """Set the configuration's rates in place of a checkpoint's."""
        for optimizer, chosen in zip(self.trainer.optimizers, self.configure_optimizers(), strict=True):
            for group, wanted in zip(optimizer.param_groups, chosen.param_groups, strict=True):
                group.update(lr=wanted["lr"], betas=wanted["betas"])

    def configure_optimizers(self) -> list[torch.optim.Optimizer]:
        """One Adam for both generators, one for each discriminator (Bini 2026, section 3.5).

        A pretrained head starts near its optimum, where the gradient of a small batch is mostly noise. Adam's steps do
        not shrink with the gradient, so it has a smaller rate (`pretrained_rate`). Its projection of the picture is new
        and learns at the full rate.
        """
        generators: list[Any] = [*self.generator_ab.parameters(), *self.generator_ba.parameters()]
        if self.pretrained is not None:
            posteriors = self.generator_ab.posterior, self.generator_ba.posterior
            named = [pair for each in posteriors for pair in each.named_parameters()]
            heads = [values for name, values in named if not name.startswith("picture.")]  # files lack those
            known = {id(parameter) for parameter in heads}
            generators = [
                {"params": [parameter for parameter in generators if id(parameter) not in known]},
                {"params": heads, "lr": self.pretrained_rate * self.learning_rate},
            ]
        groups = (generators, self.discriminator_a.parameters(), self.discriminator_b.parameters())
        return [torch.optim.Adam(group, lr=self.learning_rate, betas=self.betas) for group in groups]

    def generator_losses(self, batch: PairBatch) -> tuple[dict[str, Tensor], Step]:
        """Unweighted terms of a batch by the names of their weights, scalars, and the quantities behind them."""
        windows = batch.a.window, batch.b.window
        step = Step(self, batch, [self._augmented(window, direction) for direction, window in enumerate(windows)])
        return step.terms(self.weights), step

    def training_step(self, batch: PairBatch, batch_index: int) -> None:
        """One step of the generators, then one of each discriminator (Bini 2026, section 3.4.3)."""
        optimizer_g, *judging = self.optimizers()  # ty: ignore[not-iterable]  there are three

        self.toggle_optimizer(optimizer_g)  # freezes both discriminators
        terms, step = self.generator_losses(batch)
        self._step(optimizer_g, losses.total(terms, self.weights), batch)
        self.untoggle_optimizer(optimizer_g)

        values = {name: value.detach() for name, value in terms.items()}
        pairs = len(batch.clips)
        self.log_dict(values, prog_bar=True, logger=False, batch_size=pairs)
        if self.weights.gan:
            for side, optimizer, fake in zip("ab", judging, (step.ba.fake, step.ab.fake), strict=True):
                values[f"discriminator_{side}"] = self._judge(side, optimizer, fake, batch)
        self._theta["train"].append(step.ab.answer.theta.detach())
        averages = {f"train/{name}": value for name, value in values.items()}
        self.log_dict(averages, on_step=False, on_epoch=True, batch_size=pairs, sync_dist=True)

    def validation_step(self, batch: PairBatch, batch_index: int) -> None:
        """L_physics in both directions, which chooses the best checkpoint (Bini 2026, section 3.5).

        Squared displacements [scene units²] with head parameters, the negative evidence bound [nats] with posterior.
        """
        step = Step(self, batch)
        self._validated += [TERMS["physics"](step)] * len(batch.clips)
        self._theta["val"].append(step.ab.answer.theta)

    def test_step(self, batch: PairBatch, batch_index: int) -> None:
        """Collect `test_records`."""
        with precise(self.device):
            self.test_records += pair_records(batch, self.generator_ab, self.mechanics)

    def on_train_epoch_end(self) -> None:
        self._log_theta("train")

    def on_validation_epoch_end(self) -> None:
        """Log L_physics: the mean over all pairs, of which processes may have unequal numbers."""
        self._log_theta("val")
        if self._validated:
            physics = torch.cat(self._of_all(torch.stack(self._validated).cpu()))
            self._validated.clear()
            self.log("val/physics", physics.mean(), prog_bar=True, sync_dist=True)

    def on_test_epoch_start(self) -> None:
        self.test_records.clear()

    def on_test_epoch_end(self) -> None:
        """Join the records of all processes, in one process's order, and log their mean errors."""
        turns = zip_longest(*self._of_all(self.test_records))  # the sampler deals the pairs out in turn
        self.test_records = [record for turn in turns for record in turn if record is not None]
        for name in ("error_predicted", "error_reference", "next_depth_error", "copy_error"):
            mean = sum(record[name] for record in self.test_records) / len(self.test_records)
            self.log(f"test/{name}", mean, sync_dist=True)

    def export(self, output: Path, datamodule: Any, configuration: str = "") -> str:
        """Write encoder and parameter head as one ONNX file for infer.py.

        Args:
            output: file to write.
            datamodule: source of the preparation settings in the file's metadata.
            configuration: text of the training's configuration, whose hash goes into the metadata.

        Returns:
            A sentence that names the file and the largest difference of its output from torch's.
        """
        metadata = {name: self.hparams[name] for name in ("bounds", "mechanics")} | datamodule.metadata()
        metadata["config_sha256"] = hashlib.sha256(configuration.encode()).hexdigest()
        geometry, generator = metadata["geometry"], self.generator_ab
        size = {"window": generator.channels, "height": geometry["height"], "width": geometry["width"]}
        difference = export(generator, output, metadata | {"input": size})
        return f"{output}: written; largest difference from torch over batches of 1, 2 and 7 is {difference:.1e}"

    def _log_theta(self, stage: str) -> None:
        """Log mean and standard deviation of θ_AB over the epoch's pairs; a spread near 0 shows a collapse."""
        if not self._theta[stage]:
            return
        theta = torch.cat(self._of_all(torch.cat(self._theta[stage]).cpu()))
        self._theta[stage].clear()
        for name, values in zip(PARAMETERS, theta.T, strict=True):
            self.log(f"{stage}/{name}_mean", values.mean(), sync_dist=True)
            self.log(f"{stage}/{name}_sd", values.std(correction=0), sync_dist=True)

    def _of_all(self, own: Own) -> list[Own]:
        """An object of every process, in the order of their ranks."""
        parts = [own] * self.trainer.world_size
        if len(parts) > 1:
            torch.distributed.all_gather_object(parts, own)
        return parts

    def _judge(self, side: str, optimizer: LightningOptimizer, fake: Tensor, batch: PairBatch) -> Tensor:
        """Train the discriminator of a side by one step and return its loss, detached."""
        discriminator, real = getattr(self, f"discriminator_{side}"), getattr(batch, side).window[:, -1:]
        self.toggle_optimizer(optimizer)
        loss = losses.discriminator_loss(discriminator(real), discriminator(fake.detach()))
        self._step(optimizer, loss, batch)
        self.untoggle_optimizer(optimizer)
        return loss.detach()

    def _augmented(self, window: Tensor, direction: int) -> Tensor:
        """The window [B, K, H, W] with the noise of training, its invalid pixels (0) as they are.

        The seed follows the step, and the global random state doesn't change, so that resuming is exact.
        """
        if self.noise is None:
            return window
        step = self.global_step if self._trainer is not None else 0
        with torch.random.fork_rng(devices=[window.device] if window.device.type == "cuda" else []):
            torch.manual_seed((2 * step + direction) * 1009 + self.global_rank)
            return self.noise(window).clamp(0.0, 1.0) * (window > 0)

    def _step(self, optimizer: LightningOptimizer, loss: Tensor, batch: PairBatch) -> None:
        """One step down the loss.

        Raises:
            TrainingDiverged: the loss is not finite, here or in another process, which would wait for this one.
        """
        finite = bool(torch.isfinite(loss))
        if not self.trainer.strategy.reduce_boolean_decision(finite):
            if finite:
                raise TrainingDiverged("the loss of another process is not finite; it says where, and what to do.")
            frames = [f"{clip} frame {int(frame)}" for clip, frame in zip(batch.clips, batch.frames, strict=True)]
            raise TrainingDiverged(
                f"the loss is {float(loss.detach())} in epoch {self.current_epoch} at {' and '.join(frames)}; lower "
                "model.learning_rate or narrow model.bounds, and resume from the last checkpoint."
            )
        optimizer.zero_grad()
        self.manual_backward(loss)
        optimizer.step()


def _settings(kind: type[Own], given: Own | Mapping[str, Any]) -> Own:
    """Settings, if need be from the plain values of a checkpoint."""
    return kind(**given) if isinstance(given, Mapping) else given
