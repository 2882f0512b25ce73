"""Batches for the tests of the torch side."""

from __future__ import annotations

import numpy as np
import torch

from physics.mesh import contact_normal
from physics.msd import ContactBatch, MeshBatch


def batch_of(meshes, vertices, load_steps=None, load=None) -> tuple[MeshBatch, ContactBatch]:
    """Join meshes, each pressed along the normal of its contact vertex."""
    directions = np.stack([contact_normal(mesh, vertex) for mesh, vertex in zip(meshes, vertices, strict=True)])
    contact = ContactBatch(
        vertex=torch.tensor(vertices),
        direction=torch.tensor(directions, dtype=torch.float32),
        load_steps=torch.tensor(load_steps or [50] * len(meshes)),
        load=load,
    )
    return MeshBatch.from_meshes(meshes), contact
