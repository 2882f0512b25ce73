"""Meshes, loads and observations of a batch, joined into tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from physics.load import Grip, Load, Press
from physics.mesh import Mesh
from physics.observation import Observation


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

    def split(self) -> list[Mesh]:
        """The meshes, on the CPU and without their triangles, which only their making needed."""
        starts, spring_starts = self.vertex_offsets.tolist(), self.spring_offsets.tolist()
        vertices, springs, rim, pixels = (
            values.detach().cpu().numpy() for values in (self.vertices, self.springs, self.rim, self.pixels)
        )
        ends = zip(starts[:-1], starts[1:], spring_starts[:-1], spring_starts[1:], strict=True)
        return [
            Mesh(
                vertices=vertices[start:end],
                triangles=np.empty((0, 3), np.int32),
                springs=(springs[first:last] - start).astype(np.int32),
                rim=rim[start:end],
                pixels=pixels[start:end].astype(np.int32),
                grid_shape=tuple(self.grid_shape),
            )
            for start, end, first, last in ends
        ]


@dataclass
class PressBatch:
    """B presses over T steps; ΣP pressed vertices."""

    vertices: Tensor
    """Each an index within its own mesh, those of the first mesh first, shape [ΣP], int64."""
    weights: Tensor
    """Share of the force on each, shape [ΣP], float32."""
    offsets: Tensor
    """First pressed vertex of every mesh and the total, shape [B+1], int64."""
    direction: Tensor
    """Unit vector of the force; F·direction acts, shape [B, 3], float32."""
    factor: Tensor
    """Share of F in each step, shape [B, T], float32."""

    @classmethod
    def of(cls, loads: Sequence[Press]) -> PressBatch:
        """Join presses of one number of steps."""
        return cls(
            vertices=torch.from_numpy(np.concatenate([load.vertices for load in loads]).astype(np.int64)),
            weights=torch.from_numpy(np.concatenate([load.weights for load in loads]).astype(np.float32)),
            offsets=_offsets(loads),
            direction=torch.from_numpy(np.stack([load.direction for load in loads]).astype(np.float32)),
            factor=torch.from_numpy(np.stack([load.factor for load in loads]).astype(np.float32)),
        )

    @property
    def steps(self) -> int:
        """T."""
        return self.factor.shape[1]

    def split(self) -> list[Press]:
        """The presses, on the CPU."""
        offsets = self.offsets.tolist()
        vertices, weights, direction, factor = (
            values.detach().cpu().numpy() for values in (self.vertices, self.weights, self.direction, self.factor)
        )
        return [
            Press(vertices[start:end], weights[start:end], direction[index], factor[index])
            for index, (start, end) in enumerate(pairwise(offsets))
        ]


@dataclass
class GripBatch:
    """B grips over T steps; ΣG gripped vertices."""

    vertices: Tensor
    """Each an index within its own mesh, those of the first mesh first, shape [ΣG], int64."""
    offsets: Tensor
    """First gripped vertex of every mesh and the total, shape [B+1], int64."""
    displacement: Tensor
    """Where each is after each step, from rest, shape [T, ΣG, 3], float32 [scene units]."""

    @classmethod
    def of(cls, loads: Sequence[Grip]) -> GripBatch:
        """Join grips of one number of steps."""
        return cls(
            vertices=torch.from_numpy(np.concatenate([load.vertices for load in loads]).astype(np.int64)),
            offsets=_offsets(loads),
            displacement=torch.from_numpy(
                np.concatenate([load.displacement for load in loads], axis=1).astype(np.float32)
            ),
        )

    @property
    def steps(self) -> int:
        """T."""
        return self.displacement.shape[0]

    def split(self) -> list[Grip]:
        """The grips, on the CPU."""
        offsets = self.offsets.tolist()
        vertices, displacement = self.vertices.cpu().numpy(), self.displacement.detach().cpu().numpy()
        return [Grip(vertices[start:end], displacement[:, start:end]) for start, end in pairwise(offsets)]


LoadBatch = PressBatch | GripBatch


def _offsets(loads: Sequence[Load]) -> Tensor:
    return torch.from_numpy(np.cumsum([0, *(len(load.vertices) for load in loads)]))


@dataclass
class ObservationBatch:
    """Observed displacements of one followed point a sample, at up to M instants."""

    steps: Tensor
    """Index into the trajectory that each observation belongs to, shape [B, M], int64."""
    displacement: Tensor
    """Observed displacement from rest, shape [B, M, 3], float32 [scene units]."""
    weight: Tensor
    """Weight of each observation, 0 for padding, shape [B, M], float32."""

    @classmethod
    def of(cls, observations: Sequence[Observation], time_step: float) -> ObservationBatch:
        """Join observations of one point each, for trajectories with this time step [s]; what was not seen weighs 0."""
        longest = max(len(observation) for observation in observations)
        steps = torch.zeros(len(observations), longest, dtype=torch.int64)
        displacement, weight = torch.zeros(len(observations), longest, 3), torch.zeros(len(observations), longest)
        for row, observation in enumerate(observations):
            (moved,), count = observation.displacement, len(observation)
            steps[row, :count] = torch.from_numpy(observation.steps(time_step))
            displacement[row, :count] = torch.from_numpy(moved.astype(np.float32))
            weight[row, :count] = torch.from_numpy(np.isfinite(moved).all(axis=1).astype(np.float32))
        return cls(steps, displacement, weight)
