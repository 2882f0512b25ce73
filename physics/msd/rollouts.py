"""Differentiable mass-spring-damper rollout on batches of meshes: from θ to the trajectories of a few vertices.

Source: Bini 2026, section 3.3 (equation 9, table 1); Φ_MSD of the physics loss (equation 14).
"""

from __future__ import annotations

import functools
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from physics import jit
from physics.mechanics import Mechanics
from physics.msd import torch_backend
from physics.msd.autograd import CompiledFields, CompiledRollout, cases, map_samples
from physics.msd.batch import GripBatch, LoadBatch, MeshBatch, PressBatch
from physics.msd.compiled import field_rollout

DEFAULT = Mechanics()

Backend = Literal["auto", "numba", "torch"]
"""numba: compiled, CPU, gradients by θ. torch: plain, any device, every derivative. auto: the faster that fits."""


def rollout(
    theta: Tensor,
    mesh: MeshBatch,
    load: LoadBatch,
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
    if _compiled(backend, (theta,), mesh, load):
        sensitive = torch.is_grad_enabled() and theta.requires_grad
        found, _ = CompiledRollout.apply(theta, mesh, load, watched, mechanics, sensitive)
    else:
        found = torch_backend.watched_trajectory(theta, mesh, load, watched, mechanics)
    return found[:, :, 0] if watch is None else found


def rollout_sensitivities(
    theta: Tensor,
    mesh: MeshBatch,
    load: LoadBatch,
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
    if _compiled(backend, (theta,), mesh, load):
        found, slopes = CompiledRollout.apply(theta, mesh, load, watched, mechanics, True)
    else:

        def moved(shift: Tensor) -> tuple[Tensor, Tensor]:
            path = torch_backend.watched_trajectory(theta + shift, mesh, load, watched, mechanics)
            return path, path

        with torch.no_grad():
            slopes, found = torch.func.jacfwd(moved, has_aux=True)(theta.new_zeros(3))
    return (found[:, :, 0], slopes[:, :, 0]) if watch is None else (found, slopes)


def rollout_field(
    theta: Tensor, mesh: MeshBatch, load: LoadBatch, mechanics: Mechanics = DEFAULT, backend: Backend = "auto"
) -> Tensor:
    """Displacement of every vertex after each step, shape [T, ΣN, 3] [scene units]; arguments as in `rollout`.

    Differentiable with the torch backend, which "auto" takes where a gradient is wanted.
    """
    theta = _checked(theta, mesh, load)
    wanted = torch.is_grad_enabled() and theta.requires_grad
    if wanted and backend == "numba":
        raise ValueError("the compiled whole field has no gradient; pass backend='torch' or detach theta.")
    if not wanted and _compiled(backend, (theta,), mesh, load):
        # numpy asks for huge pages and torch doesn't: with small ones, page faults take longer than the motion.
        field = np.empty((load.steps, len(mesh.vertices), 3), theta.detach().numpy().dtype)
        samples = cases(theta, mesh, load, _watched(mesh, load, None), mechanics)
        pairs = list(zip(samples, mesh.vertex_offsets.tolist(), strict=False))
        map_samples(lambda sample: field_rollout(sample[0], field, sample[1]), pairs)
        return torch.from_numpy(field)
    parameters = (*torch_backend.uniform(theta, mesh), theta[:, 2:3])
    return torch.stack(list(torch_backend.edge_steps(*parameters, mesh, load, mechanics)))


def rollout_heterogeneous(
    stiffness: Tensor,
    damping: Tensor,
    force: Tensor,
    mesh: MeshBatch,
    load: LoadBatch,
    mechanics: Mechanics = DEFAULT,
    backend: Backend = "auto",
    watch: Tensor | None = None,
) -> Tensor:
    """Displacement of a few vertices for tissue that differs from place to place.

    Args:
        stiffness: k_s at every vertex, shape [ΣN] [normalised]; a spring has the mean of its ends.
        damping: k_d at every vertex, shape [ΣN] [normalised].
        force: signed F, shape [B] [normalised]; means nothing under a grip.
        mesh, load, mechanics, backend, watch: as in `rollout`; ``window_error`` isn't used.

    Returns:
        As `rollout`, differentiable in all three parameters.

    Raises:
        ValueError: shapes that don't belong together, or a backend that can't do it.
    """
    count, batch = mesh.vertices.shape[0], mesh.vertex_offsets.shape[0] - 1
    for name, value, size in (("stiffness", stiffness, count), ("damping", damping, count), ("force", force, batch)):
        if tuple(value.shape) != (size,):
            raise ValueError(f"{name} has shape {tuple(value.shape)}; give ({size},) for this batch.")
    dtype = functools.reduce(torch.promote_types, (stiffness.dtype, damping.dtype, force.dtype, torch.float32))
    stiffness, damping, force = (value.to(dtype) for value in (stiffness, damping, force))
    _checked(force[:, None].expand(-1, 3), mesh, load)
    watched = _watched(mesh, load, watch)
    if _compiled(backend, (stiffness, damping, force), mesh, load):
        found = CompiledFields.apply(stiffness, damping, force, mesh, load, watched, mechanics)
    else:
        parameters = (stiffness[:, None], damping[:, None], force[:, None])
        place = torch_backend.places("watch", watched, mesh.vertex_offsets[:-1, None], mesh.vertex_offsets[1:, None])
        fields = torch_backend.edge_steps(*parameters, mesh, load, mechanics)
        found = torch.stack([field[place] for field in fields], dim=1)
    return found[:, :, 0] if watch is None else found


def _checked(theta: Tensor, mesh: MeshBatch, load: LoadBatch) -> Tensor:
    """θ in at least single precision, or a ValueError that names the shapes that don't belong together."""
    batch, count, steps = mesh.vertex_offsets.shape[0] - 1, load.vertices.shape[0], load.steps
    expected = [("theta", theta, (batch, 3)), ("load.offsets", load.offsets, (batch + 1,))]
    if isinstance(load, PressBatch):
        expected += [("load.weights", load.weights, (count,)), ("load.direction", load.direction, (batch, 3))]
        expected.append(("load.factor", load.factor, (batch, steps)))
    else:
        expected.append(("load.displacement", load.displacement, (steps, count, 3)))
    for name, value, shape in expected:
        if tuple(value.shape) != shape:
            raise ValueError(f"{name} has shape {tuple(value.shape)}; give {shape} for {batch} meshes.")
    return theta.to(torch.promote_types(theta.dtype, torch.float32))


def _watched(mesh: MeshBatch, load: LoadBatch, watch: Tensor | None) -> Tensor:
    """Vertices to watch, shape [B, M]."""
    if watch is None:
        return load.vertices[load.offsets[:-1]][:, None]
    batch = mesh.vertex_offsets.shape[0] - 1
    if watch.ndim != 2 or watch.shape[0] != batch:
        raise ValueError(f"watch has shape {tuple(watch.shape)}; give [{batch}, M] for {batch} meshes.")
    return watch


def _compiled(backend: Backend, parameters: tuple[Tensor, ...], mesh: MeshBatch, load: LoadBatch) -> bool:
    """Whether the compiled kernels run, or a ValueError where they are asked for and can't."""
    if backend not in ("auto", "numba", "torch"):
        raise ValueError(f"backend is {backend!r}; choose auto, numba or torch.")
    if backend == "torch":
        return False
    acts = load.displacement if isinstance(load, GripBatch) else load.direction
    on_cpu = all(tensor.device.type == "cpu" for tensor in (*parameters, mesh.vertices, acts))
    constant = not (mesh.vertices.requires_grad or acts.requires_grad)
    if backend == "numba":
        if not jit.COMPILED:
            raise ValueError("backend is numba, which isn't installed; pip install numba, or choose auto.")
        if not on_cpu:
            raise ValueError("backend is numba, which computes on the CPU; move the batch there, or choose auto.")
        if not constant:
            raise ValueError("backend numba has gradients by the parameters only; choose torch for the mesh's.")
    if on_cpu and not jit.COMPILED:
        jit.say_slow()
    return jit.COMPILED and on_cpu and constant
