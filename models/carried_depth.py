"""A depth map carried along by the tissue under a press: the next depth map as the simulator predicts it from θ alone.

The rollout of θ gives the places of the mesh's vertices at the time of the map and at that of another frame. Both
meshes are projected into the picture and rendered to depth; the map changes by their difference. All of it is
differentiable by θ. Only the surroundings of the contact are carried: farther away, hardly anything moves.
"""

from collections.abc import Sequence

import numpy as np
import torch
from kornia.geometry.camera.perspective import project_points
from kornia.geometry.transform import remap
from torch import Tensor

from palpate.physics.load import Press
from palpate.physics.mechanics import Mechanics
from palpate.physics.mesh import Mesh, focal_length
from palpate.physics.msd import rollout

MAP_RADIUS = 15
"""Distance from the contact to the maps' sides [grid px]."""
MAP_SIDE = 2 * MAP_RADIUS + 1


def change(
    theta: Tensor, meshes: Sequence[Mesh], loads: Sequence[Press], course: Tensor, mechanics: Mechanics
) -> Tensor:
    """Change of the depth from one time of the rollout to another, shape [B, 1, H, W] [scene units].

    Computed on the CPU; the result is on θ's device.

    Args:
        theta: [k_s, k_d, F], physical units, shape [B, 3].
        meshes: the tissue meshes at rest, on the maps' grid.
        loads: the presses of the rollout.
        course: first and last step of the change since the rollout's beginning, shape [B, 2], int64; steps beyond the
            rollout's end count as its end.
        mechanics: the rollout's constants.
    """
    device, theta = theta.device, theta.cpu()
    surroundings = _Surroundings(meshes, loads, theta)
    path = rollout(theta, meshes, loads, mechanics, watch=surroundings.watched)
    path = torch.cat([torch.zeros_like(path[:, :1]), path], dim=1)
    index = course.clamp(max=path.shape[1] - 1)[:, :, None, None].expand(-1, -1, *path.shape[2:])
    before, after = (surroundings.depth_change(moved) for moved in path.gather(1, index).to(theta).unbind(1))
    return surroundings.in_picture(after - before).to(device)


def shifted(depth: Tensor, by: Tensor | None) -> Tensor:
    """Maps in [0, 1] with a change added, shape [B, 1, H, W]; invalid pixels (0) stay so, and None changes nothing."""
    if by is None:
        return depth
    return torch.where(depth > 0, (depth + by).clamp(min=0.0, max=1.0), 0.0)


class _Surroundings:
    """The tissue around B contacts as maps of S × S pixels, of the type of `like`; M vertices of each mesh move."""

    def __init__(self, meshes: Sequence[Mesh], loads: Sequence[Press], like: Tensor) -> None:
        height, width = self._shape = meshes[0].grid_shape
        batch, contacts = len(meshes), [load.vertex for load in loads]
        centres = np.stack([mesh.pixels[vertex] for mesh, vertex in zip(meshes, contacts, strict=True)])
        apart = [mesh.pixels - centre for mesh, centre in zip(meshes, centres, strict=True)]
        # Carried vertices shift by 3 px at most.
        found = [np.flatnonzero((np.abs(own) <= MAP_RADIUS - 3).all(axis=1)) for own in apart]
        most = max(map(len, found))
        both = zip(found, contacts, strict=True)
        watched = np.stack([np.pad(own, (0, most - len(own)), constant_values=contact) for own, contact in both])
        self.watched = torch.from_numpy(watched)
        """Vertices near the contacts, numbered within their own mesh, shape [B, M]; padded by repeating the contact."""
        vertices = np.stack([mesh.vertices[own] for mesh, own in zip(meshes, watched, strict=True)])
        self._vertices = torch.from_numpy(vertices).to(like)
        places = np.stack([own[at] for own, at in zip(apart, watched, strict=True)]) + MAP_RADIUS
        self._places = torch.from_numpy(places @ [MAP_SIDE, 1])
        """Flat indices of the vertices' pixels in the maps, shape [B, M]."""
        rest = np.zeros((batch, 2, MAP_SIDE, MAP_SIDE), np.float32)
        for maps, mesh, own in zip(rest, meshes, apart, strict=True):
            inner = (np.abs(own) <= MAP_RADIUS).all(axis=1)
            maps[:, *(own[inner] + MAP_RADIUS).T] = mesh.vertices[inner, 2], np.ones(inner.sum())
        self._rest = torch.from_numpy(rest).to(like)
        """Depth at rest, and 1 where there is tissue, shape [B, 2, S, S]."""
        cameras = np.stack([np.diag([*focal_length(mesh), 1.0]) for mesh in meshes])
        self._camera = torch.from_numpy(cameras[:, None]).to(like)
        """Intrinsics of a camera that sees a mesh's vertices as far apart as its pixels are, shape [B, 1, 3, 3] [grid
        px]."""
        centre = torch.from_numpy(centres)
        steps = torch.arange(MAP_SIDE, device=like.device)
        grid = torch.stack(torch.meshgrid(steps, steps, indexing="ij"))
        self._pixels = grid.flip(0).to(like).expand(batch, -1, -1, -1)
        """Columns and rows of the maps, shape [B, 2, S, S]."""
        rows, columns = (centre[:, :, None, None] + grid - MAP_RADIUS).unbind(dim=1)
        self._inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        self._in_picture = rows.clamp(0, height - 1) * width + columns.clamp(0, width - 1)

    def depth_change(self, moved: Tensor) -> Tensor:
        """Change of every pixel's depth from rest at displacements [B, M, 3], shape [B, 1, S, S]."""
        shift = project_points(self._vertices + moved, self._camera) - project_points(self._vertices, self._camera)
        values = torch.cat([shift, moved[..., 2:]], dim=2).transpose(1, 2)
        maps = values.new_zeros(len(values), 3, MAP_SIDE * MAP_SIDE)
        maps = maps.scatter(2, self._places[:, None].expand(-1, 3, -1), values).view(-1, 3, MAP_SIDE, MAP_SIDE)
        # The tissue that a pixel shows was at rest at the place whose shift leads to the pixel.
        origin = self._pixels
        for _ in range(8):
            origin = self._pixels - _at(maps[:, :2], origin)
        rest = _at(self._rest, origin)
        # The slope at rest counts where at least this share of the interpolated pixels is tissue.
        on_tissue = (rest[:, 1:] > 0.999) & (self._rest[:, 1:] > 0)
        sloping = torch.where(on_tissue, rest[:, :1] - self._rest[:, :1], 0.0)
        return _at(maps[:, 2:], origin) + sloping

    def in_picture(self, change: Tensor) -> Tensor:
        """Maps [B, 1, S, S] placed in the whole picture, 0 elsewhere, shape [B, 1, H, W]."""
        height, width = self._shape
        whole = change.new_zeros(len(change), height * width)
        known = torch.where(self._inside, change[:, 0], 0.0).flatten(1)
        return whole.scatter_add(1, self._in_picture.flatten(1), known).view(-1, 1, height, width)


def _at(maps: Tensor, places: Tensor) -> Tensor:
    """Maps [B, C, H, W] interpolated at columns and rows [B, 2, H, W]."""
    return remap(maps, places[:, 0], places[:, 1], align_corners=True)
