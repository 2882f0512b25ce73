"""A depth map carried along by the tissue under a press: what θ alone makes of the next picture.

The rollout of θ says where the mesh's vertices are at the time of the map and at that of another frame. Both sheets are
projected into the picture and rendered to depth; the map changes by their difference. All of it is differentiable by θ.
Only the surroundings of the contact are carried: farther away, hardly anything moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import torch
from kornia.geometry.camera.perspective import project_points
from kornia.geometry.transform import remap
from torch import Tensor

from physics.mechanics import Mechanics
from physics.msd import rollout
from physics.msd.batch import LoadBatch, MeshBatch

REACH = 12
"""Vertices up to so many rows and columns from the contact are carried."""
ITERATIONS = 8
"""To find what a pixel shows: tissue that shifts by s pixels a pixel is found to s to this power."""
INSIDE = 0.999
"""Share of the tissue in what a pixel shows, from which on its slope counts."""


def carried(
    depth: Tensor, theta: Tensor, mesh: MeshBatch, load: LoadBatch, course: Tensor, mechanics: Mechanics
) -> Tensor:
    """Depth maps as they are at other times of the rollout, if nothing but θ's press moves the tissue.

    Args:
        depth: maps in [0, 1], 0 where invalid, shape [B, 1, H, W] [scene units].
        theta: [k_s, k_d, F], physical units, shape [B, 3].
        mesh: at rest, on the maps' grid.
        load: of the rollout.
        course: steps since the rollout's beginning at which the maps were seen, and to which they are carried, shape
            [B, 2], int64; beyond the rollout's last one, that.
        mechanics: the rollout's constants.

    Returns:
        Shape [B, 1, H, W]; invalid pixels stay invalid.

    Raises:
        ValueError: the mesh's grid is another one than the maps'.
    """
    if tuple(mesh.grid_shape) != tuple(depth.shape[2:]):
        raise ValueError(f"depth is {list(depth.shape[2:])}, the mesh's grid {list(mesh.grid_shape)}; give one grid.")
    watched = _around_contact(mesh, load)
    path = rollout(theta, mesh, load, mechanics, watch=watched)
    path = torch.cat([torch.zeros_like(path[:, :1]), path], dim=1)
    index = course.clamp(max=path.shape[1] - 1)[:, :, None, None].expand(-1, -1, *path.shape[2:])
    sheets = _Sheets(mesh, watched, depth)
    before, after = (sheets.sunk(moved) for moved in path.gather(1, index).to(depth).unbind(1))
    return torch.where(depth > 0, (depth + after - before).clamp(min=0.0, max=1.0), 0.0)


def starting_depth(
    kind: str, depth: Tensor, theta: Tensor, batch: Mapping[str, Any], side: str, mechanics: Mechanics
) -> Tensor:
    """What a decoder of this kind starts from: the current map itself, or with physics that carried to the other frame.

    Args:
        kind: one of `models.generator.DECODERS`.
        depth, theta, mechanics: as in `carried`.
        batch: the data module's.
        side: a for forward in time, b for backward.
    """
    if kind != "physics":
        return depth
    mesh, load, course = (batch[f"{name}_{side}"] for name in ("mesh", "load", "course"))
    return carried(depth, theta, mesh, load, course, mechanics)


def _around_contact(mesh: MeshBatch, load: LoadBatch) -> Tensor:
    """Vertices within REACH of the contacts, each within its own mesh, shape [B, M]; filled up by the contacts."""
    starts = mesh.vertex_offsets[:-1]
    contacts = load.vertices[load.offsets[:-1]]
    apart = mesh.pixels - mesh.pixels[(starts + contacts)[mesh.sample_of_vertex()]]
    near = (apart.abs() <= REACH).all(dim=1)
    ends = mesh.vertex_offsets.tolist()
    found = [near[first:last].nonzero()[:, 0] for first, last in pairwise(ends)]
    most = max(len(vertices) for vertices in found)
    return torch.stack(
        [torch.cat([own, contact.expand(most - len(own))]) for own, contact in zip(found, contacts, strict=True)]
    )


class _Sheets:
    """The tissue around B contacts as maps, of the type of `like`; vertices [B, M] are those that move."""

    def __init__(self, mesh: MeshBatch, watched: Tensor, like: Tensor) -> None:
        batch, (height, width) = len(watched), mesh.grid_shape
        sample = mesh.sample_of_vertex()
        place = mesh.pixels[:, 0] * width + mesh.pixels[:, 1]
        vertices = mesh.vertices.to(like)
        flat = vertices.new_zeros(batch, 2, height * width)
        flat[sample, 0, place] = vertices[:, 2]
        flat[sample, 1, place] = 1.0
        self._rest = flat.view(batch, 2, height, width)
        """Depth at rest, and 1 where there is tissue, shape [B, 2, H, W]."""
        joined = watched + mesh.vertex_offsets[:-1, None]
        self._places = place[joined]
        self._vertices = vertices[joined]
        self._camera = self._vertices.new_zeros(batch, 1, 3, 3)
        self._camera[:, 0, [0, 1], [0, 1]] = torch.stack(
            [_focal_lengths(*(values[sample == index] for values in (vertices, mesh.pixels))) for index in range(batch)]
        )
        self._camera[:, 0, 2, 2] = 1.0
        rows, columns = torch.meshgrid(
            *(torch.arange(size, device=like.device, dtype=like.dtype) for size in (height, width)),
            indexing="ij",
        )
        self._pixels = torch.stack([columns, rows]).expand(batch, -1, -1, -1)

    def sunk(self, moved: Tensor) -> Tensor:
        """Change of every pixel's depth from rest at displacements [B, M, 3], shape [B, 1, H, W]."""
        shift = project_points(self._vertices + moved, self._camera) - project_points(self._vertices, self._camera)
        values = torch.cat([shift, moved[..., 2:]], dim=2).transpose(1, 2)
        batch, _, height, width = self._rest.shape
        places = self._places[:, None].expand(-1, 3, -1)
        maps = values.new_zeros(batch, 3, height * width).scatter(2, places, values).view(batch, 3, height, width)
        # What a pixel shows lay at rest where the shift leads to the pixel.
        origin = self._pixels
        for _ in range(ITERATIONS):
            origin = self._pixels - _at(maps[:, :2], origin)
        rest = _at(self._rest, origin)
        sloping = torch.where((rest[:, 1:] > INSIDE) & (self._rest[:, 1:] > 0), rest[:, :1] - self._rest[:, :1], 0.0)
        return _at(maps[:, 2:], origin) + sloping


def _at(maps: Tensor, places: Tensor) -> Tensor:
    """Maps [B, C, H, W] between their pixels, at columns and rows [B, 2, H, W]."""
    return remap(maps, places[:, 0], places[:, 1], align_corners=True)


def _focal_lengths(vertices: Tensor, pixels: Tensor) -> Tensor:
    """Along x and y, from where vertices [N, 3] are in the grid [N, 2], shape [2] [grid pixels]."""
    rays, places = vertices[:, :2] / vertices[:, 2:], pixels.flip(1).to(vertices)
    rays, places = rays - rays.mean(dim=0), places - places.mean(dim=0)
    return (rays * places).sum(dim=0) / rays.square().sum(dim=0)
