"""The five terms of the training loss, one function each; the physics term has a second for head posterior.

Source: Bini 2026, section 3.4.2. Depth is in [0, 1], normalised by the clip's fixed scale; 0 marks a pixel without a
measurement, which no reconstruction term counts. A term of one generator is added over both directions of time, and the
cycle term, which both share, carries the paper's ½: each generator is trained with exactly the paper's weights.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from palpate.common.settings import Checked, NotNegative
from palpate.models.evidence import negative_evidence
from palpate.physics.depth import DepthLikelihood
from palpate.physics.load import Press
from palpate.physics.mechanics import SIGNS, Bounds, Mechanics
from palpate.physics.mesh import Mesh
from palpate.physics.msd import rollout, rollout_sensitivities
from palpate.physics.msd.autograd import map_samples
from palpate.physics.msd.batch import ObservationBatch
from palpate.physics.msd.likelihoods import displacement_error
from palpate.physics.observation import Linearised


@dataclass(frozen=True)
class LossWeights(Checked, group="weights."):
    """λ of the total loss (Bini 2026, equation 10 and section 3.4.2); a term of weight 0 isn't computed."""

    gan: NotNegative = 1.0
    """λ_GAN."""
    cycle: NotNegative = 10.0
    """λ_cyc."""
    identity: NotNegative = 1.0
    """λ_id."""
    physics: NotNegative = 2.0
    """λ_phys."""
    regularisation: NotNegative = 0.1
    """λ_reg; the paper only calls it comparatively low."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not any(vars(self).values()):
            raise ValueError("weights are all 0; give at least one term a weight.")


def total(terms: Mapping[str, Tensor], weights: LossWeights) -> Tensor:
    """L = Σ λ·term of unweighted terms by the names of their weights, scalars (Bini 2026, equation 10)."""
    return sum(getattr(weights, name) * value for name, value in terms.items())


def generator_adversarial_loss(fake_scores: Tensor) -> Tensor:
    """E[(D(G) − 1)²], the generator's term (Bini 2026, equation 11, least squares)."""
    return (fake_scores - 1).square().mean()


def discriminator_loss(real_scores: Tensor, fake_scores: Tensor) -> Tensor:
    """E[(D(real) − 1)²] + E[D(G)²] (Bini 2026, equation 11, least squares)."""
    return (real_scores - 1).square().mean() + fake_scores.square().mean()


def masked_l1(prediction: Tensor, target: Tensor) -> Tensor:
    """Mean |prediction − target| over the target's valid pixels (> 0); 0 when there is none."""
    valid = target > 0
    difference = torch.where(valid, (prediction - target).abs(), 0.0)
    return difference.sum() / valid.sum().clamp(min=1)


def cycle_loss(cycled_a: Tensor, real_a: Tensor, cycled_b: Tensor, real_b: Tensor) -> Tensor:
    """½(‖G_BA(G_AB(D_t)) − D_t‖₁ + ‖G_AB(G_BA(D_t+1)) − D_t+1‖₁) (Bini 2026, equation 12)."""
    return 0.5 * (masked_l1(cycled_a, real_a) + masked_l1(cycled_b, real_b))


def null_parameters(theta: Tensor) -> Tensor:
    """θ_null = (k_s, k_d, F = 0), detached: without a force the tissue stays as it is (Bini 2026, equation 13)."""
    return theta.detach() * theta.new_tensor([1.0, 1.0, 0.0])


def identity_loss(unchanged: Tensor, real: Tensor) -> Tensor:
    """‖G(D_t, θ_null) − D_t‖₁ (Bini 2026, equation 13)."""
    return masked_l1(unchanged, real)


def physics_loss(
    theta: Tensor, meshes: Sequence[Mesh], loads: Sequence[Press], observation: ObservationBatch, mechanics: Mechanics
) -> Tensor:
    """E[‖Φ_MSD(θ) − d_obs‖²], gradient through all steps of the rollout (Bini 2026, equations 14 and 15).

    Args:
        theta: [k_s, k_d, F], physical units, shape [B, 3].
        meshes: the frames' tissue meshes.
        loads: place, direction and duration of the force.
        observation: observed contact displacements [scene units], and their steps.
        mechanics: the rollout's constants.

    Returns:
        Mean squared displacement error [scene units²], a scalar.
    """
    return displacement_error(rollout(theta.cpu(), meshes, loads, mechanics), observation).mean().to(theta.device)


def posterior_physics_loss(
    mean: Tensor,
    factor: Tensor,
    meshes: Sequence[Mesh],
    loads: Sequence[Press],
    dents: Sequence[DepthLikelihood],
    mechanics: Mechanics,
    box: tuple[Tensor, Tensor],
) -> tuple[Tensor, Tensor]:
    """The physics term of head posterior: the negative evidence bound of the observations up to the sample's frame.

    Args:
        mean, factor: mean and covariance factor of the posterior of φ, shapes [B, 3] and [B, 3, 3].
        meshes, loads, mechanics: arguments of `physics_loss`.
        dents: observed depth of the tissue around every contact; pixels are assigned to tissue at its own mean.
        box: φ's lower and upper bounds, shape [3] each.

    Returns:
        The bound [nats], a scalar on the means' device; the Fisher information at the means, shape [B, 3, 3], a
        constant on the CPU.
    """
    theta = torch.exp(mean.detach().to("cpu", torch.float64))
    theta = theta * theta.new_tensor(SIGNS)

    def linearised(sample: tuple[Tensor, Mesh, Press, DepthLikelihood]) -> Linearised:
        own, mesh, load, dent = sample
        if not len(dent.times):  # the onset's own frame
            return Linearised(np.zeros(0), np.zeros((0, 3)))
        watch = torch.from_numpy(dent.vertices)[None]
        path, slopes = rollout_sensitivities(own[None].to(mean.dtype), [mesh], [load], mechanics, watch)
        steps = np.rint(dent.times / mechanics.time_step).astype(np.int64) - 1
        motion = path[0, steps].double().numpy(), (slopes[0, steps].double() * own).numpy()
        dent.look(*motion)
        return dent.linearise(*motion)

    found = map_samples(linearised, list(zip(theta, meshes, loads, dents, strict=True)))
    names = "misfit", "gradient", "information"
    misfit, gradient, information = (
        torch.from_numpy(np.array([getattr(each, name) for each in found])) for name in names
    )
    return negative_evidence(mean, factor, misfit, gradient, information, *box), information


def regularisation_loss(theta: Tensor, bounds: Bounds) -> Tensor:
    """Squared hinge outside the admissible box, summed over θ, mean over the batch; 0 inside (Bini 2026, equation 16).

    Physical units, as the paper has it. The bounded head never leaves the box, so the term guards other heads only.
    """
    lower, upper = theta.new_tensor(bounds.lower), theta.new_tensor(bounds.upper)
    outside = (lower - theta).clamp(min=0).square() + (theta - upper).clamp(min=0).square()
    return outside.sum(dim=1).mean()
