"""Batches against what was observed: the paper's squared error, and the likelihood around each sample's φ.

Source: Bini 2026, equation 14 (the squared 2-norm of a displacement's difference), extended to several time stamps.
"""

import numpy as np
import torch
from torch import Tensor

from palpate.physics.msd.batch import DepthBatch, ObservationBatch


def displacement_error(trajectory: Tensor, observation: ObservationBatch) -> Tensor:
    """Weighted mean of squared distances, Σ_m w_m ‖u(t_m) − d_m‖² / Σ_m w_m (Bini 2026, equation 14, with M = 1).

    Args:
        trajectory: displacement of the contact vertex, shape [B, T, 3] [scene units].
        observation: what was observed; padding may hold anything, also NaN.

    Returns:
        Shape [B] [scene units²]; 0 for a sample without any observation.
    """
    weight = observation.weight.clamp(min=0.0)
    total = weight.sum(dim=1)
    squared = _difference(trajectory, observation).square().sum(dim=-1)
    return (weight * squared).sum(dim=1) / torch.where(total > 0, total, 1.0)


def linearise_depth(path: Tensor, slopes: Tensor, theta: Tensor, observation: DepthBatch) -> tuple[Tensor, ...]:
    """-log p(d|φ) = ½ Σ r² of observed depth around every sample's φ, common errors marginalised (Woodbury's identity).

    What the pixels show is decided at every sample's own motion; that it changes with φ is in the derivatives as far as
    the view says so.

    Args:
        path: displacement of the V vertices, shape [B, T, V, 3] [scene units].
        slopes: its derivatives by θ, shape [B, T, V, 3, 3].
        theta: k_s, k_d and signed F, shape [B, 3] [normalised].
        observation: what was observed of these vertices.

    Returns:
        The misfit ½ Σ r² [B], its gradient [B, 3] and the Fisher information [B, 3, 3] by φ; 0 where nothing was
        observed.
    """
    samples = torch.arange(len(path), device=path.device)[:, None]
    steps = observation.steps.clamp(0, path.shape[1] - 1)
    moved = path[samples, steps].double()
    tangent = slopes[samples, steps].double() * theta.double()[:, None, None, None]
    change, jacobian = _seen(observation, moved, tangent)
    known = (observation.weight > 0) & change.isfinite()
    share = torch.where(known, observation.weight, 0.0).double() / observation.noise.double()[:, None, None]
    residual = share * torch.where(known, change - observation.change.double(), 0.0)
    jacobian = share[..., None] * torch.where(known[..., None], jacobian, 0.0)
    columns = torch.cat([jacobian, residual[..., None]], dim=-1)
    common = observation.common.double()
    products = torch.einsum("bnpi,bnpj->bij", columns, columns)
    shared = torch.einsum("bpi,pk->bki", columns.sum(dim=1), common)
    inner = torch.einsum("bp,pk,pl->bkl", known.double().sum(dim=1), common, common)
    inner = inner + torch.eye(common.shape[1], dtype=inner.dtype, device=inner.device)
    left = products - shared.transpose(1, 2) @ torch.linalg.solve(inner, shared)
    return 0.5 * left[:, 3, 3], left[:, :3, 3], left[:, :3, :3]


def _seen(observation: DepthBatch, moved: Tensor, tangent: Tensor) -> tuple[Tensor, Tensor]:
    """Change of the depth of every sample's pixels, and its derivatives by φ, shapes [B, N, P] and [B, N, P, 3].

    Args:
        observation: whose views say what is observed.
        moved, tangent: displacements of the vertices [B, N, V, 3] and their derivatives [B, N, V, 3, 3].
    """
    found = []
    for view, *motion in zip(observation.views, moved.detach(), tangent.detach(), strict=True):
        found.append(view.seen(*(values[:, : len(view.vertices)].cpu().numpy() for values in motion)))
    change, slopes = (torch.from_numpy(np.stack(values)).to(moved) for values in zip(*found, strict=True))
    return change, slopes


def _difference(trajectory: Tensor, observation: ObservationBatch) -> Tensor:
    """Simulated minus observed displacement [B, M, 3]; 0 where nothing was observed."""
    steps = observation.steps.clamp(0, trajectory.shape[1] - 1)
    simulated = torch.gather(trajectory, 1, steps[..., None].expand(-1, -1, 3))
    return torch.where((observation.weight > 0)[..., None], simulated - observation.displacement, 0.0)
