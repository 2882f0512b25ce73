"""Tissue in a frame as a sheet or a volume of particles: where they are, which an instrument moves, which stay."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from palpate.data.contact.geometry import GeometrySettings
from palpate.data.contact.surface import smooth_surface
from palpate.data.contact.tissue_points import grid_to_picture
from palpate.data.labels import TISSUE, TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.source.camera import Camera, back_project
from palpate.data.tracks.background import FAR
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip.recorder import DRIVEN
from palpate.physics.fem.solid import outer_faces
from palpate.physics.mesh import Mesh, contact_normal, grid_mesh, holding
from palpate.physics.pbd.body import Body, layered, make_body


@dataclass(frozen=True, eq=False)
class Surface:
    """A sheet or a volume of N particles, and the picture that it was observed in."""

    body: Body
    """Body at rest, in coordinates of the camera [scene units]; of a volume the surface's particles come first."""
    faces: np.ndarray
    """Triangles that the camera saw, shape [F, 3]: all of a sheet's."""
    gripped: np.ndarray
    """Particles that an instrument moves, shape [G]."""
    pixels: np.ndarray
    """Places of the particles at rest, shape [N, 2] (column, row) [px of the followed picture]."""
    camera: Camera
    """Camera of the followed picture."""
    reach: float
    """Tissue that began nearer to a tool moves with it [px]."""

    @cached_property
    def seen(self) -> np.ndarray:
        """Particles that the camera saw, shape [n]: all of a sheet's."""
        return np.unique(self.faces)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Project points [..., 3] [scene units] into the picture, shape [..., 2] [px] (Bini 2026, equation 3)."""
        camera = self.camera
        return points[..., :2] / points[..., 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)

    def lift(self, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return points [..., 3] [scene units] at places [..., 2] [px] and depths [...], the inverse of `project`."""
        camera = self.camera
        across = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        return np.concatenate([across * depth[..., None], depth[..., None]], axis=-1)

    def places(self, points: np.ndarray) -> tuple[np.ndarray, csr_array]:
        """Locate points of the picture on the surface at rest, as shares of its particles.

        Args:
            points: shape [P, 2] [px].

        Returns:
            Indices of the Q points that some triangle holds, and the shares, shape [Q, N].
        """
        corners = self.pixels[self.faces]
        sized = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) > 0
        which, shares = holding(corners[sized], points, 8)
        members = self.faces[sized][which]
        inside = np.flatnonzero(shares.min(axis=1) > -1e-9)
        starts = 3 * np.arange(len(inside) + 1)
        shape = len(inside), self.body.count
        return inside, csr_array((shares[inside].ravel(), members[inside].ravel(), starts), shape=shape)


def make_surface(
    frame: PreparedFrame, camera: Camera, geometry: GeometrySettings, particles: int, thickness: float | None = None
) -> Surface:
    """Mesh the tissue of a frame with about so many particles (Liang 2024, section III), evenly over the picture.

    Gripped are those of the surface near a tool. Pinned are, with all below them, those at the tissue's edge that lie
    as far from any tool as what counts as background (`data.tracks.background`). The edge near a tool is mostly the
    picture's border, across which tissue moves.

    Args:
        frame: with picture, labels and depth.
        camera: of the full picture.
        geometry: how meshes are made.
        particles: about how many.
        thickness: of a volume below the surface [scene units]; None = a sheet.

    Raises:
        NoEstimate: no tool or no tissue with depth, or none of it near the tool; a thickness of which no volume can be
            made.
    """
    tissue, tool, shown = (frame.labels == TISSUE) & (frame.depth > 0), frame.labels == TOOL, frame.shown
    count = int(tissue.sum())
    if count < geometry.min_tissue_pixels or not shown.tool.any():
        raise NoEstimate(f"Frame {frame.frame.number} shows no instrument at tissue with depth to make a sheet of.")
    depth = frame.depth
    if geometry.smoothing > 0:
        depth, _ = smooth_surface(depth, tissue, geometry.smoothing)
    grid, layers = camera.scaled(depth.shape[1], depth.shape[0]), 1
    if thickness is not None:
        layers = layers_below(float(np.square(depth[tissue]).sum()) / (grid.fx * grid.fy), thickness, particles)
    keep = min(1.0, particles / (layers * count))
    points = back_project(depth, grid)
    # As steep as at full resolution: edges are longer by as much as fewer are kept.
    longest = geometry.max_edge / np.sqrt(keep)
    mesh = grid_mesh(points, tissue, occluder=tool, max_edge=longest, keep=keep)
    if len(mesh.vertices) == 0:
        raise NoEstimate(f"The tissue's depth in frame {frame.frame.number} is too rough to make a sheet of.")
    size = shown.gray.shape[::-1]
    pixels = grid_to_picture(mesh.pixels[:, ::-1], mesh.grid_shape, size)
    column, row = np.clip(pixels.round().astype(int), 0, np.array(size) - 1).T
    reach = max(DRIVEN, size[0] / mesh.grid_shape[1] / np.sqrt(keep))  # a row of particles at least
    away = shown.away[row, column]
    driven = away < reach
    if not driven.any():
        near = f"{reach * shown.size[0] / size[0]:.0f} px"
        raise NoEstimate(f"No tissue lies within {near} of the instrument in frame {frame.frame.number}.")
    pinned = mesh.rim & ~driven & (away > np.percentile(away, FAR))
    body = body_below(mesh, pinned, thickness, layers)
    surface = Surface(body, mesh.triangles, np.flatnonzero(driven), pixels, camera.scaled(*size), reach)
    return surface if thickness is None else replace(surface, pixels=surface.project(body.rest))


def layers_below(area: float, thickness: float, particles: int) -> int:
    """Return the number of a volume's layers of particles, about as far from each other as those within one; the
    surface is one.

    Args:
        area: of the surface [scene units²].
        thickness: of all [scene units].
        particles: in all layers.
    """
    # Particles that the surface of a volume has at least, before it gets more than one layer below.
    layers = np.arange(2, max(3, particles // 30 + 1))
    return int(layers[np.abs(np.log(np.sqrt(area * layers / particles) * (layers - 1) / thickness)).argmin()])


def body_below(mesh: Mesh, pinned: np.ndarray, thickness: float | None, layers: int) -> Body:
    """Make the body below a surface along its normals, in so many layers; pinned is all below what is pinned there.

    Without a thickness it is the sheet itself.

    Raises:
        NoEstimate: nothing does.
    """
    if thickness is None:
        return make_body(mesh.vertices, mesh.triangles, pinned=pinned)
    upper, faces = mesh.vertices.astype(np.float64), mesh.triangles.astype(np.int64)
    away = np.linalg.det(upper[faces]) > 0  # of the camera, at the origin
    faces[away] = faces[away][:, ::-1]
    normals = np.stack([contact_normal(mesh, vertex) for vertex in range(len(upper))])
    # As far around as the volume is thick: along those of each bump of the surface layers would cross.
    normals = np.stack([np.exp(-np.square((upper - place) / thickness).sum(axis=1) / 2) @ normals for place in upper])
    below = -thickness * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    rest, tetrahedra = layered(upper, faces, below, layers)
    merged = (np.diff(rest.reshape(layers, -1, 3), axis=0) == 0).all(axis=2).any()  # by rounding
    if merged or len(tetrahedra) == 0:
        problem = f"No volume can be made below the tissue with a thickness of {thickness:g} in the depth's unit"
        raise NoEstimate(f"{problem}; give the tissue's, or null for a sheet.")
    return make_body(rest, outer_faces(tetrahedra), tetrahedra, pinned=np.tile(pinned, layers))
