"""Differentiable mass-spring-damper rollout on batches of meshes: from θ to the trajectories of a few vertices.

Source: Bini 2026, section 3.3 (equation 9, table 1); Φ_MSD of the physics loss (equation 14).
"""

from typing import Literal

import torch
from torch import Tensor

from palpate.physics import jit
from palpate.physics.mechanics import Mechanics
from palpate.physics.msd import torch_backend
from palpate.physics.msd.autograd import CompiledRollout
from palpate.physics.msd.batch import MeshBatch, PressBatch

DEFAULT = Mechanics()

Backend = Literal["auto", "numba", "torch"]
"""numba: compiled, CPU, gradients by θ. torch: plain, any device, every derivative. auto: the faster that fits."""


def rollout(
    theta: Tensor,
    mesh: MeshBatch,
    load: PressBatch,
    mechanics: Mechanics = DEFAULT,
    backend: Backend = "auto",
    watch: Tensor | None = None,
) -> Tensor:
    """Displacement of a few vertices after each step, differentiable in θ.

    Args:
        theta: k_s, k_d and signed F, shape [B, 3] [normalised]; computed in its precision, float32 at least.
        mesh: B meshes at rest.
        load: what acts on them; its number of steps T is the rollout's.
        mechanics: constants.
        backend: what computes it.
        watch: M vertices of each mesh, shape [B, M], int64; none = the load's first one.

    Returns:
        Shape [B, T, M, 3], or [B, T, 3] without `watch` [scene units]; index i is the time (i+1)·Δt.

    Raises:
        ValueError: shapes that don't belong together, or a backend that can't do it.
    """
    theta = _checked(theta, mesh, load)
    watched = _watched(mesh, load, watch)
    if _compiled(backend, theta, mesh, load):
        sensitive = torch.is_grad_enabled() and theta.requires_grad
        found, _ = CompiledRollout.apply(theta, mesh, load, watched, mechanics, sensitive)
    else:
        found = torch_backend.watched_trajectory(theta, mesh, load, watched, mechanics)
    return found[:, :, 0] if watch is None else found


def rollout_sensitivities(
    theta: Tensor,
    mesh: MeshBatch,
    load: PressBatch,
    mechanics: Mechanics = DEFAULT,
    backend: Backend = "auto",
    watch: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """What `rollout` gives, and its exact derivatives by k_s, k_d and F in the same pass, both constants.

    Arguments and errors as in `rollout`. The derivatives have θ as a further last axis; they are 0, with a warning,
    where the compiled motion is so chaotic that rounding decides them.
    """
    theta = _checked(theta.detach(), mesh, load)
    watched = _watched(mesh, load, watch)
    if _compiled(backend, theta, mesh, load):
        found, slopes = CompiledRollout.apply(theta, mesh, load, watched, mechanics, True)
    else:

        def moved(shift: Tensor) -> tuple[Tensor, Tensor]:
            path = torch_backend.watched_trajectory(theta + shift, mesh, load, watched, mechanics)
            return path, path

        with torch.no_grad():
            slopes, found = torch.func.jacfwd(moved, has_aux=True)(theta.new_zeros(3))
    return (found[:, :, 0], slopes[:, :, 0]) if watch is None else (found, slopes)


def _checked(theta: Tensor, mesh: MeshBatch, load: PressBatch) -> Tensor:
    """θ in at least single precision, or a ValueError that names the shapes that don't belong together."""
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
    return theta.to(torch.promote_types(theta.dtype, torch.float32))


def _watched(mesh: MeshBatch, load: PressBatch, watch: Tensor | None) -> Tensor:
    """Vertices to watch, shape [B, M]."""
    if watch is None:
        return load.vertices[load.offsets[:-1]][:, None]
    batch = mesh.vertex_offsets.shape[0] - 1
    if watch.ndim != 2 or watch.shape[0] != batch:
        raise ValueError(f"watch has shape {tuple(watch.shape)}; give [{batch}, M] for {batch} meshes.")
    return watch


def _compiled(backend: Backend, theta: Tensor, mesh: MeshBatch, load: PressBatch) -> bool:
    """Whether the compiled kernels run, or a ValueError where they are asked for and can't."""
    if backend not in ("auto", "numba", "torch"):
        raise ValueError(f"backend is {backend!r}; choose auto, numba or torch.")
    if backend == "torch":
        return False
    on_cpu = all(tensor.device.type == "cpu" for tensor in (theta, mesh.vertices, load.direction))
    constant = not (mesh.vertices.requires_grad or load.direction.requires_grad)
    if backend == "numba":
        if not jit.COMPILED:
            raise ValueError("backend is numba, which isn't installed; pip install numba, or choose auto.")
        if not on_cpu:
            raise ValueError("backend is numba, which computes on the CPU; move the batch there, or choose auto.")
        if not constant:
            raise ValueError("backend numba has gradients by θ only; choose torch for the mesh's.")
    if on_cpu and not jit.COMPILED:
        jit.say_slow()
    return jit.COMPILED and on_cpu and constant
