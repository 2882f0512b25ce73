"""Losses of contact posteriors and of their expected bound.

q(φ) = N(mean, L·Lᵀ) over φ = (log k_s, log k_d, log |F|). The likelihood of an observed motion d is N(Φ(φ), σ²),
linearised at the mean by the rollout's exact Jacobian. The prior is the Gaussian with the mean and the variance of the
uniform distribution over the admissible box. True θ is not used.

The Cramér–Rao bound depends on θ, which is uncertain itself, and a posterior may be narrow because of the prior alone.
So the bound, by which verdicts are given, has its own estimate: its median over contacts with equal features.
"""

import math

import numpy as np
import torch
from torch import Tensor

from palpate.models.posterior import evidence_loss
from palpate.physics.identifiability import LIMIT, RATIOS, bounds, ratio_bounds

MAX_MEAN_STEP = 1.0
"""Largest step of a mean in any log-parameter, as far as the linearisation holds."""
MEAN_WEIGHT = 0.2
"""Weight of the mean's gradient against the covariance's; it changes their speed, not their optimum."""


def negative_evidence(
    mean: Tensor, factor: Tensor, misfit: Tensor, gradient: Tensor, information: Tensor, lower: Tensor, upper: Tensor
) -> Tensor:
    """-E_q[log p(d|φ)] + KL(q‖prior), the mean over the batch: its value, with the gradient of `preconditioned`.

    Args:
        mean, factor: mean and covariance factor L of q, shapes [B, 3] and [B, 3, 3].
        misfit, gradient, information: the likelihood's value and derivatives at the means.
        lower, upper: φ's box, shape [3].

    Returns:
        Scalar, the linearised bound in nats without the likelihood's constant.
    """
    misfit, gradient, information = (values.to(mean) for values in (misfit, gradient, information))
    surrogate = preconditioned(mean, factor, gradient, information, lower, upper, whiten=True)
    prior, away = _prior(mean, lower, upper)
    bound = (misfit + _divergence(factor.detach(), away, information + prior, prior)).mean()
    return surrogate + (bound - surrogate).detach()


def preconditioned(
    mean: Tensor, factor: Tensor, gradient: Tensor, information: Tensor, lower: Tensor, upper: Tensor, whiten: bool
) -> Tensor:
    """`evidence_loss` with the prior added and every mean's gradient H·move replaced by √H·move, of a limited length.

    It vanishes where the bound's own gradient does. With the plain gradient, a parameter known a hundred times better
    than another is learnt ten thousand times faster, and one badly explained contact outweighs all others.

    Args:
        mean, factor: mean and covariance factor L of q, shapes [B, 3] and [B, 3, 3].
        gradient, information: derivatives of the misfits at the means, shapes [B, 3] and [B, 3, 3], constants.
        lower, upper: φ's box, shape [3].
        whiten: False = the plain gradient, divided by the root of H's mean diagonal, for the start of training.
    """
    prior, away = _prior(mean, lower, upper)
    gradient, information = gradient + away @ prior, information + prior
    values, vectors = torch.linalg.eigh(information)
    along = torch.einsum("brq,br->bq", vectors, gradient)
    move = torch.einsum("bpq,bq->bp", vectors, along / values)
    if whiten:
        pull = MEAN_WEIGHT * torch.einsum("bpq,bq->bp", vectors, along * values.rsqrt())
    else:
        pull = gradient / values.mean(dim=1, keepdim=True).sqrt()
    shorter = (MAX_MEAN_STEP / move.abs().amax(dim=1).clamp(min=1e-12)).clamp(max=1.0)
    return evidence_loss(mean, factor, pull, information, shorter)


def covering(mean: Tensor, factor: Tensor, best: Tensor, information: Tensor) -> Tensor:
    """Cross entropy of q and the likelihoods' own posteriors N(best, H⁻¹), the mean over the batch, up to a constant.

    Its optimal covariance is H⁻¹ plus the square of the mean's own error. One network for all contacts finds none of
    their optima exactly, which the evidence bound, with H⁻¹ alone, ignores. It is the loss of neural posterior
    estimation (Papamakarios & Murray 2016) with draws from N(best, H⁻¹) averaged out.

    Args:
        mean, factor: mean and covariance factor L of q, shapes [B, 3] and [B, 3, 3].
        best: optima of likelihood and prior, shape [B, 3].
        information: H there, including the prior's precision, shape [B, 3, 3], a constant.
    """
    values, vectors = torch.linalg.eigh(information.double())
    spread = (vectors * values.rsqrt()[:, None]).to(factor)
    apart = torch.cat([spread, (mean - best)[..., None]], dim=2)
    squares = torch.linalg.solve_triangular(factor, apart, upper=False).square().sum((1, 2))
    return (0.5 * squares + torch.log(factor.diagonal(dim1=1, dim2=2)).sum(1)).mean()


def box_prior(lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor]:
    """Precision [3, 3] and mean [3] of the Gaussian with the moments of the uniform distribution over a box."""
    return torch.diag(12 / (upper - lower).square()), 0.5 * (lower + upper)


def _prior(mean: Tensor, lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor]:
    """The prior's precision [3, 3], and the means less its own [B, 3], constants."""
    precision, middle = box_prior(lower, upper)
    return precision, mean.detach() - middle


def _divergence(factor: Tensor, away: Tensor, information: Tensor, prior: Tensor) -> Tensor:
    """KL(q‖prior) with the likelihood's curvature in place of the prior's: ½[tr(ΣH) + dᵀPd - 3 - log det ΣP], [B]."""
    spread = (factor.transpose(1, 2) @ information @ factor).diagonal(dim1=1, dim2=2).sum(1)
    logarithm = 2 * torch.log(factor.diagonal(dim1=1, dim2=2)).sum(1) + torch.logdet(prior)
    return 0.5 * (spread + (away @ prior * away).sum(1) - 3 - logarithm)


MAX_LOG_DISTANCE = 2.0
"""Largest distance of log bounds from the limit; farther ones are clipped, as no verdict depends on them."""


def bound_loss(factor: Tensor, information: np.ndarray) -> Tensor:
    """Mean absolute error of log bounds, which is least at their medians.

    The bounds are those of k_s, k_d, |F|, k_s/k_d and F/k_d, and the two that decide a verdict: the worst parameter's
    and the worse ratio's.

    Args:
        factor: output of `models.posterior.ExpectedBound`, shape [B, 3, 3].
        information: Fisher information of the observations, shape [B, 3, 3].
    """
    rows = torch.cat([torch.eye(3), torch.from_numpy(RATIOS).float()]).to(factor)
    expected = _with_worst(torch.log((rows @ factor).square().sum(dim=2).sqrt()))
    true = np.log(np.concatenate([bounds(information), ratio_bounds(information)], axis=-1))
    wanted = _with_worst(torch.from_numpy(true).to(factor))
    middle = math.log(LIMIT)
    return (expected - wanted.clamp(middle - MAX_LOG_DISTANCE, middle + MAX_LOG_DISTANCE)).abs().mean()


def _with_worst(logs: Tensor) -> Tensor:
    """Log bounds [B, 5], followed by the largest parameter's and the larger ratio's, shape [B, 7]."""
    return torch.cat([logs, logs[:, :3].amax(1, keepdim=True), logs[:, 3:].amax(1, keepdim=True)], dim=1)
