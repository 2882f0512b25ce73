"""Torch's view of the compiled rollout: autograd functions over `physics.msd.compiled` and the adjoint.

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

from physics.mechanics import Mechanics
from physics.msd.batch import pieces
from physics.msd.compiled import Case, graph_reach, placed, put_gripped, require_inside, watched_rollout
from physics.msd.cone import exact_radii
from physics.msd.edge_kernel import Tissue, edge_adjoint, edge_forward
from physics.msd.reference import NORM_GUARD, acting, free_vertices, integrator
from physics.msd.simulation import is_chaotic
from physics.msd.spring_graph import spring_graph


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


def cases(theta: Tensor, mesh, load, watched: Tensor, mechanics: Mechanics) -> list[Case]:
    """Batch as plain arrays, one case a sample; arguments as in `physics.msd.torch_backend.watched_trajectory`."""
    values, watch, samples = theta.detach().numpy(), watched.numpy(), []
    for index, (single, acts) in enumerate(zip(mesh.split(), load.split(), strict=True)):
        require_inside(single, acts, watch[index])
        samples.append(Case(values[index], single, acts, mechanics, watch[index]))
    return samples


class CompiledRollout(torch.autograd.Function):
    """Trajectories [B, T, M, 3] and their Jacobian [B, T, M, 3, 3], a constant, from θ [B, 3]."""

    @staticmethod
    def forward(
        ctx, theta: Tensor, mesh, load, watched: Tensor, mechanics: Mechanics, sensitive: bool
    ) -> tuple[Tensor, Tensor]:
        """Compute the trajectories, and the Jacobian where it is wanted or a gradient may be; empty otherwise."""
        samples = cases(theta, mesh, load, watched, mechanics)
        results = map_samples(functools.partial(watched_rollout, sensitive=sensitive), samples)
        found = [
            _reliable(case, *result[:2]) if sensitive else result.slopes
            for case, result in zip(samples, results, strict=True)
        ]
        slopes = torch.from_numpy(np.stack(found))
        ctx.mark_non_differentiable(slopes)
        ctx.save_for_backward(slopes)
        return torch.from_numpy(np.stack([result.path for result in results])), slopes

    @staticmethod
    def backward(ctx, gradient: Tensor, _):  # ty: ignore[incompatible-method-override]  as torch documents it
        """Chain with the Jacobian [B, T, M, 3, 3]."""
        (slopes,) = ctx.saved_tensors
        by_theta = torch.einsum("btmc,btmcp->bp", gradient, slopes)
        return FirstOrder.apply(by_theta), None, None, None, None, None


class FirstOrder(torch.autograd.Function):
    """Identity that refuses to be differentiated."""

    @staticmethod
    def forward(ctx, value: Tensor) -> Tensor:
        """Pass the gradient on."""
        return value.clone()

    @staticmethod
    def backward(ctx, gradient: Tensor):  # ty: ignore[incompatible-method-override]  as torch documents it
        """Refuse."""
        raise RuntimeError(
            "the compiled rollout has first derivatives only; pass backend='torch' to differentiate it twice."
        )


def _reliable(case: Case, path: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The Jacobian [T, M, 3, 3], or zeros and a warning where the motion is so chaotic that rounding decides it."""
    if is_chaotic(path, slopes * case.theta):
        stiffness, damping, force = (float(value) for value in case.theta)
        warnings.warn(
            f"the motion at k_s = {stiffness:.4g}, k_d = {damping:.4g}, F = {force:.4g} is chaotic, so its gradient "
            "by θ means nothing and 0 is returned for it; more damping, less force or a shorter horizon avoids it.",
            UnreliableGradient,
            stacklevel=2,
        )
        return np.zeros_like(slopes)
    return slopes


class CompiledFields(torch.autograd.Function):
    """Trajectories [B, T, M, 3] from k_s and k_d at every vertex [ΣN] and F [B]."""

    @staticmethod
    def forward(
        ctx, stiffness: Tensor, damping: Tensor, force: Tensor, mesh, load, watched: Tensor, mechanics: Mechanics
    ) -> Tensor:
        """Compute the trajectories and keep the velocities within the cone."""
        fields = (pieces(values, mesh.vertex_offsets) for values in (stiffness, damping))
        samples = zip(cases(force[:, None].expand(-1, 3), mesh, load, watched, mechanics), *fields, strict=True)
        found = map_samples(lambda sample: tissue_rollout(*sample), list(samples))
        ctx.ways_back = [way_back for _, way_back in found]
        return torch.from_numpy(np.stack([trajectory for trajectory, _ in found]))

    @staticmethod
    def backward(ctx, gradient: Tensor):  # ty: ignore[incompatible-method-override]  as torch documents it
        """Go back through the stored velocities."""
        weights = gradient.detach().numpy()
        slopes = map_samples(lambda pair: pair[0](pair[1]), list(zip(ctx.ways_back, weights, strict=True)))
        stiffness, damping, force = zip(*slopes, strict=True)
        joined = (np.concatenate(stiffness), np.concatenate(damping), np.array(force, dtype=weights.dtype))
        return *(FirstOrder.apply(torch.from_numpy(values)) for values in joined), None, None, None, None


def tissue_rollout(
    case: Case, stiffness: np.ndarray, damping: np.ndarray
) -> tuple[np.ndarray, Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, float]]]:
    """One sample's rollout with parameters of its own at every vertex, and the way back.

    Args:
        case: the sample; only F is taken from its θ.
        stiffness: k_s at the vertices, shape [N]; a spring has its ends' mean.
        damping: k_d at the vertices, shape [N].

    Returns:
        The trajectory, shape [T, M, 3], and a function of weights [T, M, 3] that gives the derivatives of
        Σ weights·trajectory by k_s [N], by k_d [N] and by F.
    """
    dtype, mechanics, steps = case.theta.dtype, case.mechanics, case.load.steps
    graph = spring_graph(case.mesh, case.load.vertices, case.watch, steps + 1, dtype)
    step = integrator(damping[graph.order], mechanics)
    free = free_vertices(case.mesh, case.load, mechanics)[graph.order]
    local = stiffness[graph.order].astype(dtype)
    keep, kick = ((share * free).astype(dtype) for share in (step.keep, step.kick))
    tissue = Tissue(local[graph.springs].mean(axis=1), (mechanics.anchor * local).astype(dtype), keep, kick)
    load = placed(acting(case.load, mechanics, dtype), graph)
    within = graph.prefixes(exact_radii(steps, graph_reach(case, graph)))
    numbers = tuple(dtype.type(value) for value in (mechanics.time_step, step.lag, 0.0, NORM_GUARD))
    pressed = load._replace(push=case.theta[2] * load.push)
    forward = graph, *within, tissue, pressed, graph.position[case.watch], numbers
    trajectory = np.empty((steps, len(case.watch), 3), dtype)
    speeds = np.zeros((steps, len(graph.order), 3), dtype)
    edge_forward(*forward, trajectory, speeds)
    held = put_gripped(case, trajectory)

    def way_back(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        final = (mechanics.time_step * speeds.sum(axis=0, dtype=np.float64)).astype(dtype)
        weights = np.array(weights, dtype)
        weights[:, held] = 0
        slopes = Tissue(*(np.zeros_like(values) for values in tissue))
        by_push = edge_adjoint(*forward, final, speeds, weights, slopes)
        by_stiffness, by_damping = np.zeros((2, len(stiffness)), dtype)
        by_local = mechanics.anchor * slopes.anchor
        np.add.at(by_local, graph.springs, slopes.stiffness[:, None] / 2)
        by_stiffness[graph.order] = by_local
        by_damping[graph.order] = (slopes.keep * step.keep_slope + slopes.kick * step.kick_slope) * free
        return by_stiffness, by_damping, float((by_push * load.push).sum())

    return trajectory, way_back
