"""The mass-spring-damper rollout in torch: every derivative by autograd, any device.

Source: Bini 2026, equation 9 and table 1; the same equations as `physics.msd.reference`, batched. Grid meshes run as a
dense stencil, others spring by spring. The loop over steps never waits for the device.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor
from torch.nn.functional import pad

from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.reference import NORM_GUARD

STENCIL = ((0, 1), (1, 0), (1, 1))
"""Rows and columns from a spring's first to its second pixel on a grid mesh: right, down, diagonal."""


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


def spring_force(stretch: Tensor, rest: Tensor, rest_length: Tensor, axis: int) -> Tensor:
    """Pull of every spring on its first vertex for unit stiffness: the elongation along the spring's direction.

    Displacement form: e = |d| − |d₀| = (2 d₀·δu + δu²) / (|d| + |d₀|), which keeps the digits that |d| − |d₀| loses.

    Args:
        stretch: δu, second minus first vertex's displacement [scene units].
        rest: rest vectors d₀, shape of ``stretch`` [scene units].
        rest_length: guarded |d₀|, with size 1 along ``axis`` [scene units].
        axis: the axis of x, y, z.

    Returns:
        Force on the first vertex, the second one's is opposite, shape of ``stretch``.
    """
    current = rest + stretch
    length = torch.sqrt((current * current).sum(dim=axis, keepdim=True) + NORM_GUARD)
    elongation = ((2 * rest + stretch) * stretch).sum(dim=axis, keepdim=True) / (length + rest_length)
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
    place = places("watch", watched, mesh.vertex_offsets[:-1, None], mesh.vertex_offsets[1:, None])
    run = grid_steps if is_grid(mesh) else edge_steps
    return torch.stack(list(run(theta, mesh, place, load, mechanics)), dim=1)


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


def is_grid(mesh) -> bool:
    """Whether all springs go right, down or down-right on the grid, with at most one vertex a pixel."""
    first, second = mesh.springs.unbind(dim=1)
    down, right = (mesh.pixels[second] - mesh.pixels[first]).unbind(dim=1)
    sign = torch.where((down < 0) | ((down == 0) & (right < 0)), -1, 1)
    down, right = sign * down, sign * right
    regular = ((down >= 0) & (down <= 1) & (right >= 0) & (right <= 1) & (down + right > 0)).all()
    height, width = mesh.grid_shape
    inside = ((mesh.pixels >= 0) & (mesh.pixels < mesh.pixels.new_tensor([height, width]))).all()
    place = (mesh.sample_of_vertex() * height + mesh.pixels[:, 0]) * width + mesh.pixels[:, 1]
    return bool(regular & inside) and len(torch.unique(place)) == len(place)


def edge_steps(theta: Tensor, mesh, watched: Tensor, load, mechanics: Mechanics) -> Iterator[Tensor]:
    """Displacement of the watched vertices after each step, shape [B, M, 3] [scene units], spring by spring.

    Args:
        watched: vertices in the joined mesh, shape [B, M]; other arguments as in `watched_trajectory`.
    """
    sample = mesh.sample_of_vertex()
    stiffness, damping, force = theta[sample].unsqueeze(2).unbind(dim=1)
    vertices = mesh.vertices.to(theta.dtype)
    first, second = mesh.springs.unbind(dim=1)
    rest = vertices[second] - vertices[first]
    rest_length = torch.sqrt((rest * rest).sum(dim=1, keepdim=True) + NORM_GUARD)
    mobile, push = _acting(mesh, load, theta.dtype)

    def elastic(displacement: Tensor) -> Tensor:
        pull = stiffness[first] * spring_force(displacement[second] - displacement[first], rest, rest_length, 1)
        return torch.zeros_like(vertices).index_add(0, first, pull).index_add(0, second, -pull)

    factors = load.factor.to(theta.dtype)[sample].unsqueeze(1).unbind(dim=2)
    for displacement in _steps(elastic, damping, mobile[:, None], push * force, factors, mechanics):
        yield displacement[watched]


def grid_steps(theta: Tensor, mesh, watched: Tensor, load, mechanics: Mechanics) -> Iterator[Tensor]:
    """Displacement of the watched vertices after each step, shape [B, M, 3] [scene units], as a dense stencil.

    Args:
        watched: vertices in the joined mesh, shape [B, M]; other arguments as in `watched_trajectory`.
    """
    batch, (height, width) = theta.shape[0], mesh.grid_shape
    row, column = mesh.pixels.unbind(dim=1)
    sample = mesh.sample_of_vertex()
    place = (sample * height + row) * width + column

    def planes(values: Tensor) -> Tensor:
        """Values [ΣN, C] at the vertices as planes [B, C, H, W], 0 elsewhere."""
        flat = values.new_zeros(batch * height * width, values.shape[1]).index_copy(0, place, values)
        return flat.reshape(batch, height, width, -1).permute(0, 3, 1, 2).contiguous()

    vertices = planes(mesh.vertices.to(theta.dtype))
    springs = _stencil(mesh, place, vertices)
    mobile, push = _acting(mesh, load, theta.dtype)
    stiffness, damping, force = (theta[:, index, None, None, None] for index in range(3))

    def elastic(displacement: Tensor) -> Tensor:
        total = torch.zeros_like(displacement)
        for (down, right), link, rest, rest_length in springs:
            near, far = displacement[..., : height - down, : width - right], displacement[..., down:, right:]
            pull = link * spring_force(far - near, rest, rest_length, 1)
            total = total + pad(pull, (0, right, 0, down)) - pad(pull, (right, 0, down, 0))
        return stiffness * total

    factors = load.factor.to(theta.dtype)[:, :, None, None, None].unbind(dim=1)
    push, mobile = force * planes(push), planes(mobile[:, None])
    shown = sample[watched], row[watched], column[watched]
    for displacement in _steps(elastic, damping, mobile, push, factors, mechanics):
        yield displacement.permute(0, 2, 3, 1)[shown]


def _acting(mesh, load, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """1 where a vertex of the joined meshes may move (a pressed one always), [ΣN]; its weight·direction, [ΣN, 3]."""
    sizes = load.offsets.diff()
    sample = torch.repeat_interleave(torch.arange(len(sizes), device=sizes.device), sizes)
    loaded = places("load", load.vertices, mesh.vertex_offsets[sample], mesh.vertex_offsets[sample + 1])
    push = mesh.vertices.new_zeros(mesh.vertices.shape, dtype=dtype)
    shares = load.weights.to(dtype)[:, None] * load.direction.to(dtype)[sample]
    return (~mesh.rim).index_fill(0, loaded, True).to(dtype), push.index_add(0, loaded, shares)


def _steps(
    elastic: Callable[[Tensor], Tensor], damping: Tensor, mobile: Tensor, push: Tensor, factors, mechanics: Mechanics
) -> Iterator[Tensor]:
    """Integrate from rest; all tensors broadcast against ``push``, F·direction at the pressed vertices, 0 elsewhere."""
    keep, kick, lag = integrator(damping, mechanics)
    keep, kick = keep * mobile, kick * mobile
    displacement = torch.zeros_like(push)
    velocity = torch.zeros_like(push)
    for factor in factors:
        velocity = keep * velocity + kick * (elastic(displacement) + factor * push)
        displacement = displacement + mechanics.time_step * velocity
        yield displacement - lag * velocity if lag else displacement


def _stencil(mesh, place: Tensor, vertices: Tensor) -> list[tuple[tuple[int, int], Tensor, Tensor, Tensor]]:
    """For each direction: offset, number of springs [B, 1, h, w], rest vectors [B, 3, h, w] and rest lengths."""
    batch, _, height, width = vertices.shape
    first, second = place[mesh.springs].sort(dim=1).values.unbind(dim=1)
    springs = []
    for down, right in STENCIL:
        here = (second - first == down * width + right).to(vertices.dtype)
        link = vertices.new_zeros(batch * height * width).index_add(0, first, here)
        link = link.reshape(batch, 1, height, width)[..., : height - down, : width - right]
        rest = vertices[..., down:, right:] - vertices[..., : height - down, : width - right]
        rest_length = torch.sqrt((rest * rest).sum(dim=1, keepdim=True) + NORM_GUARD)
        springs.append(((down, right), link, rest, rest_length))
    return springs
