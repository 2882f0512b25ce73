"""A small batch made by hand: two pairs of curved depth maps with their meshes, contacts and observed displacements."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from palpate.physics import Mechanics, Press, contact_normal, grid_mesh, held
from palpate.physics.msd.batch import ObservationBatch
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
def make_batch() -> Callable[..., dict[str, Any]]:
    """`make_batch(window=1)`: a batch of two pairs in the data module's form; pixel (0, 0) is invalid everywhere."""

    def build(window: int = 1) -> dict[str, Any]:
        bumps = [[0.02 * pair + 0.01 * frame for frame in range(-window + 1, window + 1)] for pair in (1, 2)]
        frames = torch.from_numpy(np.stack([[_depth(bump) for bump in pair] for pair in bumps]))
        frames[..., 0, 0] = 0.0
        batch: dict[str, Any] = {
            "window_a": frames[:, :window],
            "window_b": frames[:, window:].flip(1),
            "clip": ["one", "two"],
            "frame": torch.tensor([3, 7]),
        }
        for side, sign in (("a", 1.0), ("b", -1.0)):
            meshes = [_mesh(depth) for depth in batch[f"window_{side}"][:, -1].numpy()]
            vertices = [len(mesh.vertices) // 2 for mesh in meshes]
            normals = [contact_normal(mesh, vertex) for mesh, vertex in zip(meshes, vertices, strict=True)]
            batch[f"mesh_{side}"] = meshes
            factor = held(MECHANICS.load_steps, MECHANICS.steps)
            batch[f"load_{side}"] = [
                Press.at(vertex, normal, factor) for vertex, normal in zip(vertices, normals, strict=True)
            ]
            batch[f"course_{side}"] = torch.tensor([[0, 8], [0, 8]])
            batch[f"observation_{side}"] = ObservationBatch(
                torch.full((2, 1), 7), sign * torch.tensor([[[0.0, 0.0, 0.02]]]).expand(2, 1, 3), torch.ones(2, 1)
            )
        return batch

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
def make_told_batch(make_batch) -> Callable[..., dict[str, Any]]:
    """`make_told_batch(window=1)`: the same with what was known of the contacts, for head posterior."""

    def build(window: int = 1) -> dict[str, Any]:
        batch = make_batch(window)
        vectors = torch.from_numpy(np.random.default_rng(4).normal(size=(2, CONTACT_FEATURES))).float()
        for side in ("a", "b"):
            batch[f"mesh_{side}"], batch[f"load_{side}"] = batch["mesh_a"], batch["load_a"]
            batch[f"observation_{side}"] = batch["observation_a"]
            batch[f"known_load_{side}"] = batch["load_a"]
            batch[f"contact_features_{side}"] = vectors
            batch[f"dent_{side}"] = [
                OnePixel(load.vertex, times, 0.01 * (index + 1), 1e-3 * (index + 1))
                for index, (load, times) in enumerate(zip(batch["load_a"], ([0.02, 0.04], [0.02]), strict=True))
            ]
        return batch

    return build
