"""Batches for the tests of the torch side."""

from __future__ import annotations

from physics.load import Load, Press
from physics.mesh import Mesh
from physics.msd.batch import GripBatch, LoadBatch, MeshBatch, PressBatch
from tests.physics.sheets import pressed


def joined(meshes: list[Mesh], loads: list[Load]) -> tuple[MeshBatch, LoadBatch]:
    """Meshes with a load each."""
    kind = PressBatch if isinstance(loads[0], Press) else GripBatch
    return MeshBatch.from_meshes(meshes), kind.of(loads)


def batch_of(meshes, vertices, load_steps=None, steps: int = 200) -> tuple[MeshBatch, PressBatch]:
    """Join meshes, each pressed along the normal of its contact vertex."""
    durations = load_steps or [50] * len(meshes)
    loads = [pressed(*sample, steps) for sample in zip(meshes, vertices, durations, strict=True)]
    return joined(meshes, loads)
