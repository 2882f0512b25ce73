"""Length of a scene unit, by the known diameter of an instrument's shaft: a cylinder between two straight edges.

The planes through the camera's centre and the two edges touch the cylinder. Its axis has the direction n₁ × n₂ of their
normals. With 2α, the angle between the planes, it lies r / sin α from the centre, half-way between them.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from palpate.common.robust import median_sd
from palpate.data.clip import ClipStream
from palpate.data.labels import TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.source.camera import Camera

LEAST_EDGE = 40.0
"""Least length of the edges of a shaft that is seen well [px]."""
LEAST_SAMPLES = 8
"""Smallest number of a shaft's pixels with depth in a frame that counts."""
NOT_SEEN = (
    "--shaft-diameter tells no millimetres: in no frame are two straight edges of a shaft seen well, with depth of the "
    "shaft (of tissue at its tip, where depth is guessed from the pictures); lengths stay in scene units"
)


@dataclass(frozen=True)
class Edge:
    """A straight edge of a shaft in the picture [px]."""

    place: np.ndarray
    """Middle of the edge (column, row), shape [2]."""
    normal: np.ndarray
    """Unit vector out of the shaft, shape [2]."""
    length: float
    place_sd: float
    """Standard deviation of the edge's place along the normal, by its points."""
    angle_sd: float
    """Standard deviation of the edge's direction [rad]."""

    def plane(self, camera: Camera, moved: float = 0.0, turned: float = 0.0) -> np.ndarray:
        """Normal of the plane through the camera's centre, out of the shaft, shape [3], unit length."""
        across, down = self.normal + turned * np.array([-self.normal[1], self.normal[0]])
        offset = -(across * self.place[0] + down * self.place[1]) - moved
        found = np.array([across * camera.fx, down * camera.fy, across * camera.cx + down * camera.cy + offset])
        return found / np.linalg.norm(found)


def shaft_edges(tool: np.ndarray) -> tuple[Edge, Edge] | None:
    """The two edges of the largest tool in a mask, bool [H, W]; None where they aren't seen well."""
    outlines = cv2.findContours(tool.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    if not outlines:
        return None
    points = max(outlines, key=cv2.contourArea)[:, 0].astype(np.float64)
    inside = ((points >= 3) & (points < np.array(tool.shape[::-1]) - 3)).all(axis=1)  # not the border's own
    across = np.linalg.eigh(np.cov(points.T))[1][:, 0]
    side = (points - points.mean(axis=0)) @ across
    one, other = (_edge(points[inside & (sign * side > 0)], sign * across) for sign in (1, -1))
    if one is None or other is None:
        return None
    least = max(LEAST_EDGE, 1.2 * abs(one.normal @ (one.place - other.place)))  # 1.2 widths of the shaft
    # Seen well, the two edges enclose an angle of 0.35 at most.
    facing = min(one.length, other.length) > least and one.normal @ other.normal < -math.cos(0.35)
    return (one, other) if facing else None


def _edge(points: np.ndarray, outwards: np.ndarray) -> Edge | None:
    """The straight line on which most of one side of an outline lies, [P, 2]; None where too little does."""
    if len(points) < LEAST_EDGE:
        return None
    first, second = points[np.random.default_rng(0).integers(len(points), size=(2, 200))]
    apart = np.maximum(np.linalg.norm(second - first, axis=1), 1.0)[:, None]
    normals = (second - first)[:, ::-1] * [1, -1] / apart
    near = np.abs(points @ normals.T - (first * normals).sum(axis=1)) < 2.0
    on = near[:, (near.sum(axis=0) * (apart[:, 0] > LEAST_EDGE / 4)).argmax()]
    for _ in range(3):
        place = points[on].mean(axis=0)
        normal = np.linalg.eigh(np.cov(points[on].T))[1][:, 0]
        off = (points - place) @ normal
        on = np.abs(off) < 2.0
        if on.sum() < max(LEAST_EDGE / 2, 0.4 * len(points)):
            return None
    normal = normal * np.sign(normal @ outwards)
    along = (points[on] - place) @ [-normal[1], normal[0]]
    steps = 1 + np.ptp(along) * np.abs(normal).min()
    # Eight neighbouring points of an outline have the same error; an edge lies anywhere between two pixels.
    variance = np.square(off[on]).mean() * 8.0 / on.sum() + (math.sqrt(1 / 12) / steps) ** 2
    # A mask's last pixels lie half a pixel within it, along the axis that the edge runs across.
    place = place + 0.5 * np.abs(normal).max() * normal
    return Edge(place, normal, float(np.ptp(along)), math.sqrt(variance), math.sqrt(variance / along.var()))


def shaft_depth(planes: Sequence[np.ndarray], radius: float, rays: np.ndarray, *, axis: bool) -> np.ndarray:
    """Depth of a cylinder at rays of the picture.

    Args:
        planes: normals of the planes that touch it, out of it, shape [3] each.
        radius: radius of the cylinder, in any unit.
        rays: (x, y, 1), shape [P, 3].
        axis: True = depth of the axis where it is nearest to the ray; False = of the surface.

    Returns:
        Shape [P], in the radius's unit; NaN where the ray passes by.
    """
    along = np.cross(planes[0], planes[1])
    along /= np.linalg.norm(along)
    towards = -(planes[0] + planes[1])
    towards /= np.linalg.norm(towards)
    distance = radius / -(planes[0] @ towards)
    if axis:
        beside = rays @ (normal := np.cross(along, towards))
        within = rays - np.outer(beside, normal)
        depth = distance * within[:, 2] / (within @ towards)
        return np.where(np.abs(beside) * depth < 2 * radius, depth, np.nan)
    across = rays - np.outer(rays @ along, along)
    square, middle = (across * across).sum(axis=1), distance * across @ towards
    with np.errstate(invalid="ignore"):
        return (middle - np.sqrt(middle**2 - square * (distance**2 - radius**2))) / square


class ShaftRuler:
    """Gathers estimates of the length of a scene unit from the frames of a clip.

    Args:
        diameter: diameter of the shaft [m].
        clip: the clip.
    """

    def __init__(self, diameter: float, clip: ClipStream) -> None:
        self._radius, self._picture, self._grid = diameter / 2, clip.picture_camera, clip.camera
        self._guessed = clip.guesses_depth
        self._found: list[tuple[float, float, float]] = []

    def watched(self, frames: Iterable[PreparedFrame]) -> Iterator[PreparedFrame]:
        """Yield the frames, each after it was measured."""
        for frame in frames:
            if frame.picture_labels is not None and frame.has_depth:
                edges = shaft_edges(frame.picture_labels == TOOL)
                if edges is not None:
                    self._add(frame, *edges)
            yield frame

    def _add(self, frame: PreparedFrame, *edges: Edge) -> None:
        """Compare the shaft's depth with the clip's, where the tool has one, else where its tip touches the tissue."""
        if self._guessed and frame.geometry is not None:
            (columns, rows), depth = np.array(frame.geometry.pixel)[:, None], frame.geometry.tissue_point[2:]
        else:
            rows, columns = np.nonzero((frame.labels == TOOL) & (frame.depth > 0) & (not self._guessed))
            depth = frame.depth[rows, columns]
        rays = np.column_stack([columns, rows, np.ones(len(depth))]) @ np.linalg.inv(self._grid.matrix).T

        def logs(changes: np.ndarray) -> np.ndarray:
            planes = [edge.plane(self._picture, *change) for edge, change in zip(edges, changes, strict=True)]
            return np.log(shaft_depth(planes, self._radius, rays, axis=self._guessed) / depth)

        here, steps = logs(np.zeros((2, 2))), np.eye(4).reshape(4, 2, 2) * [0.1, 1e-3]
        if np.isfinite(here).sum() < (1 if self._guessed else LEAST_SAMPLES):
            return
        middle = float(np.nanmedian(here))
        slopes = [(np.nanmedian(logs(step)) - np.nanmedian(logs(-step))) / (2 * step.sum()) for step in steps]
        sds = np.array([[edge.place_sd, edge.angle_sd] for edge in edges]).ravel()
        own = float(np.square(slopes * sds).sum()) + median_sd(here - middle) ** 2 / LEAST_SAMPLES
        # What touches may lie beside the axis by as much as the radius.
        beside = self._radius / math.sqrt(3) / (math.exp(middle) * depth[0]) if self._guessed else 0.0
        # All frames share the errors of masks' ends [px] and of the stated diameter, as a logarithm.
        shared = 0.25**2 * (slopes[0] ** 2 + slopes[2] ** 2) + 0.01**2 + beside**2
        if own + shared < 0.2**2:
            self._found.append((middle, own, shared))

    def metres(self) -> tuple[float, float] | None:
        """Length of a scene unit [m] and the standard deviation of its logarithm; None if no frame determines it."""
        if not self._found:
            return None
        logs, own, shared = np.array(self._found).T
        middle = float(np.median(logs))
        # Frames of a tool that keeps still err alike, so that many are no better than one.
        variance = np.median(own) + median_sd(logs - middle) ** 2 / len(logs) + np.median(shared)
        return math.exp(middle), math.sqrt(variance)
