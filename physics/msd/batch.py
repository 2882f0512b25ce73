"""Meshes, loads and observations of a batch, joined into tensors."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from palpate.physics.load import Press
from palpate.physics.mesh import Mesh
from palpate.physics.observation import Observation


def _joined(arrays: Iterable[np.ndarray], dtype: type) -> Tensor:
    return torch.from_numpy(np.concatenate(list(arrays)).astype(dtype))


def _offsets(arrays: Iterable[np.ndarray]) -> Tensor:
    """Where each of the arrays begins in the joined one, and the total."""
    return torch.from_numpy(np.cumsum([0, *(len(array) for array in arrays)]))


def pieces(values: Tensor, offsets: Tensor) -> list[np.ndarray]:
    """Each sample's part of joined values, on the CPU."""
    return np.split(values.detach().cpu().numpy(), offsets.tolist()[1:-1])


@dataclass
class MeshBatch:
    """B meshes joined into one."""

    vertices: Tensor
    """Positions at rest, shape [ΣN, 3], float32 [scene units]."""
    springs: Tensor
    """Indices into the joined vertices, shape [ΣS, 2], int64."""
    rim: Tensor
    """Vertices that are held, shape [ΣN], bool."""
    pixels: Tensor
    """Row and column in the grid, shape [ΣN, 2], int64."""
    vertex_offsets: Tensor
    """First vertex of every mesh and the total, shape [B+1], int64."""
    spring_offsets: Tensor
    """First spring of every mesh and the total, shape [B+1], int64."""
    grid_shape: tuple[int, int]
    """Height and width of the grid [px]."""

    @classmethod
    def from_meshes(cls, meshes: list[Mesh]) -> Self:
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
        vertex_offsets = _offsets(mesh.vertices for mesh in meshes)
        starts = vertex_offsets.tolist()[:-1]
        springs = (mesh.springs + start for mesh, start in zip(meshes, starts, strict=True))
        kinds = {"vertices": np.float32, "rim": np.bool_, "pixels": np.int64}
        parts = {name: _joined((getattr(mesh, name) for mesh in meshes), kind) for name, kind in kinds.items()}
        offsets = {"vertex_offsets": vertex_offsets, "spring_offsets": _offsets(mesh.springs for mesh in meshes)}
        return cls(springs=_joined(springs, np.int64), grid_shape=tuple(meshes[0].grid_shape), **parts, **offsets)

    def sample_of_vertex(self) -> Tensor:
        """Which mesh a joined vertex belongs to, shape [ΣN], int64."""
        index = torch.arange(self.vertices.shape[0], device=self.vertices.device)
        return torch.searchsorted(self.vertex_offsets[1:].contiguous(), index, right=True)

    def split(self) -> list[Mesh]:
        """The meshes, on the CPU and without their triangles, which only their making needed."""
        of_vertices = (pieces(values, self.vertex_offsets) for values in (self.vertices, self.rim, self.pixels))
        parts = zip(*of_vertices, pieces(self.springs, self.spring_offsets), self.vertex_offsets.tolist(), strict=False)
        none, shape = np.empty((0, 3), np.int32), tuple(self.grid_shape)
        return [
            Mesh(vertices, none, (springs - start).astype(np.int32), rim, pixels.astype(np.int32), shape)
            for vertices, rim, pixels, springs, start in parts
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
    def of(cls, loads: Sequence[Press]) -> Self:
        """Join presses of one number of steps."""
        vertices, weights = (load.vertices for load in loads), (load.weights for load in loads)
        patches = _joined(vertices, np.int64), _joined(weights, np.float32), _offsets(load.vertices for load in loads)
        courses = ([load.direction for load in loads], [load.factor for load in loads])
        return cls(*patches, *(torch.from_numpy(np.stack(values).astype(np.float32)) for values in courses))

    @property
    def steps(self) -> int:
        """T."""
        return self.factor.shape[1]

    def split(self) -> list[Press]:
        """The presses, on the CPU."""
        patches = (pieces(values, self.offsets) for values in (self.vertices, self.weights))
        courses = (values.detach().cpu().numpy() for values in (self.direction, self.factor))
        return [Press(*parts) for parts in zip(*patches, *courses, strict=True)]


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
    def of(cls, observations: Sequence[Observation], time_step: float) -> Self:
        """Join observations of one point each, for trajectories with this time step [s]; what was not observed weighs
        0."""
        steps = [torch.from_numpy(observation.steps(time_step)) for observation in observations]
        moved = [torch.from_numpy(item.displacement.squeeze(0).astype(np.float32)) for item in observations]
        weight = [points.isfinite().all(dim=1).float() for points in moved]
        return cls(*(pad_sequence(values, batch_first=True) for values in (steps, moved, weight)))


class DepthView(Protocol):
    """What a camera sees of a mesh; V vertices that may be seen, P pixels."""

    vertices: np.ndarray
    """Each an index within the mesh, shape [V]."""

    def seen(self, moved: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Change of every pixel's depth since rest [N, P], and its derivatives [N, P, D].

        Args:
            moved, slopes: displacements of the vertices [N, V, 3] and their derivatives [N, V, 3, D].

        Returns:
            Not a number where a pixel shows nothing known.
        """
        ...


@dataclass
class DepthBatch:
    """Observed changes of the depth of P pixels a sample, at up to N instants."""

    views: Sequence[DepthView]
    """What the pixels show, B of them."""
    vertices: Tensor
    """Theirs, each an index within its own mesh, filled up with any of them, shape [B, V], int64."""
    steps: Tensor
    """Index into the trajectory that each instant belongs to, shape [B, N], int64."""
    change: Tensor
    """Observed change since rest, shape [B, N, P], float32 [scene units]; 0 where nothing was observed."""
    weight: Tensor
    """Whether it was observed, shape [B, N, P], float32."""
    noise: Tensor
    """σ of every observed change, shape [B], float32 [scene units]."""
    common: Tensor
    """Errors that all instants share, independent normal factors of these columns, shape [P, K], float32 [σ]."""
