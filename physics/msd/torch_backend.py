"""The mass-spring-damper rollout in torch: every derivative by autograd, any device.

Source: Bini 2026, equation 9 and table 1; the same equations as `physics.msd.reference`, batched, spring by spring. The
loop over steps never waits for the device.
"""

import torch
from torch import Tensor

from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.reference import NORM_GUARD


def integrator(damping: Tensor, mechanics: Mechanics) -> tuple[Tensor, Tensor, float]:
    """Coefficients of one step: v⁺ = keep·v + kick·f, u⁺ = u + Δt·v⁺, and the output is u⁺ − lag·v⁺.

    Drift–kick–drift runs in the same form on the half-step positions w = u + ½Δt·v, with v' = (f − k_d·v)/m solved
    exactly over the step; its output goes half a drift back.

    Args:
        damping: k_d, any shape.

    Returns:
        ``keep`` [1] and ``kick`` [s/kg] in the shape of ``damping``, ``lag`` [s].
    """
    step = mechanics.time_step / mechanics.mass
    ratio = damping * step
    if mechanics.scheme == "dkd":
        small = ratio.abs() < 1e-3
        safe = torch.where(small, torch.ones_like(ratio), ratio)
        # φ(c) = (1 − e⁻ᶜ)/c; its series is exact to 1e-17 below 1e-3, where autograd of the quotient loses digits.
        series = 1 - ratio / 2 * (1 - ratio / 3 * (1 - ratio / 4 * (1 - ratio / 5)))
        share = torch.where(small, series, -torch.expm1(-safe) / safe)
        return torch.exp(-ratio), step * share, mechanics.time_step / 2
    return 1 / (1 + ratio), step / (1 + ratio), 0.0


def spring_force(stretch: Tensor, rest: Tensor, rest_length: Tensor) -> Tensor:
    """Pull of every spring on its first vertex for unit stiffness: the elongation along the spring's direction.

    Displacement form: e = |d| − |d₀| = (2 d₀·δu + δu²) / (|d| + |d₀|), which keeps the digits that |d| − |d₀| loses.

    Args:
        stretch: δu, second minus first vertex's displacement, shape [S, 3] [scene units].
        rest: rest vectors d₀, shape [S, 3] [scene units].
        rest_length: guarded |d₀|, shape [S, 1] [scene units].

    Returns:
        Force on the first vertex, the second one's is opposite, shape [S, 3].
    """
    current = rest + stretch
    length = torch.sqrt((current * current).sum(dim=1, keepdim=True) + NORM_GUARD)
    elongation = ((2 * rest + stretch) * stretch).sum(dim=1, keepdim=True) / (length + rest_length)
    return elongation / length * current


def watched_trajectory(theta: Tensor, mesh, load, watched: Tensor, mechanics: Mechanics) -> Tensor:
    """Displacement of the watched vertices, shape [B, T, M, 3] [scene units].

    Args:
        theta: k_s, k_d and F, shape [B, 3].
        mesh: a `physics.msd.batch.MeshBatch`.
        load: a `physics.msd.batch.PressBatch`.
        watched: vertices, shape [B, M].
        mechanics: constants.
    """
    shown = places("watch", watched, mesh.vertex_offsets[:-1, None], mesh.vertex_offsets[1:, None])
    sample = mesh.sample_of_vertex()
    stiffness, damping, force = theta[sample].unsqueeze(2).unbind(dim=1)
    vertices = mesh.vertices.to(theta.dtype)
    first, second = mesh.springs.unbind(dim=1)
    rest = vertices[second] - vertices[first]
    rest_length = torch.sqrt((rest * rest).sum(dim=1, keepdim=True) + NORM_GUARD)
    mobile, push = _acting(mesh, load, theta.dtype)
    push = push * force
    keep, kick, lag = integrator(damping, mechanics)
    keep, kick = keep * mobile, kick * mobile
    displacement, velocity, trajectory = torch.zeros_like(push), torch.zeros_like(push), []
    for factor in load.factor.to(theta.dtype)[sample].unsqueeze(1).unbind(dim=2):
        pull = stiffness[first] * spring_force(displacement[second] - displacement[first], rest, rest_length)
        elastic = torch.zeros_like(vertices).index_add(0, first, pull).index_add(0, second, -pull)
        velocity = keep * velocity + kick * (elastic + factor * push)
        displacement = displacement + mechanics.time_step * velocity
        trajectory.append((displacement - lag * velocity)[shown])
    return torch.stack(trajectory, dim=1)


def places(name: str, vertices: Tensor, starts: Tensor, ends: Tensor) -> Tensor:
    """Where vertices of their own meshes are in the joined one, shape of `vertices`.

    Args:
        name: what names them, for the error.
        vertices: indices within each mesh.
        starts, ends: first joined vertex of each one's mesh and the one after its last, which broadcast.

    Raises:
        ValueError: one lies outside its mesh.
    """
    joined = starts + vertices
    outside = (vertices < 0) | (joined >= ends)
    if outside.any():
        vertex, size = int(vertices[outside][0]), int((ends - starts).expand_as(vertices)[outside][0])
        raise ValueError(f"{name} names vertex {vertex}; the mesh has {size} vertices.")
    return joined


def _acting(mesh, load, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """1 where a vertex of the joined meshes may move (a pressed one always), [ΣN, 1]; its weight·direction, [ΣN, 3]."""
    sizes = load.offsets.diff()
    sample = torch.repeat_interleave(torch.arange(len(sizes), device=sizes.device), sizes)
    loaded = places("load", load.vertices, mesh.vertex_offsets[sample], mesh.vertex_offsets[sample + 1])
    push = mesh.vertices.new_zeros(mesh.vertices.shape, dtype=dtype)
    shares = load.weights.to(dtype)[:, None] * load.direction.to(dtype)[sample]
    mobile = (~mesh.rim).index_fill(0, loaded, True).to(dtype)
    return mobile[:, None], push.index_add(0, loaded, shares)
