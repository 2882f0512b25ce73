"""Tissue in a frame as a sheet of particles: where they are, which an instrument moves, which stay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from data.contact.geometry import GeometrySettings
from data.contact.surface import smooth_surface
from data.contact.tissue_points import grid_to_picture
from data.labels import TISSUE, TOOL
from data.prepared import PreparedFrame
from data.source.camera import Camera, back_project
from data.tracks.background import FAR
from data.tracks.following import shrunk, tool_distance
from estimators.estimate import NoEstimate
from estimators.grip.recorder import DRIVEN
from physics.mesh import grid_mesh
from physics.pbd.body import Body, make_body

NEAREST = 8
"""Triangles around a point that are looked at for the one that holds it."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A sheet of N particles, and the picture that it was seen in."""

    body: Body
    """At rest, in coordinates of the camera [scene units]; pinned at the tissue's edge, far from any tool."""
    gripped: np.ndarray
    """Particles that an instrument moves, shape [G]."""
    pixels: np.ndarray
    """Of the particles at rest, shape [N, 2] (column, row) [px of the followed picture]."""
    camera: Camera
    """Of the followed picture."""
    reach: float
    """Tissue that began nearer to a tool moves with it [px]."""

    def project(self, points: np.ndarray) -> np.ndarray:
        """Where points [..., 3] [scene units] are in the picture, shape [..., 2] [px] (Bini 2026, equation 3)."""
        camera = self.camera
        return points[..., :2] / points[..., 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)

    def lift(self, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """The inverse: points [..., 3] [scene units] at places [..., 2] [px] and depths [...]."""
        camera = self.camera
        across = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        return np.concatenate([across * depth[..., None], depth[..., None]], axis=-1)

    def places(self, points: np.ndarray) -> tuple[np.ndarray, csr_array]:
        """Points of the picture on the sheet at rest, as shares of its particles.

        Args:
            points: shape [P, 2] [px].

        Returns:
            Indices of the Q points that some triangle holds, and the shares, shape [Q, N].
        """
        faces = self.body.faces
        corners = self.pixels[faces]
        first, edges = corners[:, 0], np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
        sized = np.abs(np.linalg.det(edges)) > 0
        inverse = np.linalg.inv(edges[sized])
        first, faces = first[sized], faces[sized]
        count = min(NEAREST, len(faces))
        near = KDTree(corners[sized].mean(axis=1)).query(points, k=count)[1].reshape(len(points), count)
        two = np.einsum("pkij,pkj->pki", inverse[near], points[:, None] - first[near])
        shares = np.concatenate([1 - two.sum(axis=2, keepdims=True), two], axis=2)
        best = shares.min(axis=2).argmax(axis=1)
        rows = np.arange(len(points))
        shares, members = shares[rows, best], faces[near[rows, best]]
        inside = np.flatnonzero(shares.min(axis=1) > -1e-9)
        starts = 3 * np.arange(len(inside) + 1)
        shape = len(inside), self.body.count
        return inside, csr_array((shares[inside].ravel(), members[inside].ravel(), starts), shape=shape)


def make_surface(frame: PreparedFrame, camera: Camera, geometry: GeometrySettings, particles: int) -> Surface:
    """Mesh the tissue of a frame with about so many particles (Liang 2024, section III), evenly over the picture.

    Gripped are those near a tool, pinned those at the tissue's edge that lie as far from any tool as what counts as
    background (`data.tracks.background`). The edge near a tool is mostly the picture's border, across which tissue
    moves.

    Args:
        frame: with picture, labels and depth.
        camera: of the full picture.
        geometry: how meshes are made.
        particles: about how many.

    Raises:
        NoEstimate: no tool or no tissue with depth, or none of it near the tool.
    """
    picture, labels = frame.view
    tissue, tool = (frame.labels == TISSUE) & (frame.depth > 0), frame.labels == TOOL
    count = int(tissue.sum())
    if count < geometry.min_tissue_pixels or not (labels == TOOL).any():
        raise NoEstimate(f"Frame {frame.frame.number} shows no instrument at tissue with depth to make a sheet of.")
    depth = frame.depth
    if geometry.smoothing > 0:
        depth, _ = smooth_surface(depth, tissue, geometry.smoothing)
    keep = min(1.0, particles / count)
    points = back_project(depth, camera.scaled(depth.shape[1], depth.shape[0]))
    # As steep as at full resolution: edges are longer by as much as fewer are kept.
    longest = geometry.max_edge / np.sqrt(keep)
    mesh = grid_mesh(points, tissue, occluder=tool, max_edge=longest, keep=keep)
    if len(mesh.vertices) == 0:
        raise NoEstimate(f"The tissue's depth in frame {frame.frame.number} is too rough to make a sheet of.")
    small, instrument = shrunk(picture, labels == TOOL)
    size = small.shape[1], small.shape[0]
    pixels = grid_to_picture(mesh.pixels[:, ::-1], mesh.grid_shape, size)
    column, row = np.clip(pixels.round().astype(int), 0, np.array(size) - 1).T
    reach = max(DRIVEN, size[0] / mesh.grid_shape[1] / np.sqrt(keep))  # a row of particles at least
    away = tool_distance(instrument)[row, column]
    driven = away < reach
    if not driven.any():
        raise NoEstimate(f"No tissue lies within {reach:.0f} px of the instrument in frame {frame.frame.number}.")
    background = ~driven & (away > np.percentile(away, FAR))
    body = make_body(mesh.vertices, mesh.triangles, pinned=mesh.rim & background)
    return Surface(body, np.flatnonzero(driven), pixels, camera.scaled(*size), reach)
