"""A small foreign simulation of a pulled block, and ringing beams, written as the data have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from palpate.evaluation.foreign.liver import HELD, MATERIALS, MESH
from palpate.physics.fem import box, find_equilibrium, make_solid

FORCES = {
    "linear": np.array([[1.5, 0.0, 2.0], [1.2, 0.4, 2.4]]),
    "neohookean": np.array([[0.2, 0.0, 0.3], [0.3, 0.1, 0.3]]),
}
"""On the block, one row a frame [N]."""


def write_mesh(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """A block of 8×4×4 cm."""
    nodes, tetrahedra = box((0.08, 0.04, 0.04), (6, 3, 3))
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", str(len(nodes))]
    lines += [f"{index + 1} {' '.join(map(repr, map(float, node)))}" for index, node in enumerate(nodes)]
    lines += ["$EndNodes", "$Elements", str(1 + len(tetrahedra)), "1 2 2 0 0 1 2 3"]
    lines += [f"{index + 2} 4 2 0 0 {' '.join(map(str, cell + 1))}" for index, cell in enumerate(tetrahedra)]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MESH).write_text("\n".join([*lines, "$EndElements", ""]), encoding="ascii")
    np.save(folder / HELD, np.flatnonzero(np.isclose(nodes[:, 0], 0)))
    return nodes, tetrahedra


def write_pull(folder: Path, law: str, noise: float = 0.0, points: int = 200, pulls: np.ndarray | None = None) -> Path:
    """A sequence of two frames, or one for each of other forces, whose tool pulls on one end; points all over the
    surface."""
    pulls = FORCES[law] if pulls is None else pulls
    body = make_solid(*write_mesh(folder))
    generator = np.random.default_rng(5)
    held = np.repeat(np.isclose(body.rest[:, :1], 0), 3, axis=1)
    tool = np.flatnonzero(np.isclose(body.rest[:, 0], 0.08) & (body.rest[:, 2] > 0.02))
    positions, cloud = [], []
    for frame, force in enumerate(pulls):
        forces = np.zeros_like(body.rest)
        forces[tool] = force / len(tool)
        moved = body.rest + find_equilibrium(body, MATERIALS[law], held, forces=forces, steps=4).displacement
        positions.append(moved)
        chosen = moved[body.faces[generator.integers(len(body.faces), size=points)]]
        places = np.einsum("pk,pkx->px", generator.dirichlet([1, 1, 1], points), chosen)
        cloud.append(np.column_stack([np.full(points, frame), places + noise * generator.normal(size=places.shape)]))
    path = folder / f"{law}_s1.npz"
    near = np.flatnonzero(np.isclose(body.rest[:, 0], 0.08))
    arrays = {"positions": np.array(positions, np.float32), "true_forces": pulls, "force_vertices": near}
    np.savez(path, **arrays, tool_vertices=tool.astype(float), pc=np.concatenate(cloud))
    return path


def write_beam(path: Path, frequency: float, decay: float) -> Path:
    """A tip at 100 Hz that is held, let go after half a second, and creeps a little."""
    times = np.arange(500) / 100
    since = np.maximum(times - 0.5, 0)
    fall = 0.006 * np.exp(-decay * since) * np.cos(2 * np.pi * frequency * since) + 4e-4 * np.exp(-since / 0.9)
    columns = [times]
    for marker in range(6):
        columns += [0.05 + (fall if marker < 3 else 0 * fall), np.full(500, 0.02 * marker), np.full(500, 0.07)]
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack(columns), delimiter=",", header="t_s," + "m," * 18, comments="")
    return path
