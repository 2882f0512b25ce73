"""The training step: two generators, two discriminators, three optimisers (Bini 2026, sections 3.4 and 3.5).

Sensor noise on the windows that the networks see is optional, and off by default.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal, TypeVar

import torch
from kornia.augmentation import RandomGaussianNoise
from lightning.pytorch import LightningModule
from lightning.pytorch.core.optimizer import LightningOptimizer
from torch import Tensor

from palpate.models import losses
from palpate.models.carried_depth import change_of, shifted
from palpate.models.checkpoint import load_posterior
from palpate.models.discriminator import PatchDiscriminator
from palpate.models.evidence import bound_loss
from palpate.models.generator import Generator, HeadOutput
from palpate.models.losses import LossWeights
from palpate.models.onnx_session import SHIPPED
from palpate.models.records import pair_records
from palpate.physics.mechanics import PARAMETERS, Bounds, Mechanics

UNTRAINED = "picture.weight", "picture.bias"
"""Parameters of a pretrained posterior that its file does not hold."""
TEST_ERRORS = ("error_predicted", "error_reference", "next_depth_error", "copy_error")
"""Errors of `models.records.pair_records`, those whose means are logged."""
Own = TypeVar("Own")


class TrainingDiverged(ValueError):
    """A loss is no longer a finite number."""


def with_current(window: Tensor, frame: Tensor) -> Tensor:
    """Window [B, K, H, W] whose last (current) frame is replaced by [B, 1, H, W]."""
    return torch.cat([window[:, :-1], frame], dim=1)


class PhysicsInformedGAN(LightningModule):
    """CycleGAN over depth maps whose condition θ = [k_s, k_d, F] also drives a mass-spring-damper rollout.

    G_AB predicts forward in time (A = frame t, B = frame t+1), G_BA backward. No label enters: θ is learnt from the
    next depth map and from the contact's observed displacement. Defaults are the paper's.

    `load_from_checkpoint(path)` gives a trained one. With a mixed precision the convolutions alone run in 16 bits.

    Args:
        window: frames in the input window, K.
        width: channels of the networks' first layer.
        residual_blocks: residual blocks of each decoder.
        decoder: direct (paper): the next depth map from features and θ alone; physics: as a change of the current one
            carried along by the rollout of θ.
        head: parameters (paper): θ from the window, trained by the squared displacement error; posterior: θ with its
            covariance from the contact's motion and the window, trained by the evidence bound.
        contact_features: length of the contact's vector, for head posterior; train.py takes it from the data.
        pretrained: weights of head posterior that configs/contact.yaml trained or
            `palpate.estimators.network.calibration` exported, loaded before training; shipped: those that
            come with the program.
        pretrained_rate: share of `learning_rate` at which pretrained heads are trained on; 0 keeps them as they are.
        bounds: admissible box of θ.
        mechanics: constants of the rollout.
        weights: λ of the five loss terms; a term of weight 0 is not computed, and without gan no discriminator trains.
        noise: standard deviation of Gaussian noise on every valid pixel of the windows that enter the networks in
            training [scene units]; the depth maps in the losses stay without it, and 0 is none.
        learning_rate: Adam's rate, for all three optimisers.
        betas: Adam's momentum coefficients.
    """

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
        """Go on with the rates of the configuration, where a checkpoint's optimisers brought those of its own."""
        for optimizer, chosen in zip(self.trainer.optimizers, self.configure_optimizers(), strict=True):
            for group, wanted in zip(optimizer.param_groups, chosen.param_groups, strict=True):
                group.update(lr=wanted["lr"], betas=wanted["betas"])

    def configure_optimizers(self) -> list[torch.optim.Optimizer]:
        """One Adam for both generators, one for each discriminator (Bini 2026, section 3.5).

        A pretrained head starts near its optimum, where the gradient of a small batch is mostly noise. Adam's steps do
        not shrink with the gradient, so that its full rate would carry the head away; see `pretrained_rate`. What takes
        the picture to it is new, and learns at the full rate.
        """
        generators: list[Any] = [*self.generator_ab.parameters(), *self.generator_ba.parameters()]
        if self.pretrained is not None:
            posteriors = self.generator_ab.posterior, self.generator_ba.posterior
            heads = [values for each in posteriors for name, values in each.named_parameters() if name not in UNTRAINED]
            known = {id(parameter) for parameter in heads}
            generators = [
                {"params": [parameter for parameter in generators if id(parameter) not in known]},
                {"params": heads, "lr": self.pretrained_rate * self.learning_rate},
            ]
        groups = (generators, self.discriminator_a.parameters(), self.discriminator_b.parameters())
        return [torch.optim.Adam(group, lr=self.learning_rate, betas=self.betas) for group in groups]

    def generator_losses(self, batch: dict[str, Any]) -> tuple[dict[str, Tensor], tuple[Tensor, Tensor] | None, Tensor]:
        """The unweighted terms by the names of their weights, scalars, both fakes [B, 1, H, W] (none without term gan)
        and θ_AB [B, 3] of a batch.
        """
        weights = self.weights
        real_a, real_b = batch["window_a"][:, -1:], batch["window_b"][:, -1:]
        window_a, window_b = self._augmented(batch["window_a"], 0), self._augmented(batch["window_b"], 1)
        features_a, features_b = self.generator_ab.encode(window_a), self.generator_ba.encode(window_b)
        ab = self._answer(self.generator_ab, features_a, batch, "a")
        ba = self._answer(self.generator_ba, features_b, batch, "b")
        terms, fakes = dict.fromkeys(vars(weights), real_a.new_zeros(())), None
        if weights.gan or weights.cycle:
            change_a, change_b = self._change(ab.theta, batch, "a"), self._change(ba.theta, batch, "b")
            fake_b = self.generator_ab.decode(features_a, ab.theta, shifted(real_a, change_a))
            fake_a = self.generator_ba.decode(features_b, ba.theta, shifted(real_b, change_b))
            if weights.gan:
                fakes = fake_a, fake_b
                judged = self.discriminator_b(fake_b), self.discriminator_a(fake_a)
                terms["gan"] = sum(losses.generator_adversarial_loss(scores) for scores in judged)
            if weights.cycle:
                # The fake takes the current frame's place among the *real* earlier frames of the other direction's
                # window. The own window with the fake appended would show the cycle's target to the network that must
                # find it.
                start_b, start_a = shifted(fake_b, change_b), shifted(fake_a, change_a)
                cycled_a = self.generator_ba.generate(with_current(window_b, fake_b), ba.theta, start_b)
                cycled_b = self.generator_ab.generate(with_current(window_a, fake_a), ab.theta, start_a)
                terms["cycle"] = losses.cycle_loss(cycled_a, real_a, cycled_b, real_b)
        if weights.identity:
            # Without a force the simulator leaves every map as it is.
            unchanged_a = self.generator_ab.decode(features_a, losses.null_parameters(ab.theta), real_a)
            unchanged_b = self.generator_ba.decode(features_b, losses.null_parameters(ba.theta), real_b)
            pairs = (unchanged_a, real_a), (unchanged_b, real_b)
            terms["identity"] = sum(losses.identity_loss(*pair) for pair in pairs)
        if weights.physics:
            terms["physics"] = self._physics(ab, ba, batch)
        if weights.regularisation:
            terms["regularisation"] = sum(losses.regularisation_loss(one.theta, self.bounds) for one in (ab, ba))
        return terms, fakes, ab.theta

    def training_step(self, batch: dict[str, Any], batch_index: int) -> None:
        """One step of the generators, then one of each discriminator (Bini 2026, section 3.4.3)."""
        optimizer_g, *judging = self.optimizers()  # ty: ignore[not-iterable]  there are three

        self.toggle_optimizer(optimizer_g)  # freezes both discriminators
        terms, fakes, theta = self.generator_losses(batch)
        self._step(optimizer_g, losses.total(terms, self.weights), batch)
        self.untoggle_optimizer(optimizer_g)

        values = {name: value.detach() for name, value in terms.items()}
        pairs = len(theta)
        self.log_dict(values, prog_bar=True, logger=False, batch_size=pairs)
        for side, optimizer, fake in zip("ab", judging, fakes or (), strict=False):
            values[f"discriminator_{side}"] = self._judge(side, optimizer, fake, batch)
        self._theta["train"].append(theta.detach())
        averages = {f"train/{name}": value for name, value in values.items()}
        self.log_dict(averages, on_step=False, on_epoch=True, batch_size=pairs, sync_dist=True)

    def validation_step(self, batch: dict[str, Any], batch_index: int) -> None:
        """L_physics in both directions, which chooses the best checkpoint (Bini 2026, section 3.5).

        Squared displacements [scene units²] with head parameters, the negative evidence bound [nats] with posterior.
        """
        ab = self._answer(self.generator_ab, self.generator_ab.encode(batch["window_a"]), batch, "a")
        ba = self._answer(self.generator_ba, self.generator_ba.encode(batch["window_b"]), batch, "b")
        pairs = len(ab.theta)
        physics = self._physics(ab, ba, batch)
        self._validated += [physics] * pairs
        self._theta["val"].append(ab.theta)

    def test_step(self, batch: dict[str, Any], batch_index: int) -> None:
        """Collect `test_records`."""
        with self._precise():
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
        for name in TEST_ERRORS:
            mean = sum(record[name] for record in self.test_records) / len(self.test_records)
            self.log(f"test/{name}", mean, sync_dist=True)

    def _log_theta(self, stage: str) -> None:
        """Log mean and standard deviation of θ_AB over the epoch's pairs: a spread near 0 is the sign of collapse."""
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

    def _precise(self) -> torch.autocast:
        """A context without a mixed precision's 16 bits: they overflow in a rollout, and shift φ visibly."""
        return torch.autocast(self.device.type, enabled=False)

    def _answer(self, generator: Generator, features: Tensor, batch: dict[str, Any], side: str) -> HeadOutput:
        with self._precise():
            return generator.answer(features.to(self.dtype), batch.get(f"contact_features_{side}"))

    def _change(self, theta: Tensor, batch: dict[str, Any], side: str) -> Tensor | None:
        with self._precise():
            return change_of(self.generator_ab.decoder.kind, theta, batch, side, self.mechanics)

    def _physics(self, ab: HeadOutput, ba: HeadOutput, batch: dict[str, Any]) -> Tensor:
        """L_physics in both directions of time (Bini 2026, figure 2)."""
        with self._precise():
            forward = self._physics_of(self.generator_ab, ab, batch, "a")
            return forward + self._physics_of(self.generator_ba, ba, batch, "b")

    def _physics_of(self, generator: Generator, output: HeadOutput, batch: dict[str, Any], side: str) -> Tensor:
        """The squared displacement error of a head's θ, or the negative evidence bound of its posterior.

        The bound counts the frames up to the sample's own, since the posterior had no later ones as input. Unless the
        head is pretrained, the expected bound behind the verdicts is learnt at the same time, from the information at
        the mean: nothing better is known then, and how often such verdicts are right was not measured.
        """
        meshes = batch[f"mesh_{side}"]
        if output.mean is None or output.factor is None:
            loads, observation = batch[f"load_{side}"], batch[f"observation_{side}"]
            return losses.physics_loss(output.theta, meshes, loads, observation, self.mechanics)
        posterior, what = generator.posterior, (meshes, batch[f"known_load_{side}"], batch[f"dent_{side}"])
        box = posterior.lower, posterior.upper
        evidence, information = losses.posterior_physics_loss(output.mean, output.factor, *what, self.mechanics, box)
        if self.pretrained is not None:  # pretraining learnt the bound at better known θ
            return evidence
        expected = posterior.expected_bound_factor(batch[f"contact_features_{side}"])
        error = bound_loss(expected, information.cpu().numpy())
        return evidence + (error - error.detach())  # adds its gradient, and nothing to the value

    def _judge(self, side: str, optimizer: LightningOptimizer, fake: Tensor, batch: dict[str, Any]) -> Tensor:
        """Train the discriminator of a side by one step and return its loss, detached."""
        discriminator, real = getattr(self, f"discriminator_{side}"), batch[f"window_{side}"][:, -1:]
        self.toggle_optimizer(optimizer)
        loss = losses.discriminator_loss(discriminator(real), discriminator(fake.detach()))
        self._step(optimizer, loss, batch)
        self.untoggle_optimizer(optimizer)
        return loss.detach()

    def _augmented(self, window: Tensor, direction: int) -> Tensor:
        """The window [B, K, H, W] with the noise of training, its invalid pixels (0) as they are.

        The seed follows the step, and the global random state is left as it was, so that resuming is exact.
        """
        if self.noise is None:
            return window
        step = self.global_step if self._trainer is not None else 0
        with torch.random.fork_rng(devices=[window.device] if window.device.type == "cuda" else []):
            torch.manual_seed((2 * step + direction) * 1009 + self.global_rank)
            return self.noise(window).clamp(0.0, 1.0) * (window > 0)

    def _step(self, optimizer: LightningOptimizer, loss: Tensor, batch: dict[str, Any]) -> None:
        """One step down the loss.

        Raises:
            TrainingDiverged: the loss is not finite, here or in another process, which would wait for this one.
        """
        finite = bool(torch.isfinite(loss))
        if not self.trainer.strategy.reduce_boolean_decision(finite):
            if finite:
                raise TrainingDiverged("the loss of another process is not finite; it says where, and what to do.")
            frames = [f"{clip} frame {int(frame)}" for clip, frame in zip(batch["clip"], batch["frame"], strict=True)]
            raise TrainingDiverged(
                f"the loss is {float(loss.detach())} in epoch {self.current_epoch} at {' and '.join(frames)}; lower "
                "model.learning_rate or narrow model.bounds, and resume from the last checkpoint."
            )
        optimizer.zero_grad()
        self.manual_backward(loss)
        optimizer.step()


def _settings(kind: type[Own], given: Own | Mapping[str, Any]) -> Own:
    """Settings as they are, or made of the plain values that a checkpoint holds."""
    return kind(**given) if isinstance(given, Mapping) else given
