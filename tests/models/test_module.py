"""The training step: who moves whom, and by which pathway gradients arrive (Bini 2026, section 3.4)."""

import warnings

import pytest
import torch
from lightning.pytorch import Trainer
from torch.utils.data import DataLoader

from palpate.models.carried_depth import change, shifted
from palpate.models.evidence import bound_loss
from palpate.models.losses import LossWeights, posterior_physics_loss, total
from palpate.models.module import PhysicsInformedGAN, TrainingDiverged, with_current
from palpate.models.posterior import ContactPosterior
from palpate.physics.mechanics import Bounds, Mechanics

MECHANICS = Mechanics(steps=24, load_steps=8)
BOUNDS = Bounds(force=(-0.3, 0.0), initial=(0.5, 0.1, -0.05))
QUIET = {"accelerator": "cpu", "logger": False, "enable_progress_bar": False, "enable_checkpointing": False}
NETWORKS = ("generator_ab", "generator_ba", "discriminator_a", "discriminator_b")


def build(kind: type[PhysicsInformedGAN] = PhysicsInformedGAN, **settings) -> PhysicsInformedGAN:
    torch.manual_seed(0)
    module = kind(**{"width": 4, "residual_blocks": 1, "bounds": BOUNDS, "mechanics": MECHANICS} | settings)
    module.transfer_batch_to_device = lambda batch, *_: batch  # meshes stay where they are, as by the data module
    return module


def fit(module: PhysicsInformedGAN, batches: list[dict], epochs: int = 1) -> Trainer:
    trainer = Trainer(max_epochs=epochs, enable_model_summary=False, **QUIET)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Lightning on worker counts
        trainer.fit(module, DataLoader(batches, batch_size=None), DataLoader(batches, batch_size=None))
    return trainer


def head_gradient(module: PhysicsInformedGAN) -> float:
    gradients = [p.grad for p in module.generator_ab.head.parameters() if p.grad is not None]
    return sum(float(gradient.abs().sum()) for gradient in gradients)


@pytest.mark.parametrize(
    ("terms", "head", "decoder"),
    [(("gan", "cycle"), True, True), (("physics",), True, False), (("identity",), False, True)],
    ids=["through the generator", "through the simulator", "not through identity, whose parameters are detached"],
)
def test_where_gradients_arrive(make_batch, terms, head, decoder):
    module = build()
    found, *_ = module.generator_losses(make_batch())
    sum(found[name] for name in terms).backward()
    assert (head_gradient(module) > 0) == head
    assert any(parameter.grad is not None for parameter in module.generator_ab.decoder.parameters()) == decoder


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
    module = build(learning_rate=2e-2, weights=LossWeights(physics=1000.0))
    with torch.no_grad():
        before = module.generator_losses(batch)[0]["physics"].item()
    fit(module, [batch], epochs=8)
    with torch.no_grad():
        after = module.generator_losses(batch)[0]["physics"].item()
    assert after < 0.5 * before


def test_cycle_of_a_longer_window_never_shows_its_target(make_batch):
    """The window that the second generator sees must not hold the frame that it has to find."""
    batch = make_batch(window=3)
    module = build(window=3)
    seen = []
    inner = module.generator_ba.generate
    module.generator_ba.generate = lambda window, *more: seen.append(window) or inner(window, *more)
    module.generator_losses(batch)
    real_a = batch["window_a"][:, -1]
    assert torch.equal(seen[0][:, :-1], batch["window_b"][:, :-1])
    assert all(not torch.equal(seen[0][:, channel], real_a) for channel in range(3))


def test_a_decoder_of_physics_starts_from_what_theta_makes_of_the_map(make_batch):
    """Without its layers' part, the fake is the carried map, and its error pulls at θ through the rollout alone."""
    batch, module = make_batch(), build(decoder="physics")
    for generator in (module.generator_ab, module.generator_ba):
        torch.nn.init.zeros_(generator.decoder.output.weight)
    _, (_, fake_b), theta = module.generator_losses(batch)
    by = change(theta, batch["mesh_a"], batch["load_a"], batch["course_a"], module.mechanics)
    expected = shifted(batch["window_a"][:, -1:], by)
    torch.testing.assert_close(fake_b, expected, atol=1e-4, rtol=0)
    assert (fake_b - batch["window_a"][:, -1:]).abs().max() > 1e-3
    (fake_b - batch["window_b"][:, -1:]).square().sum().backward()
    assert module.generator_ab.head.layers[-1].weight.grad.abs().max() > 0


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
    module = build(noise=0.05)
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
    assert {type(value) for value in hparams.values()} <= {bool, int, float, str, dict, list}


def test_impossible_settings_are_refused():
    rates = ({"learning_rate": 0.0}, "learning_rate is 0"), ({"pretrained_rate": 1.5}, r"rate is 1\.5; give a share")
    for settings, said in (*rates, ({"pretrained": "some.pt"}, r"pretrained is some\.pt and head parameters")):
        with pytest.raises(ValueError, match=said):
            build(**settings)


def test_one_record_a_test_pair(make_batch):
    module = build()
    batch = make_batch()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        Trainer(**QUIET).test(module, DataLoader([batch, batch], batch_size=None), verbose=False)
    assert [(record["clip"], record["frame"]) for record in module.test_records] == [("one", 3), ("two", 7)] * 2


POSTERIOR = {
    "head": "posterior",
    "contact_features": 6,
    "bounds": Bounds(stiffness=(0.05, 1.0), damping=(0.005, 0.5), force=(-0.3, -0.01), initial=(0.4, 0.08, -0.1)),
    "weights": LossWeights(physics=1.0),
}


def parts(network: torch.nn.Module) -> dict[str, torch.Tensor]:
    return {name: parameter.detach().clone() for name, parameter in network.named_parameters()}


@pytest.mark.parametrize("settings", [{}, POSTERIOR], ids=["parameters", "posterior"])
@pytest.mark.parametrize("term", ["gan", "cycle", "identity", "physics", "regularisation"])
def test_a_weight_of_zero_switches_its_term_off(make_told_batch, monkeypatch, settings: dict, term: str):
    """It is not computed at all, the others stay what they are, and without gan no discriminator moves."""
    batch = make_told_batch()
    full = build(**settings).generator_losses(batch)[0]
    functions = {
        "gan": ("generator_adversarial_loss", "discriminator_loss"),
        "cycle": ("cycle_loss",),
        "identity": ("identity_loss",),
        "physics": ("physics_loss", "posterior_physics_loss"),
        "regularisation": ("regularisation_loss",),
    }
    for name in functions[term]:
        monkeypatch.setattr(f"palpate.models.losses.{name}", None)  # calling it would fail
    module = build(Watched, **settings | {"weights": LossWeights(**{"physics": 1.0, term: 0.0})})
    found = {name: value.item() for name, value in module.generator_losses(batch)[0].items()}
    assert full[term] != 0 or term == "regularisation"  # bounded heads never leave the box
    assert found == {name: 0 if name == term else pytest.approx(value.item()) for name, value in full.items()}
    before = parts(module.discriminator_a)
    # Validation needs the physics whatever its weight: it chooses the best checkpoint.
    module.validation_step = lambda *_: None
    fit(module, [batch])
    moved = any(not torch.equal(before[name], value) for name, value in parts(module.discriminator_a).items())
    assert moved == (term != "gan")
    assert len(module.changes) == (1 if term == "gan" else 3)


def test_physics_alone_leaves_the_decoder_as_it_is(make_told_batch):
    weights = LossWeights(gan=0.0, cycle=0.0, identity=0.0, physics=1.0, regularisation=0.0)
    module = build(**POSTERIOR | {"weights": weights})
    decoder, head = parts(module.generator_ab.decoder), parts(module.generator_ab.head)
    fit(module, [make_told_batch()])
    assert all(torch.equal(decoder[name], value) for name, value in parts(module.generator_ab.decoder).items())
    assert any(not torch.equal(head[name], value) for name, value in parts(module.generator_ab.head).items())


@pytest.fixture(scope="module")
def taught(make_told_batch):
    """A batch, a module trained on it, its physics' loss and its bound's error before, and the metrics."""
    batch = make_told_batch()
    module = build(learning_rate=4e-3, **POSTERIOR)
    with torch.no_grad():
        before = module.generator_losses(batch)[0]["physics"].item()
    error = bound_error(module, batch)
    return batch, module, before, error, fit(module, [batch], epochs=12).callback_metrics


def bound_error(module: PhysicsInformedGAN, batch: dict) -> float:
    generator = module.generator_ab
    posterior = generator.posterior
    answer = generator.answer(generator.encode(batch["window_a"]), batch["contact_features_a"])
    seen = (batch[f"{name}_a"] for name in ("mesh", "known_load", "dent"))
    box = posterior.lower, posterior.upper
    _, information = posterior_physics_loss(answer.mean, answer.factor, *seen, module.mechanics, box)
    return float(bound_loss(posterior.expected_bound_factor(batch["contact_features_a"]), information.numpy()))


def test_head_posterior_trains_both_heads_by_the_evidence_bound(taught):
    batch, module, before, _, metrics = taught
    assert metrics["val/physics"] < 0.2 * before
    assert metrics["train/regularisation"] == 0
    module.zero_grad()
    module.generator_losses(batch)[0]["physics"].backward()
    for generator in (module.generator_ab, module.generator_ba):
        assert all(p.grad is not None for p in generator.head.parameters())
        assert all(p.grad is None for p in generator.decoder.parameters())


def test_the_expected_bound_is_learnt_beside_the_evidence(taught, make_told_batch, tmp_path):
    """Without a pretrained head: no part of the loss's value, and nothing but its own weights changes for it."""
    batch = make_told_batch()
    torch.save(build(**POSTERIOR).generator_ab.head.posterior.state_dict(), tmp_path / "posterior.pt")
    learning, keeping = build(**POSTERIOR), build(pretrained=str(tmp_path / "posterior.pt"), **POSTERIOR)
    losses = [module.generator_losses(batch)[0]["physics"] for module in (learning, keeping)]
    assert losses[0].item() == pytest.approx(losses[1].item(), rel=1e-6)
    for loss in losses:
        loss.backward()
    heads = [dict(module.generator_ab.head.named_parameters()) for module in (learning, keeping)]
    for name, parameter in heads[0].items():
        other = heads[1][name].grad
        if ".expected_bound." in f".{name}":
            assert parameter.grad is not None
            assert other is None
        else:
            torch.testing.assert_close(parameter.grad, other)
    batch, module, _, before, _ = taught
    assert bound_error(module, batch) < 0.5 * before


def test_the_bound_is_about_what_was_seen_until_the_frame(make_told_batch):
    """Later frames are in the batch for evaluation; the training of head posterior doesn't look at them."""
    batch = make_told_batch()
    expected = build(**POSTERIOR).generator_losses(batch)[0]["physics"]
    batch["observation_a"].displacement = torch.full((2, 1, 3), 9.0)
    assert torch.equal(build(**POSTERIOR).generator_losses(batch)[0]["physics"], expected)
    batch["dent_a"][0].change = 0.0
    assert not torch.equal(build(**POSTERIOR).generator_losses(batch)[0]["physics"], expected)


def test_test_records_of_head_posterior(make_told_batch):
    module, batch = build(**POSTERIOR), make_told_batch()
    module.trainer = Trainer(**QUIET)
    module.log = lambda *_, **__: None
    module.test_step(batch, 0)
    theta = module.generator_ab.estimate(batch["window_a"], batch["contact_features_a"])
    torch.testing.assert_close(torch.from_numpy(module.test_records[1]["theta"]), theta[1].detach())


def test_a_pretrained_head_is_taken_over_when_training_starts(make_told_batch, tmp_path):
    torch.manual_seed(9)
    bounds = POSTERIOR["bounds"]
    trained = ContactPosterior(6, torch.from_numpy(bounds.log_box))
    torch.save(trained.state_dict(), tmp_path / "posterior.pt")
    module = build(pretrained=str(tmp_path / "posterior.pt"), **POSTERIOR | {"learning_rate": 1e-12})
    contact = torch.randn(5, 6)
    fit(module, [make_told_batch()])
    for generator in (module.generator_ab, module.generator_ba):
        torch.testing.assert_close(generator.head.posterior(contact)[0], trained(contact)[0], atol=1e-4, rtol=1e-4)
        for name, value in trained.expected_bound.state_dict().items():  # and not trained on
            assert torch.equal(generator.head.posterior.expected_bound.state_dict()[name], value)
    assert "pretrained" not in module.hparams


def test_a_pretrained_head_moves_at_its_share_of_the_rate(make_told_batch, tmp_path):
    """Adam's first step is as long as its rate, whatever the gradient; what is new keeps the whole one."""
    torch.save(
        ContactPosterior(6, torch.from_numpy(POSTERIOR["bounds"].log_box)).state_dict(), tmp_path / "posterior.pt"
    )

    def longest_step(**settings) -> dict[str, float]:
        module = build(learning_rate=1e-3, **POSTERIOR | settings)
        module.trainer = Trainer(**QUIET)
        module.on_fit_start()
        optimizer = module.configure_optimizers()[0]
        generator = module.generator_ab
        networks = {"head": generator.posterior, "new": generator.posterior.picture, "decoder": generator.decoder}
        before = {name: parts(network) for name, network in networks.items()}
        before["head"] = {name: values for name, values in before["head"].items() if not name.startswith("picture.")}
        total(module.generator_losses(make_told_batch())[0], module.weights).backward()
        optimizer.step()
        after = {name: parts(network) for name, network in networks.items()}
        return {name: max(float((after[name][k] - v).abs().max()) for k, v in before[name].items()) for name in before}

    pretrained = {"pretrained": str(tmp_path / "posterior.pt")}
    whole = {"head": 1e-3, "new": 1e-3, "decoder": 1e-3}
    assert longest_step() == pytest.approx(whole, rel=0.01)
    assert longest_step(**pretrained) == pytest.approx(whole | {"head": 1e-4}, rel=0.01)
    assert longest_step(pretrained_rate=1.0, **pretrained) == pytest.approx(whole, rel=0.01)
    assert longest_step(pretrained_rate=0.0, **pretrained) == pytest.approx(whole | {"head": 0.0}, rel=0.01)


def test_every_parameter_of_the_generators_is_trained_once(tmp_path):
    module = build(**POSTERIOR | {"pretrained": "posterior.pt"})
    groups = module.configure_optimizers()[0].param_groups
    found = [id(parameter) for group in groups for parameter in group["params"]]
    networks = (module.generator_ab, module.generator_ba)
    assert sorted(found) == sorted(id(parameter) for network in networks for parameter in network.parameters())


@pytest.mark.parametrize("settings", [{"weights": LossWeights(physics=3.0)}, POSTERIOR], ids=["mean", "posterior"])
def test_load_from_checkpoint_gives_the_trained_module(make_told_batch, tmp_path, settings):
    trained, batch = build(**settings), make_told_batch()
    fit(trained, [batch]).save_checkpoint(tmp_path / "some.ckpt")
    loaded = PhysicsInformedGAN.load_from_checkpoint(tmp_path / "some.ckpt", weights_only=True)
    assert (loaded.weights, loaded.bounds, loaded.mechanics) == (trained.weights, trained.bounds, trained.mechanics)
    with torch.no_grad():
        expected, found = (module.eval().generator_losses(batch)[0] for module in (trained, loaded))
    for name in ("gan", "physics"):
        torch.testing.assert_close(found[name], expected[name])


@pytest.mark.parametrize("settings", [{"decoder": "physics"}, POSTERIOR], ids=["parameters", "posterior"])
@pytest.mark.parametrize("narrow", [torch.bfloat16, torch.float16])
def test_a_mixed_precision_changes_neither_heads_nor_rollouts(make_told_batch, settings, narrow):
    """For the same features θ and the physics are the same to the last digit."""
    batch, module = make_told_batch(), build(**settings)
    features = {window: module.generator_ab.encode(batch[window]).detach() for window in ("window_a", "window_b")}
    for generator in (module.generator_ab, module.generator_ba):
        generator.encode = lambda window: features["window_a" if torch.equal(window, batch["window_a"]) else "window_b"]
    expected, _, theta = module.generator_losses(batch)
    with torch.autocast("cpu", dtype=narrow, cache_enabled=False):
        found, _, other = module.generator_losses(batch)
        total(found, module.weights).backward()
    assert torch.equal(other, theta)
    assert torch.equal(found["physics"], expected["physics"])
    assert found["cycle"].item() == pytest.approx(expected["cycle"].item(), rel=0.05)
    assert all(p.grad is None or p.grad.isfinite().all() for p in module.parameters())


def test_mixed_precision_trains(make_told_batch):
    module = build(**POSTERIOR)
    trainer = Trainer(max_epochs=2, enable_model_summary=False, precision="bf16-mixed", **QUIET)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        trainer.fit(module, DataLoader([make_told_batch()], batch_size=None))
    assert torch.isfinite(trainer.callback_metrics["train/physics"])
    assert {parameter.dtype for parameter in module.parameters()} == {torch.float32}
