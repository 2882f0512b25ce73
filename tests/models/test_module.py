"""The training step: who moves whom, and by which pathway gradients arrive (spec 1.6, 1.7)."""

from __future__ import annotations

import warnings

import pytest
import torch
from lightning.pytorch import Trainer
from torch.utils.data import DataLoader

from models.augmentation import AugmentationSettings
from models.losses import LossWeights
from models.module import PhysicsInformedGAN, TrainingDiverged, with_current
from physics.mechanics import Bounds, Mechanics

MECHANICS = Mechanics(steps=24, load_steps=8)
BOUNDS = Bounds(force=(-0.3, 0.0), initial=(0.5, 0.1, -0.05))
NETWORKS = ("generator_ab", "generator_ba", "discriminator_a", "discriminator_b")


def build(kind: type[PhysicsInformedGAN] = PhysicsInformedGAN, **settings) -> PhysicsInformedGAN:
    torch.manual_seed(0)
    return kind(**{"width": 4, "residual_blocks": 1, "bounds": BOUNDS, "mechanics": MECHANICS} | settings)


def fit(module: PhysicsInformedGAN, batches: list[dict], epochs: int = 1) -> Trainer:
    trainer = Trainer(
        max_epochs=epochs,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Lightning on worker counts
        trainer.fit(module, DataLoader(batches, batch_size=None), DataLoader(batches, batch_size=None))
    return trainer


def head_gradient(module: PhysicsInformedGAN) -> float:
    gradients = [p.grad for p in module.generator_ab.head.parameters() if p.grad is not None]
    return sum(float(gradient.abs().sum()) for gradient in gradients)


def test_gradient_reaches_the_head_through_the_generator_alone(make_batch):
    module = build()
    terms, *_ = module.generator_losses(make_batch())
    (terms.gan + terms.cycle).backward()
    assert head_gradient(module) > 0


def test_gradient_reaches_the_head_through_the_simulator_alone(make_batch):
    module = build()
    terms, *_ = module.generator_losses(make_batch())
    terms.physics.backward()
    assert head_gradient(module) > 0
    assert all(parameter.grad is None for parameter in module.generator_ab.decoder.parameters())


def test_identity_gives_the_head_no_gradient_because_its_parameters_are_detached(make_batch):
    module = build()
    terms, *_ = module.generator_losses(make_batch())
    terms.identity.backward()
    assert head_gradient(module) == 0
    assert any(parameter.grad is not None for parameter in module.generator_ab.decoder.parameters())


class Watched(PhysicsInformedGAN):
    """Notes which networks each optimiser step changed."""

    def _step(self, optimizer, loss, batch):
        before = {name: [p.detach().clone() for p in getattr(self, name).parameters()] for name in NETWORKS}
        super()._step(optimizer, loss, batch)
        changed = [
            name
            for name in NETWORKS
            if any(not torch.equal(a, b) for a, b in zip(before[name], getattr(self, name).parameters(), strict=True))
        ]
        self.changes = [*getattr(self, "changes", []), changed]


def test_each_step_moves_its_own_networks_only(make_batch):
    module = build(Watched)
    fit(module, [make_batch()])
    assert module.changes == [["generator_ab", "generator_ba"], ["discriminator_a"], ["discriminator_b"]]


def test_all_five_terms_theta_and_validation_physics_are_logged(make_batch):
    metrics = fit(build(), [make_batch()]).callback_metrics
    for name in ("gan", "cycle", "identity", "physics", "regularisation"):
        assert torch.isfinite(metrics[f"train/{name}"])
    assert metrics["train/regularisation"] == 0
    assert 0 < metrics["val/physics"] < 1
    for stage in ("train", "val"):
        assert metrics[f"{stage}/stiffness_mean"] == pytest.approx(0.5, abs=0.1)
        assert metrics[f"{stage}/force_mean"] == pytest.approx(-0.05, abs=0.03)
        assert metrics[f"{stage}/damping_sd"] >= 0


def test_training_lowers_the_physics_loss_without_labels(make_batch):
    batch = make_batch()
    # Squared displacements of a few hundredths of the scene need a weight to be heard beside depths.
    module = build(learning_rate=1e-2, weights=LossWeights(physics=1000.0))
    with torch.no_grad():
        before = module.generator_losses(batch)[0].physics.item()
    fit(module, [batch], epochs=15)
    with torch.no_grad():
        after = module.generator_losses(batch)[0].physics.item()
    assert after < 0.5 * before


def test_cycle_of_a_longer_window_never_shows_its_target(make_batch):
    """The window that the second generator sees must not hold the frame that it has to find."""
    batch = make_batch(window=3)
    module = build(window=3)
    seen = []
    module.generator_ba.generate, inner = lambda w, t: seen.append(w) or inner(w, t), module.generator_ba.generate
    module.generator_losses(batch)
    real_a = batch["window_a"][:, -1]
    assert torch.equal(seen[0][:, :-1], batch["window_b"][:, :-1])
    assert all(not torch.equal(seen[0][:, channel], real_a) for channel in range(3))


def test_every_picture_is_conditioned_on_its_own_generators_theta(make_batch):
    """θ_AB from the real D_t conditions G_AB, θ_BA from the real D_t+1 conditions G_BA, in the cycle too."""
    batch, module, seen = make_batch(), build(), {}
    for name in ("generator_ab", "generator_ba"):
        generator, seen[name] = getattr(module, name), []
        generator.decode = lambda f, t, c, n=name, inner=generator.decode: seen[n].append(t) or inner(f, t, c)
    module.generator_losses(batch)
    without_force = torch.tensor([1.0, 1.0, 0.0])
    for name, window in (("generator_ab", "window_a"), ("generator_ba", "window_b")):
        theta = getattr(module, name).estimate(batch[window])
        for given, expected in zip(seen[name], (theta, theta, theta * without_force), strict=True):
            torch.testing.assert_close(given, expected)


def test_with_current_replaces_the_last_frame():
    window = torch.arange(6.0).reshape(1, 3, 1, 2)
    assert with_current(window, torch.full((1, 1, 1, 2), 9.0)).flatten().tolist() == [0, 1, 2, 3, 9, 9]


def test_augmentation_disturbs_the_windows_but_not_what_they_are_compared_with(make_batch):
    batch = make_batch()
    module = build(augmentation=AugmentationSettings(noise=0.05))
    seen = []
    module.generator_ab.encode, inner = lambda w: seen.append(w) or inner(w), module.generator_ab.encode
    original = batch["window_a"].clone()
    module.generator_losses(batch)
    assert not torch.equal(seen[0], original)
    assert torch.equal(batch["window_a"], original)


def test_a_loss_that_is_not_finite_stops_with_a_sentence(make_batch):
    batch = make_batch()
    batch["observation_a"].displacement = torch.full((2, 1, 3), float("inf"))
    with pytest.raises(TrainingDiverged, match=r"epoch 0 at one frame 3 and two frame 7; lower"):
        fit(build(), [batch])


def test_hyperparameters_are_plain_values():
    """So that a checkpoint loads with weights_only=True."""
    hparams = dict(build(weights=LossWeights(physics=3.0)).hparams)
    assert hparams["weights"]["physics"] == 3.0
    assert hparams["bounds"]["force"] == (-0.3, 0.0)
    assert {type(value) for value in hparams.values()} <= {int, float, str, dict, list}


def test_impossible_learning_rate_is_refused():
    with pytest.raises(ValueError, match="learning_rate is 0"):
        build(learning_rate=0.0)


def test_one_record_a_test_pair(make_batch):
    module = build()
    batch = make_batch()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        Trainer(accelerator="cpu", logger=False, enable_progress_bar=False).test(
            module, DataLoader([batch, batch], batch_size=None), verbose=False
        )
    assert [(record["clip"], record["frame"]) for record in module.test_records] == [("one", 3), ("two", 7)] * 2
