"""A training step of the GAN: its lazily computed quantities, and the loss terms.

A term is a function of a `Step`, registered under its own name, which is also that of its weight in `LossWeights`.
Those of one generator are added over both directions of time; the cycle, which both share, carries the paper's ½.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from types import FunctionType
from typing import Any

import torch
from torch import Tensor

from palpate.models import losses
from palpate.models.carried_depth import change, shifted
from palpate.models.evidence import bound_loss
from palpate.models.generator import Generator, HeadOutput
from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.batch import Direction, PairBatch


def precise(device: torch.device) -> torch.autocast:
    """Context without a mixed precision's 16 bits, which overflow in a rollout and shift φ visibly."""
    return torch.autocast(device.type, enabled=False)


class Pass:
    """One generator on the frames of one direction of time.

    Args:
        generator: G_AB forward in time, G_BA backward.
        given: the frames and their contacts.
        mechanics: the rollout's constants.
        window: the frames as the generator sees them; None = as they are.
    """

    def __init__(
        self, generator: Generator, given: Direction, mechanics: Mechanics, window: Tensor | None = None
    ) -> None:
        self.generator, self.given, self.mechanics = generator, given, mechanics
        self.window = given.window if window is None else window
        self.real = given.window[:, -1:]

    @cached_property
    def features(self) -> Tensor:
        """Output of the encoder, shape [B, 4·width, H//4, W//4]."""
        return self.generator.encode(self.window)

    @cached_property
    def answer(self) -> HeadOutput:
        """θ of every pair, with its posterior where the head has one."""
        with precise(self.real.device):
            return self.generator.answer(self.features.float(), self.given.contact_features)

    def change_under(self, theta: Tensor) -> Tensor | None:
        """Change of the depth by the rollout of θ, shape [B, 1, H, W]; None for decoder direct."""
        if self.generator.decoder.kind != "physics":
            return None
        given = self.given
        with precise(self.real.device):
            return change(theta, given.meshes, given.loads, given.course, self.mechanics)

    @cached_property
    def change(self) -> Tensor | None:
        """Change of the depth under the head's θ."""
        return self.change_under(self.answer.theta)

    def next_map(self, theta: Tensor, change: Tensor | None) -> Tensor:
        """The next depth map under θ and its change, shape [B, 1, H, W]."""
        return self.generator.decode(self.features, theta, shifted(self.real, change))

    @cached_property
    def fake(self) -> Tensor:
        """The next depth map under the head's θ."""
        return self.next_map(self.answer.theta, self.change)

    def back(self, fake: Tensor) -> Tensor:
        """The map that follows another direction's fake [B, 1, H, W].

        The fake replaces the current frame in this direction's window of *real* frames. The other direction's window
        holds the cycle's target.
        """
        start = shifted(fake, self.change)
        return self.generator.generate(with_current(self.window, fake), self.answer.theta, start)

    def unchanged(self) -> Tensor:
        """The map without force, which the simulator leaves unchanged, shape [B, 1, H, W]."""
        return self.next_map(losses.null_parameters(self.answer.theta), None)

    def physics(self, learns_bound: bool) -> Tensor:
        """The squared displacement error of the head's θ, or the negative evidence bound of its posterior.

        The evidence counts the frames up to the sample's own, since the posterior had no later ones as input.

        Args:
            learns_bound: True = the expected bound is learnt at the same time, from the information at the mean. How
                often its verdicts are right was not measured.
        """
        given, (theta, mean, factor) = self.given, self.answer
        if mean is None or factor is None:
            return losses.physics_loss(theta, given.meshes, given.loads, given.observation, self.mechanics)
        assert given.contact_features is not None
        posterior = self.generator.posterior
        known, box = (given.meshes, given.known_loads, given.dents), (posterior.lower, posterior.upper)
        evidence, information = losses.posterior_physics_loss(mean, factor, *known, self.mechanics, box)
        if not learns_bound:
            return evidence
        error = bound_loss(posterior.expected_bound_factor(given.contact_features), information.cpu().numpy())
        return evidence + (error - error.detach())  # adds its gradient, and nothing to the value


class Step:
    """Both generators on one batch.

    Args:
        networks: the `PhysicsInformedGAN`.
        batch: frames and contacts.
        windows: the frames as the generators see them, forward and backward in time; None = as they are.
    """

    def __init__(self, networks: Any, batch: PairBatch, windows: Sequence[Tensor | None] = (None, None)) -> None:
        self.networks = networks
        self.ab = Pass(networks.generator_ab, batch.a, networks.mechanics, windows[0])
        self.ba = Pass(networks.generator_ba, batch.b, networks.mechanics, windows[1])

    def terms(self, weights: losses.LossWeights) -> dict[str, Tensor]:
        """Unweighted terms by name, scalars; one of weight 0 is 0 and isn't computed."""
        zero = self.ab.real.new_zeros(())
        return {name: TERMS[name](self) if weight else zero for name, weight in vars(weights).items()}


TERMS: dict[str, Callable[[Step], Tensor]] = {}
"""Loss terms by the names of their weights."""


def term(function: FunctionType) -> FunctionType:
    """Register a loss term."""
    TERMS[function.__name__] = function
    return function


@term
def gan(step: Step) -> Tensor:
    forward, backward = step.networks.discriminator_b(step.ab.fake), step.networks.discriminator_a(step.ba.fake)
    return losses.generator_adversarial_loss(forward) + losses.generator_adversarial_loss(backward)


@term
def cycle(step: Step) -> Tensor:
    ab, ba = step.ab, step.ba
    return losses.cycle_loss(ba.back(ab.fake), ab.real, ab.back(ba.fake), ba.real)


@term
def identity(step: Step) -> Tensor:
    ab, ba = step.ab, step.ba
    return losses.identity_loss(ab.unchanged(), ab.real) + losses.identity_loss(ba.unchanged(), ba.real)


@term
def physics(step: Step) -> Tensor:
    """L_physics in both directions of time (Bini 2026, figure 2)."""
    with precise(step.ab.real.device):
        learns_bound = step.networks.pretrained is None  # pretraining learnt the bound at better known θ
        return step.ab.physics(learns_bound) + step.ba.physics(learns_bound)


@term
def regularisation(step: Step) -> Tensor:
    ab, ba = (losses.regularisation_loss(one.answer.theta, step.networks.bounds) for one in (step.ab, step.ba))
    return ab + ba


def with_current(window: Tensor, frame: Tensor) -> Tensor:
    """Window [B, K, H, W] whose last (current) frame is replaced by [B, 1, H, W]."""
    return torch.cat([window[:, :-1], frame], dim=1)
