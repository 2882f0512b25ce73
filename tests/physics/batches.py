"""Batches for the tests of the torch side."""

from palpate.physics import Mesh, Press
from palpate.physics.msd.batch import MeshBatch, PressBatch
from tests.physics.sheets import pressed


def joined(meshes: list[Mesh], loads: list[Press]) -> tuple[MeshBatch, PressBatch]:
    """Meshes with a load each."""
    return MeshBatch.from_meshes(meshes), PressBatch.of(loads)


def batch_of(meshes, vertices, load_steps=None, steps: int = 200) -> tuple[MeshBatch, PressBatch]:
    """Join meshes, each pressed along the normal of its contact vertex."""
    durations = load_steps or [50] * len(meshes)
    return joined(meshes, [pressed(*sample, steps) for sample in zip(meshes, vertices, durations, strict=True)])
