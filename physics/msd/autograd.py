"""Torch's view of the compiled rollout.

The derivatives by θ are carried along with the motion (forward mode), so backward is one product and keeps only the
Jacobian, 7 kB a sample.
"""

import functools
import os
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.simulation import Case, is_chaotic, require_inside, watched_rollout


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


class CompiledRollout(torch.autograd.Function):
    """Trajectories [B, T, M, 3] and their Jacobian [B, T, M, 3, 3], a constant, from θ [B, 3]."""

    @staticmethod
    def forward(ctx, theta, meshes, loads, watched, mechanics: Mechanics, sensitive: bool) -> tuple[Tensor, Tensor]:
        """Compute the trajectories, and the Jacobian where it is wanted or a gradient may be; empty otherwise."""
        parts = zip(theta.detach().numpy(), meshes, loads, watched.numpy(), strict=True)
        samples = [Case(values, mesh, load, mechanics, watch) for values, mesh, load, watch in parts]
        for case in samples:
            require_inside(case.mesh, case.load, case.watch)
        results = map_samples(functools.partial(watched_rollout, sensitive=sensitive), samples)
        paths, found = zip(*results, strict=True)
        if sensitive:
            found = [_reliable(*each) for each in zip(samples, paths, found, strict=True)]
        slopes = torch.from_numpy(np.stack(found))
        ctx.mark_non_differentiable(slopes)
        ctx.save_for_backward(slopes)
        return torch.from_numpy(np.stack(paths)), slopes

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient: Tensor, _):
        """Chain with the Jacobian [B, T, M, 3, 3]."""
        (slopes,) = ctx.saved_tensors
        return torch.einsum("btmc,btmcp->bp", gradient, slopes), None, None, None, None, None


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
