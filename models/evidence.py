"""The evidence bound of contact posteriors: the physics loss of a head that says how sure it is.

q(φ) = N(mean, L·Lᵀ) over φ = (log k_s, log k_d, log |F|). The likelihood of an observed motion d is N(Φ(φ), σ²),
linearised at the mean by the rollout's exact Jacobian; the prior is the Gaussian with the mean and the variance of the
uniform distribution over the admissible box. Nothing here reads a true θ.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from models.posterior import evidence_loss
from physics.identifiability import fisher_information, log_jacobian
from physics.mechanics import Mechanics
from physics.mesh import Mesh
from physics.msd import ContactBatch, MeshBatch
from physics.msd_autograd import SENSITIVITY_LIMIT, map_samples, split
from physics.msd_kernel import simulate_sensitivities
from physics.observation import ObservationBatch

LONGEST_MOVE = 1.0
"""A mean is moved no farther than this at once in any log-parameter: the linearisation reaches no farther."""
PULL = 0.2
"""Weight of the mean's pull against the covariance's; it changes how fast the two are learnt, not where they end."""

Batch = TypeVar("Batch", MeshBatch, ContactBatch, ObservationBatch)


class Motion(NamedTuple):
    """What was seen of one contact, as plain arrays."""

    mesh: Mesh
    """Tissue at rest."""
    vertex: int
    """Contact vertex."""
    direction: np.ndarray
    """Unit vector of the force, shape [3]."""
    load_steps: int
    """Steps under load."""
    steps: np.ndarray
    """Index into the trajectory of each observation, shape [M]; M = 0 where nothing was seen yet."""
    displacement: np.ndarray
    """Observed displacement, shape [M, 3] [scene units]."""


class Linearised(NamedTuple):
    """One contact's misfit around one φ."""

    misfit: float
    """Σ r²/2σ², the negative log likelihood up to a constant."""
    gradient: np.ndarray
    """Jᵀr/σ², shape [3]."""
    information: np.ndarray
    """JᵀJ/σ², shape [3, 3]: the Fisher information."""


def linearise(motion: Motion, logs: np.ndarray, noise: float, mechanics: Mechanics) -> Linearised:
    """Misfit, its gradient and its Fisher information at φ.

    Args:
        motion: what was seen; its steps are `mechanics`' own.
        logs: φ = (log k_s, log k_d, log |F|), shape [3].
        noise: σ of every observed coordinate [scene units].
        mechanics: the rollout's constants; it ends with the last observation.

    Returns:
        No gradient and no information where nothing was seen, or where the motion is so chaotic that rounding decides
        its derivatives.
    """
    if len(motion.steps) == 0:
        return Linearised(0.0, np.zeros(3), np.zeros((3, 3)))
    theta = np.exp(np.asarray(logs, np.float64)) * (1.0, 1.0, -1.0)
    used = dataclasses.replace(mechanics, steps=int(motion.steps.max()) + 1, load_steps=0)
    load_steps = min(motion.load_steps, used.steps)
    path, slopes = simulate_sensitivities(
        theta, motion.mesh, motion.vertex, motion.direction, used, load_steps=load_steps
    )
    residual = (path[motion.steps] - motion.displacement).astype(np.float64).ravel()
    jacobian = log_jacobian(slopes.astype(np.float64), theta)
    if np.abs(jacobian).max() > SENSITIVITY_LIMIT[path.dtype] * np.abs(path).max():
        jacobian = np.zeros_like(jacobian)
    jacobian = jacobian[motion.steps].reshape(-1, 3)
    misfit = 0.5 * float(residual @ residual) / noise**2
    return Linearised(misfit, jacobian.T @ residual / noise**2, fisher_information(jacobian, noise))


def linearise_batch(
    mean: Tensor,
    noise: Tensor,
    mesh: MeshBatch,
    contact: ContactBatch,
    observation: ObservationBatch,
    mechanics: Mechanics,
) -> list[Linearised]:
    """`linearise` for every sample of a batch, on as many threads as torch uses.

    Args:
        mean: φ, shape [B, 3].
        noise: σ of every observed coordinate, shape [B] [scene units].
        mesh, contact: the tissue and where and how long it is pressed, as far as was seen.
        observation: what was seen; weight 0 is padding.
        mechanics: the rollout's constants.
    """
    contact, observation = _on_cpu(contact), _on_cpu(observation)
    logs, sigma = mean.detach().cpu().double().numpy(), noise.cpu().double().numpy()
    samples = []
    for index, single in enumerate(split(_on_cpu(mesh))):
        seen = observation.weight[index] > 0
        motion = Motion(
            mesh=single,
            vertex=int(contact.vertex[index]),
            direction=contact.direction[index].numpy(),
            load_steps=int(contact.load_steps[index]),
            steps=observation.steps[index][seen].numpy(),
            displacement=observation.displacement[index][seen].numpy(),
        )
        samples.append((motion, logs[index], sigma[index]))
    return map_samples(lambda sample: linearise(*sample, mechanics), samples)


def negative_evidence(
    mean: Tensor, factor: Tensor, found: Sequence[Linearised], lower: Tensor, upper: Tensor
) -> Tensor:
    """-E_q[log p(d|φ)] + KL(q‖prior), the mean over the batch: its value, with the gradient of `preconditioned`.

    Args:
        mean, factor: of q, shapes [B, 3] and [B, 3, 3].
        found: every sample's misfit around its mean.
        lower, upper: φ's box, shape [3].

    Returns:
        Scalar, the linearised bound in nats without the likelihood's constant.
    """
    misfit, gradient, information = (mean.new_tensor(np.stack(values)) for values in zip(*found, strict=True))
    surrogate = preconditioned(mean, factor, gradient, information, lower, upper)
    prior, away = _prior(mean, lower, upper)
    bound = (misfit + _divergence(factor.detach(), away, information + prior, prior)).mean()
    return surrogate + (bound - surrogate).detach()


def preconditioned(
    mean: Tensor,
    factor: Tensor,
    gradient: Tensor,
    information: Tensor,
    lower: Tensor,
    upper: Tensor,
    *,
    whiten: bool = True,
) -> Tensor:
    """`evidence_loss` with the prior added and every mean's pull H·move replaced by √H·move, no longer than allowed.

    It vanishes where the bound's own does. What is known a hundred times better than something else would otherwise be
    learnt ten thousand times faster, and one badly explained contact would drown all others.

    Args:
        mean, factor: of q, shapes [B, 3] and [B, 3, 3].
        gradient, information: of the misfits at the means, shapes [B, 3] and [B, 3, 3], constants.
        lower, upper: φ's box, shape [3].
        whiten: off for the plain pull, divided by the root of H's mean diagonal: at first, what can be known best may
            well be learnt first.
    """
    prior, away = _prior(mean, lower, upper)
    gradient, information = gradient + away @ prior, information + prior
    values, vectors = torch.linalg.eigh(information)
    along = torch.einsum("brq,br->bq", vectors, gradient)
    move = torch.einsum("bpq,bq->bp", vectors, along / values)
    if whiten:
        pull = PULL * torch.einsum("bpq,bq->bp", vectors, along * values.rsqrt())
    else:
        pull = gradient / values.mean(dim=1, keepdim=True).sqrt()
    shorter = (LONGEST_MOVE / move.abs().amax(dim=1).clamp(min=1e-12)).clamp(max=1.0)
    return evidence_loss(mean, factor, pull, information, shorter)


def _prior(mean: Tensor, lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor]:
    """The prior's precision [3, 3], and how far the means lie from its own [B, 3], constants."""
    return torch.diag(12 / (upper - lower).square()), mean.detach() - 0.5 * (lower + upper)


def _divergence(factor: Tensor, away: Tensor, information: Tensor, prior: Tensor) -> Tensor:
    """KL(q‖prior) with the likelihood's curvature in place of the prior's: ½[tr(ΣH) + dᵀPd - 3 - log det ΣP], [B]."""
    spread = (factor.transpose(1, 2) @ information @ factor).diagonal(dim1=1, dim2=2).sum(1)
    logarithm = 2 * torch.log(factor.diagonal(dim1=1, dim2=2)).sum(1) + torch.logdet(prior)
    return 0.5 * (spread + (away @ prior * away).sum(1) - 3 - logarithm)


def _on_cpu(batch: Batch) -> Batch:
    """The batch's tensors where compiled code can read them."""
    fields = {entry.name: getattr(batch, entry.name) for entry in dataclasses.fields(batch)}
    return dataclasses.replace(batch, **{k: v.cpu() for k, v in fields.items() if isinstance(v, Tensor)})
