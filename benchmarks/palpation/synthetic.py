"""Palpations with known truth: another mesh and law than the fit's, a partial view, noise, and a pose that is off."""

import math
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from palpate.estimators.palpation.bench import Palpation
from palpate.estimators.palpation.registration import turned
from palpate.estimators.palpation.skin import Skin, cover
from palpate.physics.fem import Equilibrium, Material, box, find_equilibrium, make_solid, mesh_surface
from palpate.physics.fem.curved import curve
from palpate.physics.fem.meshing import Longest, around, refine

YOUNG, POISSON = 1e4, 0.42
"""The truth; Young's modulus in Pa."""
SENSORS = {"stereo": 0.0003, "time of flight": 0.001}
"""Noise along the line of sight [m]."""
TOOL = 0.015
"""Radius of the tool [m]."""


@dataclass(frozen=True)
class Body:
    """Palpated body, held at its bottom."""

    shape: str
    """`ball` or `slab`."""
    size: float
    """Diameter, or longest side [m]."""
    height: float
    """Height [m]."""

    def surface(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and triangles of the scanned surface, at a spacing [m]."""
        if self.shape == "ball":
            vertices, triangles = sphere(max(1, round(np.log2(self.size / 2 / spacing))))
            return vertices * self.size / 2 + [0, 0, self.size / 2], triangles
        counts = [max(1, round(side / spacing)) for side in (self.size, self.size, self.height)]
        nodes, tetrahedra = box((self.size, self.size, self.height), (counts[0], counts[1], counts[2]))
        faces = make_solid(nodes, tetrahedra).faces
        used, which = np.unique(faces, return_inverse=True)
        return nodes[used] - [self.size / 2, self.size / 2, 0], which.reshape(-1, 3)

    def skin(self, cells: int, spacing: float, longest: Longest | None = None) -> tuple[Skin, np.ndarray]:
        """The surface on quadratic tetrahedra, and the mask of their nodes' held components, those at the bottom.

        Args:
            cells: number of the mesh's cells along the longest side.
            spacing: distance of the surface's vertices [m].
            longest: longest edges, as `refine` takes it.
        """
        vertices, triangles = self.surface(spacing)
        if self.shape == "ball":
            # Share of the height below which a ball is held; a slab is held by its base.
            floor = 2, 0.12 * self.height
            meshed = mesh_surface(vertices, triangles, cells=cells, floor=floor, longest=longest)
            nodes, tetrahedra = meshed.nodes, meshed.tetrahedra
        else:
            high = max(2, math.ceil(cells * self.height / self.size))
            nodes, tetrahedra = box((self.size, self.size, self.height), (cells, cells, high))
            nodes = nodes - [self.size / 2, self.size / 2, 0]
            if longest is not None:
                nodes, tetrahedra = refine(nodes, tetrahedra, longest)
        body = make_solid(nodes, tetrahedra, order=2)
        floor = float(body.rest[:, 2].min())
        if self.shape == "ball":
            body = curve(body, vertices[triangles], body.rest[:, 2] <= floor + 1e-9)
        held = np.repeat(body.rest[:, 2:] <= floor + 1e-9, 3, axis=1)
        return cover(body, vertices, triangles, vertices[:, 2] <= floor), held

    def contact(self, along: float, around: float) -> tuple[np.ndarray, np.ndarray]:
        """A place on the upper surface, `along` radii or half sides from the middle, and the outward normal."""
        way = np.array([np.cos(around), np.sin(around), 0.0])
        if self.shape == "slab":
            return along * self.size / 2 * way + [0, 0, self.height], np.array([0.0, 0.0, 1.0])
        normal = along * way + [0, 0, np.sqrt(1 - along**2)]
        return self.size / 2 * normal + [0, 0, self.size / 2], normal


BODIES = {"ball": Body("ball", 0.1, 0.1), "slab": Body("slab", 0.09, 0.03)}


def sphere(halvings: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit sphere, an octahedron whose triangles are divided by four `halvings` times; vertices and triangles."""
    vertices = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)
    triangles = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(halvings):
        vertices, triangles = trimesh.remesh.subdivide(vertices, triangles)
        triangles = triangles.reshape(-1, 4, 3).swapaxes(0, 1).reshape(-1, 3)  # the first part of each, then the second
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices, triangles


def press(
    body: Body,
    force: float,
    place: tuple[float, float],
    cells: int,
    law: str = "neo_hookean",
    spacing: float | None = None,
    edge: float | None = None,
) -> tuple[Skin, Equilibrium, np.ndarray, np.ndarray]:
    """The truth: a body under a force along its normal; skin, rest, force [3] and contact [3].

    Args:
        body: pressed body, of YOUNG and POISSON.
        force: norm of the force [N].
        place: arguments of `Body.contact`.
        cells: number of its mesh's cells along the longest side.
        law: one of `physics.fem.LAWS`.
        spacing: distance of the surface's vertices; None = a 26th of the body's size [m].
        edge: longest edge of an element at the tool; None = as the cells are [m].
    """
    contact, normal = body.contact(*place)
    longest = None if edge is None else around(contact[None], TOOL, edge)
    skin, held = body.skin(cells, body.size / 26 if spacing is None else spacing, longest)
    vector = -force * normal
    forces = skin.pressed(contact, TOOL, vector)
    rest = find_equilibrium(skin.body, Material(law, YOUNG, POISSON), held, forces=forces)
    return skin, rest, vector, contact


def observe(
    skin: Skin, rest: Equilibrium, force: np.ndarray, contact: np.ndarray, sensor: str, seed: int, count: int = 20_000
) -> Palpation:
    """Observation of a sensor next to the tool: noisy points that face it, and its believed pose.

    The tool hides points within its radius of the contact. A depth picture of 640 × 480 shows a body of 10 cm at 30 cm
    in about 20,000 points, evenly over its solid angle. The noise is along the line of sight.
    """
    chance = np.random.default_rng(seed)
    direction = np.array([0.5, 0.3, 1.0]) / np.linalg.norm([0.5, 0.3, 1.0])
    eye = 0.3 * direction
    vertices = skin.moved(rest.displacement)
    corners = vertices[skin.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sights = eye - corners.mean(axis=1)
    far = np.linalg.norm(sights, axis=1)
    facing = (normals * sights).sum(axis=1) / far  # times the area
    shown = np.where(facing > 0.25 * np.linalg.norm(normals, axis=1), facing / far**2, 0.0)
    faces = chance.choice(len(shown), count, p=shown / shown.sum())
    shares = chance.dirichlet([1, 1, 1], count)
    points = np.einsum("pk,pkx->px", shares, corners[faces])
    at_rest = np.einsum("pk,pkx->px", shares, skin.vertices[skin.triangles[faces]])
    points = points[np.linalg.norm(at_rest - contact, axis=1) > TOOL]
    back = (eye - points) / np.linalg.norm(eye - points, axis=1, keepdims=True)
    points = points + chance.normal(0, SENSORS[sensor], len(points))[:, None] * back
    true = np.eye(4)
    true[:3, :3] = Rotation.align_vectors([-direction], [[0, 0, 1.0]])[0].as_matrix()
    true[:3, 3] = eye
    # The tool's pose is off by standard deviations of 0.01 rad and 2 mm.
    off = np.concatenate([chance.normal(0, 0.01, 3), chance.normal(0, 0.002, 3)])
    return Palpation(force, contact, (points - eye) @ true[:3, :3], turned(true, off), TOOL, 1.1 * TOOL)
