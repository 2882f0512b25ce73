"""Differentiable mass-spring-damper rollout on batches of meshes: from θ to the trajectories of a few vertices.

Source: Bini 2026, section 3.3 (equation 9, table 1); Φ_MSD of the physics loss (equation 14).
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from palpate.physics.load import Press
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import Mesh
from palpate.physics.msd.autograd import CompiledRollout

Watch = Tensor | None


def rollout(
    theta: Tensor,
    meshes: Sequence[Mesh],
    loads: Sequence[Press],
    mechanics: Mechanics,
    watch: Watch = None,
) -> Tensor:
    """Displacement of a few vertices after each step, differentiable in θ.

    Args:
        theta: k_s, k_d and signed F, shape [B, 3] [normalised]; computed in its precision, float32 at least.
        meshes: B meshes at rest.
        loads: load on each mesh; their number of steps T is the rollout's.
        mechanics: constants.
        watch: M vertices of each mesh, shape [B, M], int64; none = the contact vertex.

    Returns:
        Shape [B, T, M, 3], or [B, T, 3] without `watch` [scene units]; index i is the time (i+1)·Δt.

    Raises:
        ValueError: what doesn't belong together, or a θ that isn't on the CPU, where it is computed.
    """
    theta, watched = _checked(theta, meshes, loads, watch)
    sensitive = torch.is_grad_enabled() and theta.requires_grad
    found, _ = CompiledRollout.apply(theta, meshes, loads, watched, mechanics, sensitive)
    return found[:, :, 0] if watch is None else found


def rollout_sensitivities(
    theta: Tensor,
    meshes: Sequence[Mesh],
    loads: Sequence[Press],
    mechanics: Mechanics,
    watch: Watch = None,
) -> tuple[Tensor, Tensor]:
    """Result of `rollout`, and its exact derivatives by k_s, k_d and F in the same pass, both constants.

    Arguments and errors as in `rollout`. The derivatives have θ as a further last axis. They are 0, with a warning,
    where the motion is so chaotic that rounding decides them.
    """
    theta, watched = _checked(theta.detach(), meshes, loads, watch)
    found, slopes = CompiledRollout.apply(theta, meshes, loads, watched, mechanics, True)
    return (found[:, :, 0], slopes[:, :, 0]) if watch is None else (found, slopes)


def _checked(theta: Tensor, meshes: Sequence[Mesh], loads: Sequence[Press], watch: Watch) -> tuple[Tensor, Tensor]:
    """θ in at least single precision and vertices to watch [B, M]; a ValueError names what doesn't belong together."""
    if not meshes or len(loads) != len(meshes):
        raise ValueError(f"{len(meshes)} meshes have {len(loads)} loads; give a load for each mesh, one at least.")
    if tuple(theta.shape) != (len(meshes), 3):
        raise ValueError(f"theta has shape {tuple(theta.shape)}; give ({len(meshes)}, 3) for {len(meshes)} meshes.")
    if len({load.steps for load in loads}) > 1:
        raise ValueError(f"loads have {sorted({load.steps for load in loads})} steps; give all the same number.")
    if theta.device.type != "cpu":
        raise ValueError("the rollout computes on the CPU; move theta there.")
    if watch is None:
        watch = torch.tensor([[load.vertex] for load in loads])
    elif watch.ndim != 2 or watch.shape[0] != len(loads):
        raise ValueError(f"watch has shape {tuple(watch.shape)}; give [{len(loads)}, M] for {len(loads)} meshes.")
    return theta.to(torch.promote_types(theta.dtype, torch.float32)), watch
