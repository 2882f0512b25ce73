"""Batches for the tests of the torch side."""

from palpate.physics import Mesh, Press
from tests.physics.sheets import pressed


def batch_of(meshes: list[Mesh], vertices, load_steps=None, steps: int = 200) -> tuple[list[Mesh], list[Press]]:
    """Meshes, each pressed along the normal of its contact vertex."""
    durations = load_steps or [50] * len(meshes)
    return meshes, [pressed(*sample, steps) for sample in zip(meshes, vertices, durations, strict=True)]
