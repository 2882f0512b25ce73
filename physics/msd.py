"""Differentiable mass-spring-damper rollout on batches of meshes: from θ to the contact vertex's trajectory.

Source: Bini 2026, section 3.3 (equation 9, table 1); Φ_MSD of the physics loss (equation 14).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from physics import jit, msd_torch
from physics.mechanics import Mechanics
from physics.mesh import Mesh
from physics.msd_autograd import CompiledFields, CompiledRollout, cases, map_samples
from physics.msd_compiled import field_rollout


@dataclass
class MeshBatch:
    """B meshes joined into one."""

    vertices: Tensor
    """Positions at rest, shape [ΣN, 3], float32 [scene units]."""
    springs: Tensor
    """Indices into the joined vertices, shape [ΣS, 2], int64."""
    rim: Tensor
    """Vertices held with a fixed boundary, shape [ΣN], bool."""
    pixels: Tensor
    """Row and column in the grid, shape [ΣN, 2], int64."""
    vertex_offsets: Tensor
    """First vertex of every mesh and the total, shape [B+1], int64."""
    spring_offsets: Tensor
    """First spring of every mesh and the total, shape [B+1], int64."""
    grid_shape: tuple[int, int]
    """Height and width of the grid [px]."""

    @classmethod
    def from_meshes(cls, meshes: list[Mesh]) -> MeshBatch:
        """Join meshes of one grid shape.

        Raises:
            ValueError: no mesh, an empty mesh, or meshes of differing grids.
        """
        if not meshes:
            raise ValueError("no mesh to join; give at least one.")
        if any(len(mesh.vertices) == 0 for mesh in meshes):
            raise ValueError("a mesh has no vertices; leave frames without tissue out of the batch.")
        if len({tuple(mesh.grid_shape) for mesh in meshes}) > 1:
            raise ValueError(f"meshes of grids {sorted({tuple(m.grid_shape) for m in meshes})} don't form one batch.")
        vertex_offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        spring_offsets = np.cumsum([0, *(len(mesh.springs) for mesh in meshes)])
        springs = [mesh.springs.astype(np.int64) + start for mesh, start in zip(meshes, vertex_offsets, strict=False)]
        return cls(
            vertices=torch.from_numpy(np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32)),
            springs=torch.from_numpy(np.concatenate(springs)),
            rim=torch.from_numpy(np.concatenate([mesh.rim for mesh in meshes])),
            pixels=torch.from_numpy(np.concatenate([mesh.pixels for mesh in meshes]).astype(np.int64)),
            vertex_offsets=torch.from_numpy(vertex_offsets),
            spring_offsets=torch.from_numpy(spring_offsets),
            grid_shape=tuple(meshes[0].grid_shape),
        )

    def sample_of_vertex(self) -> Tensor:
        """Which mesh a joined vertex belongs to, shape [ΣN], int64."""
        index = torch.arange(self.vertices.shape[0], device=self.vertices.device)
        return torch.searchsorted(self.vertex_offsets[1:].contiguous(), index, right=True)


@dataclass
class ContactBatch:
    """Where and how long the tool pushes."""

    vertex: Tensor
    """Contact vertex, an index within its own mesh, shape [B], int64."""
    direction: Tensor
    """Unit vector of the force; F·direction acts, shape [B, 3], float32."""
    load_steps: Tensor
    """Steps under load, from the start, shape [B], int64."""
    load: Tensor | None = None
    """Factor of F in each step, shape [B, T]; where given, it replaces ``load_steps``."""

    def profile(self, steps: int) -> Tensor:
        """Factor of F in each step, shape [B, T], float."""
        if self.load is not None:
            return self.load
        return torch.arange(steps, device=self.load_steps.device) < self.load_steps[:, None]


DEFAULT = Mechanics()

Backend = Literal["auto", "numba", "torch"]
"""numba: compiled, CPU, gradients by θ. torch: plain, any device, every derivative. auto: the faster that fits."""


def rollout(
    theta: Tensor,
    mesh: MeshBatch,
    contact: ContactBatch,
    mechanics: Mechanics = DEFAULT,
    backend: Backend = "auto",
) -> Tensor:
    """Displacement of the contact vertices after each step, differentiable in θ.

    Args:
        theta: k_s, k_d and signed F, shape [B, 3] [normalised]; computed in its precision, float32 at least.
        mesh: B meshes at rest.
        contact: B contacts.
        mechanics: constants.
        backend: what computes it.

    Returns:
        Shape [B, T, 3] [scene units]; index i is the time (i+1)·Δt.

    Raises:
        ValueError: shapes that don't belong together, or a backend that can't do it.
    """
    theta, load = _check(theta, mesh, contact, mechanics)
    if _compiled(backend, (theta,), mesh, contact):
        sensitive = torch.is_grad_enabled() and theta.requires_grad
        return CompiledRollout.apply(theta, mesh, contact, load, mechanics, sensitive)
    return msd_torch.contact_trajectory(theta, mesh, contact, load, mechanics)


def rollout_field(
    theta: Tensor,
    mesh: MeshBatch,
    contact: ContactBatch,
    mechanics: Mechanics = DEFAULT,
    backend: Backend = "auto",
) -> Tensor:
    """Displacement of every vertex after each step, shape [T, ΣN, 3] [scene units]; arguments as in `rollout`.

    Differentiable with the torch backend, which "auto" takes where a gradient is wanted.
    """
    theta, load = _check(theta, mesh, contact, mechanics)
    wanted = torch.is_grad_enabled() and theta.requires_grad
    if wanted and backend == "numba":
        raise ValueError("the compiled whole field has no gradient; pass backend='torch' or detach theta.")
    if not wanted and _compiled(backend, (theta,), mesh, contact):
        # numpy asks for huge pages and torch doesn't: with small ones, page faults take longer than the motion.
        field = np.empty((mechanics.steps, len(mesh.vertices), 3), theta.detach().numpy().dtype)
        samples = zip(cases(theta, mesh, contact, load, mechanics), mesh.vertex_offsets.tolist(), strict=False)
        map_samples(lambda sample: field_rollout(sample[0], field, sample[1]), list(samples))
        return torch.from_numpy(field)
    parameters = (*msd_torch.uniform(theta, mesh), theta[:, 2:3])
    return torch.stack(list(msd_torch.edge_steps(*parameters, mesh, contact, load, mechanics)))


def rollout_heterogeneous(
    stiffness: Tensor,
    damping: Tensor,
    force: Tensor,
    mesh: MeshBatch,
    contact: ContactBatch,
    mechanics: Mechanics = DEFAULT,
    backend: Backend = "auto",
) -> Tensor:
    """Displacement of the contact vertices for tissue that differs from place to place.

    Args:
        stiffness: k_s at every vertex, shape [ΣN] [normalised]; a spring has the mean of its ends.
        damping: k_d at every vertex, shape [ΣN] [normalised].
        force: signed F, shape [B] [normalised].
        mesh, contact, mechanics, backend: as in `rollout`; ``window_error`` isn't used.

    Returns:
        Shape [B, T, 3] [scene units], differentiable in all three parameters.

    Raises:
        ValueError: shapes that don't belong together, or a backend that can't do it.
    """
    count, batch = mesh.vertices.shape[0], mesh.vertex_offsets.shape[0] - 1
    for name, value, size in (("stiffness", stiffness, count), ("damping", damping, count), ("force", force, batch)):
        if tuple(value.shape) != (size,):
            raise ValueError(f"{name} has shape {tuple(value.shape)}; give ({size},) for this batch.")
    dtype = functools.reduce(torch.promote_types, (stiffness.dtype, damping.dtype, force.dtype, torch.float32))
    stiffness, damping, force = (value.to(dtype) for value in (stiffness, damping, force))
    load = _check(force[:, None].expand(-1, 3), mesh, contact, mechanics)[1]
    if _compiled(backend, (stiffness, damping, force), mesh, contact):
        return CompiledFields.apply(stiffness, damping, force, mesh, contact, load, mechanics)
    parameters = (stiffness[:, None], damping[:, None], force[:, None])
    touched = mesh.vertex_offsets[:-1] + contact.vertex
    fields = msd_torch.edge_steps(*parameters, mesh, contact, load, mechanics)
    return torch.stack([field[touched] for field in fields], dim=1)


def _check(theta: Tensor, mesh: MeshBatch, contact: ContactBatch, mechanics: Mechanics) -> tuple[Tensor, Tensor]:
    """θ in at least single precision and the load profile [B, T], or a ValueError that names the shapes."""
    batch = mesh.vertex_offsets.shape[0] - 1
    for name, value, shape in (
        ("theta", theta, (batch, 3)),
        ("contact.vertex", contact.vertex, (batch,)),
        ("contact.direction", contact.direction, (batch, 3)),
        ("contact load", load := contact.profile(mechanics.steps), (batch, mechanics.steps)),
    ):
        if tuple(value.shape) != shape:
            raise ValueError(f"{name} has shape {tuple(value.shape)}; give {shape} for {batch} meshes.")
    return theta.to(torch.promote_types(theta.dtype, torch.float32)), load


def _compiled(backend: Backend, parameters: tuple[Tensor, ...], mesh: MeshBatch, contact: ContactBatch) -> bool:
    """Whether the compiled kernels run, or a ValueError where they are asked for and can't."""
    if backend not in ("auto", "numba", "torch"):
        raise ValueError(f"backend is {backend!r}; choose auto, numba or torch.")
    if backend == "torch":
        return False
    on_cpu = all(tensor.device.type == "cpu" for tensor in (*parameters, mesh.vertices, contact.vertex))
    constant = not (mesh.vertices.requires_grad or contact.direction.requires_grad)
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
