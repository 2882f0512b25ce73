"""The batches that `benchmarks.rollout` times, and our own backends as contenders."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from physics.mechanics import Mechanics
from physics.mesh import contact_normal, grid_mesh, nearest_vertex
from physics.msd import ContactBatch, MeshBatch, rollout, rollout_field

GRID = (120, 214)
"""Height and width of the network's depth grid [px]; its ellipse below has 14,800 vertices, like the paper's meshes."""

SPACING = 0.0027
"""Distance of two pixels on tissue 0.5 scene units away, seen by a 60° camera [scene units]."""


@dataclass
class Task:
    """A batch to roll out, and weights that make one number of its trajectories."""

    theta: Tensor
    """k_s, k_d and F near the paper's mean, shape [B, 3], float32."""
    mesh: MeshBatch
    contact: ContactBatch
    mechanics: Mechanics
    weights: Tensor
    """Derivative of the loss by the trajectories, shape [B, T, 3]."""


def make_task(batch: int, scale: float, grid: tuple[int, int] = GRID) -> Task:
    """B meshes of `scale` times as many vertices as the grid's, pressed in the middle."""
    height, width = (round(size * math.sqrt(scale)) for size in grid)
    row, column = np.mgrid[:height, :width]
    valid = ((row - height / 2) / height) ** 2 + ((column - width / 2) / width) ** 2 <= 0.4285**2
    random = np.random.default_rng(0)
    meshes, vertices, directions = [], [], []
    for _ in range(batch):
        phase = 6 * random.random()
        z = 0.5 + 0.02 * np.sin(column / 31 + phase) + 0.01 * np.cos(row / 23)
        points = np.stack([(column - width / 2) * SPACING, (row - height / 2) * SPACING, z], -1)
        meshes.append(grid_mesh(points, valid))
        vertices.append(nearest_vertex(meshes[-1], points[height // 2, width // 2]))
        directions.append(contact_normal(meshes[-1], vertices[-1]))
    mechanics = Mechanics()
    return Task(
        theta=torch.tensor([[0.5, 0.09, -0.1]]) * (1 + 0.1 * torch.linspace(-1, 1, batch)[:, None]),
        mesh=MeshBatch.from_meshes(meshes),
        contact=ContactBatch(
            torch.tensor(vertices),
            torch.tensor(np.array(directions), dtype=torch.float32),
            torch.full((batch,), mechanics.load_steps),
        ),
        mechanics=mechanics,
        weights=torch.randn(batch, mechanics.steps, 3, generator=torch.Generator().manual_seed(0)),
    )


class Autograd:
    """A contender whose trajectories torch can differentiate."""

    def __init__(self, task: Task) -> None:
        """Keep the task."""
        self.task = task

    def simulate(self, theta: Tensor) -> Tensor:
        """Trajectories of the contact vertices, shape [B, T, 3]."""
        raise NotImplementedError

    def forward(self) -> np.ndarray:
        """Trajectories of the contact vertices, shape [B, T, 3], without a gradient."""
        with torch.no_grad():
            return self.simulate(self.task.theta).numpy()

    def total(self) -> np.ndarray:
        """Gradient of Σ weights·trajectory by θ, shape [B, 3]."""
        theta = self.task.theta.clone().requires_grad_()
        (self.task.weights * self.simulate(theta)).sum().backward()
        return theta.grad.numpy()


class Ours(Autograd):
    """`physics.msd.rollout`: numba's exact cone or checked window, or torch's stencil."""

    def __init__(self, task: Task, variant: str) -> None:
        """Choose the backend by the variant: exact, window or stencil."""
        super().__init__(task)
        error = 1e-4 if variant == "window" else 0.0
        self.mechanics = dataclasses.replace(task.mechanics, window_error=error)
        self.backend = "torch" if variant == "stencil" else "numba"

    def simulate(self, theta: Tensor) -> Tensor:
        """Trajectories of the contact vertices, shape [B, T, 3]."""
        return rollout(theta, self.task.mesh, self.task.contact, self.mechanics, self.backend)


class Field:
    """`physics.msd.rollout_field`: every vertex at every step; compiled, it has no gradient."""

    total = None

    def __init__(self, task: Task) -> None:
        """Keep the task."""
        self.task = task

    def forward(self) -> np.ndarray:
        """Trajectories of the contact vertices, picked out of the whole field, shape [B, T, 3]."""
        task = self.task
        with torch.no_grad():
            field = rollout_field(task.theta, task.mesh, task.contact, task.mechanics, "numba")
            return field[:, task.mesh.vertex_offsets[:-1] + task.contact.vertex].transpose(0, 1).numpy()
