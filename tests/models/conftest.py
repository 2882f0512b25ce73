"""A small batch made by hand: two pairs of curved depth maps with their meshes, contacts and observed displacements."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from palpate.physics import Mechanics, Press, contact_normal, grid_mesh, held
from palpate.physics.msd.batch import Direction, ObservationBatch, PairBatch
from palpate.physics.observation import Linearised

HEIGHT, WIDTH = 40, 48
MECHANICS = Mechanics(steps=24, load_steps=8)
CONTACT_FEATURES = 6


def _depth(bump: float) -> np.ndarray:
    rows, columns = np.meshgrid(np.linspace(-1, 1, HEIGHT), np.linspace(-1, 1, WIDTH), indexing="ij")
    return (0.5 + 0.1 * columns - bump * np.exp(-4 * (rows**2 + columns**2))).astype(np.float32)


def _mesh(depth: np.ndarray):
    rows, columns = np.meshgrid(np.arange(HEIGHT), np.arange(WIDTH), indexing="ij")
    points = np.stack([(columns - WIDTH / 2) / WIDTH * depth, (rows - HEIGHT / 2) / WIDTH * depth, depth], axis=-1)
    inside = (abs(rows - HEIGHT // 2) <= 6) & (abs(columns - WIDTH // 2) <= 6)
    return grid_mesh(points, inside & (depth > 0), max_edge=0.5)


@pytest.fixture(scope="session")
def make_batch() -> Callable[..., PairBatch]:
    """`make_batch(window=1)`: a batch of two pairs as the data module makes it; pixel (0, 0) is invalid everywhere."""

    def direction(window: torch.Tensor, sign: float) -> Direction:
        meshes = [_mesh(depth) for depth in window[:, -1].numpy()]
        vertices = [len(mesh.vertices) // 2 for mesh in meshes]
        normals = [contact_normal(mesh, vertex) for mesh, vertex in zip(meshes, vertices, strict=True)]
        factor = held(MECHANICS.load_steps, MECHANICS.steps)
        loads = [Press.at(vertex, normal, factor) for vertex, normal in zip(vertices, normals, strict=True)]
        moved = sign * torch.tensor([[[0.0, 0.0, 0.02]]]).expand(2, 1, 3)
        observation = ObservationBatch(torch.full((2, 1), 7), moved, torch.ones(2, 1))
        return Direction(window, torch.tensor([[0, 8], [0, 8]]), meshes, loads, observation)

    def build(window: int = 1) -> PairBatch:
        bumps = [[0.02 * pair + 0.01 * frame for frame in range(-window + 1, window + 1)] for pair in (1, 2)]
        frames = torch.from_numpy(np.stack([[_depth(bump) for bump in pair] for pair in bumps]))
        frames[..., 0, 0] = 0.0
        both = direction(frames[:, :window], 1.0), direction(frames[:, window:].flip(1), -1.0)
        return PairBatch(["one", "two"], torch.tensor([3, 7]), *both)

    return build


class OnePixel:
    """What a camera sees that looks along z at one vertex."""

    def __init__(self, vertex: int, times: list[float], change: float, noise: float) -> None:
        self.vertices, self.times, self.change, self.noise = np.array([vertex]), np.array(times), change, noise

    def look(self, moved: np.ndarray, slopes: np.ndarray) -> None:
        """Nothing depends on the motion."""

    def linearise(self, moved: np.ndarray, slopes: np.ndarray) -> Linearised:
        """Change of its depth and the derivatives."""
        return Linearised((moved[:, 0, 2] - self.change) / self.noise, slopes[:, 0, 2] / self.noise)


@pytest.fixture(scope="session")
def make_told_batch(make_batch) -> Callable[..., PairBatch]:
    """`make_told_batch(window=1)`: the same with what was known of the contacts, for head posterior."""

    def build(window: int = 1) -> PairBatch:
        batch = make_batch(window)
        vectors = torch.from_numpy(np.random.default_rng(4).normal(size=(2, CONTACT_FEATURES))).float()
        for one in (batch.a, batch.b):
            one.meshes, one.loads, one.observation = batch.a.meshes, batch.a.loads, batch.a.observation
            one.known_loads, one.contact_features = batch.a.loads, vectors
            one.dents = [
                OnePixel(load.vertex, times, 0.01 * (index + 1), 1e-3 * (index + 1))
                for index, (load, times) in enumerate(zip(batch.a.loads, ([0.02, 0.04], [0.02]), strict=True))
            ]
        return batch

    return build
