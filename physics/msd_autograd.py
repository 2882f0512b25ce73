"""Torch's view of the compiled rollout: autograd functions over `physics.msd_compiled` and the adjoint.

The derivatives by θ are carried along with the motion (forward mode), so backward is one product and keeps only the
Jacobian, 7 kB a sample. Per-vertex parameters go back through the stored velocities (adjoint).
"""

from __future__ import annotations

import functools
import os
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from torch import Tensor

from physics.cone import exact_radii
from physics.edge_kernel import edge_adjoint, edge_forward
from physics.mechanics import Mechanics
from physics.mesh import Mesh
from physics.msd_compiled import Case, contact_rollout, require_inside
from physics.msd_numpy import NORM_GUARD, free_vertices, integrator
from physics.spring_graph import spring_graph

SENSITIVITY_LIMIT = {np.dtype(np.float32): 100.0, np.dtype(np.float64): 1e8}
"""Relative change of the trajectory for a relative change of θ from which on rounding spoils the derivatives.

Measured in single precision on a 14,800-vertex mesh: below 20 they agree with double precision to 1 %, at 100 to 10 %.
"""


class UnreliableGradient(RuntimeWarning):
    """The motion is chaotic, so its derivatives by θ carry no information."""


def map_samples(function: Callable, samples: list) -> list:
    """Call a function for every sample, on as many threads as torch uses; each sample is computed by one thread."""
    threads = min(torch.get_num_threads(), len(samples))
    if threads == 1:
        return [function(sample) for sample in samples]
    return list(_pool(os.getpid(), threads).map(function, samples))


@functools.lru_cache(maxsize=8)
def _pool(_process: int, threads: int) -> ThreadPoolExecutor:
    """Threads of this process: a forked child must not use its parent's."""
    return ThreadPoolExecutor(threads, thread_name_prefix="rollout")


def cases(theta: Tensor, mesh, contact, load: Tensor, mechanics: Mechanics) -> list[Case]:
    """Batch as plain arrays, one case a sample; arguments as in `physics.msd_torch.contact_trajectory`."""
    values, profile = theta.detach().numpy(), load.detach().numpy()
    vertex, direction = contact.vertex.numpy(), contact.direction.detach().numpy()
    samples = []
    for index, single in enumerate(split(mesh)):
        require_inside(single, int(vertex[index]))
        samples.append(Case(values[index], single, int(vertex[index]), direction[index], profile[index], mechanics))
    return samples


def split(mesh) -> list[Mesh]:
    """The meshes of a batch, without their triangles."""
    starts, spring_starts = mesh.vertex_offsets.tolist(), mesh.spring_offsets.tolist()
    vertices, springs = mesh.vertices.detach().numpy(), mesh.springs.numpy()
    rim, pixels = mesh.rim.numpy(), mesh.pixels.numpy()
    return [
        Mesh(
            vertices=vertices[start:end],
            triangles=np.empty((0, 3), np.int32),
            springs=(springs[first:last] - start).astype(np.int32),
            rim=rim[start:end],
            pixels=pixels[start:end].astype(np.int32),
            grid_shape=tuple(mesh.grid_shape),
        )
        for start, end, first, last in zip(starts[:-1], starts[1:], spring_starts[:-1], spring_starts[1:], strict=True)
    ]


class CompiledRollout(torch.autograd.Function):
    """Contact trajectories [B, T, 3] from θ [B, 3]."""

    @staticmethod
    def forward(ctx, theta: Tensor, mesh, contact, load: Tensor, mechanics: Mechanics, sensitive: bool) -> Tensor:
        """Compute the trajectories, and the Jacobian if a gradient may be asked for."""
        samples = cases(theta, mesh, contact, load, mechanics)
        results = map_samples(functools.partial(contact_rollout, sensitive=sensitive), samples)
        if sensitive:
            jacobian = [_reliable(case, *result) for case, result in zip(samples, results, strict=True)]
            ctx.save_for_backward(torch.from_numpy(np.stack(jacobian)))
        return torch.from_numpy(np.stack([trajectory for trajectory, _ in results]))

    @staticmethod
    def backward(ctx, gradient: Tensor):
        """Chain with the Jacobian [B, T, 3, 3]."""
        (jacobian,) = ctx.saved_tensors
        return FirstOrder.apply(torch.einsum("btc,btcp->bp", gradient, jacobian)), None, None, None, None, None


class FirstOrder(torch.autograd.Function):
    """Identity that refuses to be differentiated."""

    @staticmethod
    def forward(ctx, value: Tensor) -> Tensor:
        """Pass the gradient on."""
        return value.clone()

    @staticmethod
    def backward(ctx, gradient: Tensor):
        """Refuse."""
        raise RuntimeError(
            "the compiled rollout has first derivatives only; pass backend='torch' to differentiate it twice."
        )


def _reliable(case: Case, trajectory: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """The Jacobian [T, 3, 3], or zeros and a warning where the motion is so chaotic that rounding decides it."""
    change = np.abs(jacobian * case.theta).max()
    if change > SENSITIVITY_LIMIT[trajectory.dtype] * np.abs(trajectory).max():
        stiffness, damping, force = (float(value) for value in case.theta)
        warnings.warn(
            f"the motion at k_s = {stiffness:.4g}, k_d = {damping:.4g}, F = {force:.4g} is chaotic, so its gradient "
            "by θ means nothing and 0 is returned for it; more damping, less force or a shorter horizon avoids it.",
            UnreliableGradient,
            stacklevel=2,
        )
        return np.zeros_like(jacobian)
    return jacobian


class CompiledFields(torch.autograd.Function):
    """Contact trajectories [B, T, 3] from k_s and k_d at every vertex [ΣN] and F [B]."""

    @staticmethod
    def forward(
        ctx, stiffness: Tensor, damping: Tensor, force: Tensor, mesh, contact, load: Tensor, mechanics
    ) -> Tensor:
        """Compute the trajectories and keep the velocities within the cone."""
        parameters = torch.stack([force, force, force], dim=1)
        starts = mesh.vertex_offsets.tolist()
        samples = [
            (case, stiffness.detach()[start:end].numpy(), damping.detach()[start:end].numpy())
            for case, start, end in zip(
                cases(parameters, mesh, contact, load, mechanics), starts[:-1], starts[1:], strict=True
            )
        ]
        ctx.runs = map_samples(lambda sample: FieldRun(*sample), samples)
        return torch.from_numpy(np.stack([run.trajectory for run in ctx.runs]))

    @staticmethod
    def backward(ctx, gradient: Tensor):
        """Go back through the stored velocities."""
        weights = gradient.detach().numpy()
        slopes = map_samples(lambda pair: pair[0].slopes(pair[1]), list(zip(ctx.runs, weights, strict=True)))
        stiffness, damping, force = zip(*slopes, strict=True)
        joined = (np.concatenate(stiffness), np.concatenate(damping), np.array(force, dtype=weights.dtype))
        return *(FirstOrder.apply(torch.from_numpy(values)) for values in joined), None, None, None, None


class FieldRun:
    """One sample's rollout with parameters of its own at every vertex, and the way back."""

    def __init__(self, case: Case, stiffness: np.ndarray, damping: np.ndarray) -> None:
        """Roll out.

        Args:
            case: the sample; only F is taken from its θ.
            stiffness: k_s at the vertices, shape [N]; a spring has its ends' mean.
            damping: k_d at the vertices, shape [N].
        """
        dtype, mechanics = case.theta.dtype, case.mechanics
        radii = exact_radii(mechanics.steps)
        self.case, self.count = case, len(stiffness)
        self.graph = graph = spring_graph(case.mesh, case.vertex, int(radii.max()), dtype)
        self.step = integrator(damping[graph.order], mechanics)
        self.free = free_vertices(case.mesh, case.vertex, mechanics)[graph.order]
        local = stiffness[graph.order].astype(dtype)
        self.forward = (
            graph.springs,
            graph.rest,
            graph.length,
            local[graph.springs].mean(axis=1),
            (mechanics.anchor * local).astype(dtype),
            (self.step.keep * self.free).astype(dtype),
            (self.step.kick * self.free).astype(dtype),
            *graph.prefixes(radii),
            case.load.astype(dtype),
            (case.theta[2] * np.asarray(case.direction)).astype(dtype),
            tuple(dtype.type(value) for value in (mechanics.time_step, self.step.lag, 0.0, NORM_GUARD)),
        )
        self.trajectory = np.empty((mechanics.steps, 3), dtype)
        self.speeds = np.zeros((mechanics.steps, len(graph.order), 3), dtype)
        edge_forward(*self.forward, self.trajectory, self.speeds, np.empty((0, len(graph.order), 3), dtype))

    def slopes(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Derivatives of Σ weights·trajectory, weights [T, 3]: by k_s [N], by k_d [N] and by F."""
        graph, dtype, mechanics = self.graph, self.trajectory.dtype, self.case.mechanics
        spring_slope = np.zeros(len(graph.springs), dtype)
        anchor_slope, keep_slope, kick_slope = np.zeros((3, len(graph.order)), dtype)
        final = (mechanics.time_step * self.speeds.sum(axis=0, dtype=np.float64)).astype(dtype)
        by_push = edge_adjoint(
            *self.forward, final, self.speeds, np.ascontiguousarray(weights, dtype), spring_slope, anchor_slope,
            keep_slope, kick_slope,
        )  # fmt: skip
        stiffness, damping = np.zeros((2, self.count), dtype)
        local = mechanics.anchor * anchor_slope
        np.add.at(local, graph.springs, spring_slope[:, None] / 2)
        stiffness[graph.order] = local
        chained = keep_slope * self.step.keep_slope + kick_slope * self.step.kick_slope
        damping[graph.order] = chained * self.free
        return stiffness, damping, float(by_push @ np.asarray(self.case.direction, dtype))
