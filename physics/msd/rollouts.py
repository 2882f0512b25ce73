"""Differentiable mass-spring-damper rollout on batches of meshes: from θ to the trajectories of a few vertices.

Source: Bini 2026, section 3.3 (equation 9, table 1); Φ_MSD of the physics loss (equation 14).
"""

import torch
from torch import Tensor

from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.autograd import CompiledRollout
from palpate.physics.msd.batch import MeshBatch, PressBatch

DEFAULT = Mechanics()


def rollout(
    theta: Tensor,
    mesh: MeshBatch,
    load: PressBatch,
    mechanics: Mechanics = DEFAULT,
    watch: Tensor | None = None,
) -> Tensor:
    """Displacement of a few vertices after each step, differentiable in θ.

    Args:
        theta: k_s, k_d and signed F, shape [B, 3] [normalised]; computed in its precision, float32 at least.
        mesh: B meshes at rest.
        load: what acts on them; its number of steps T is the rollout's.
        mechanics: constants.
        watch: M vertices of each mesh, shape [B, M], int64; none = the load's first one.

    Returns:
        Shape [B, T, M, 3], or [B, T, 3] without `watch` [scene units]; index i is the time (i+1)·Δt.

    Raises:
        ValueError: shapes that don't belong together, tensors that aren't on the CPU, where it is
            computed, or a mesh or load whose gradient is wanted: it has those by θ alone.
    """
    theta = _checked(theta, mesh, load)
    watched = _watched(mesh, load, watch)
    sensitive = torch.is_grad_enabled() and theta.requires_grad
    found, _ = CompiledRollout.apply(theta, mesh, load, watched, mechanics, sensitive)
    return found[:, :, 0] if watch is None else found


def rollout_sensitivities(
    theta: Tensor,
    mesh: MeshBatch,
    load: PressBatch,
    mechanics: Mechanics = DEFAULT,
    watch: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """What `rollout` gives, and its exact derivatives by k_s, k_d and F in the same pass, both constants.

    Arguments and errors as in `rollout`. The derivatives have θ as a further last axis; they are 0, with a warning,
    where the compiled motion is so chaotic that rounding decides them.
    """
    theta = _checked(theta.detach(), mesh, load)
    watched = _watched(mesh, load, watch)
    found, slopes = CompiledRollout.apply(theta, mesh, load, watched, mechanics, True)
    return (found[:, :, 0], slopes[:, :, 0]) if watch is None else (found, slopes)


def _checked(theta: Tensor, mesh: MeshBatch, load: PressBatch) -> Tensor:
    """θ in at least single precision, or a ValueError that names what doesn't belong together."""
    batch = mesh.vertex_offsets.shape[0] - 1
    for name, value, shape in (
        ("theta", theta, (batch, 3)),
        ("load.offsets", load.offsets, (batch + 1,)),
        ("load.weights", load.weights, tuple(load.vertices.shape)),
        ("load.direction", load.direction, (batch, 3)),
        ("load.factor", load.factor, (batch, load.steps)),
    ):
        if tuple(value.shape) != shape:
            raise ValueError(f"{name} has shape {tuple(value.shape)}; give {shape} for {batch} meshes.")
    if any(tensor.device.type != "cpu" for tensor in (theta, mesh.vertices, load.direction)):
        raise ValueError("the rollout computes on the CPU; move theta, the meshes and the loads there.")
    if mesh.vertices.requires_grad or load.direction.requires_grad:
        raise ValueError("the rollout has gradients by theta only; detach the meshes and the loads.")
    return theta.to(torch.promote_types(theta.dtype, torch.float32))


def _watched(mesh: MeshBatch, load: PressBatch, watch: Tensor | None) -> Tensor:
    """Vertices to watch, shape [B, M]."""
    if watch is None:
        return load.vertices[load.offsets[:-1]][:, None]
    batch = mesh.vertex_offsets.shape[0] - 1
    if watch.ndim != 2 or watch.shape[0] != batch:
        raise ValueError(f"watch has shape {tuple(watch.shape)}; give [{batch}, M] for {batch} meshes.")
    return watch
