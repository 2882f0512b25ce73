"""The pictures of docs/reports/physics.md: stability, windows, chaos.

    python -m benchmarks.physics_plots

from the checkout; they go to docs/figures.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from palpate.benchmarks.shared import command_line
from palpate.physics.load import Press, held
from palpate.physics.mechanics import Mechanics, highest_frequency
from palpate.physics.mesh import Mesh, grid_mesh
from palpate.physics.msd.cone import GRID_EIGENVALUE, exact_radii, window_radii
from palpate.physics.msd.simulation import simulate, simulate_sensitivities

FIGURES = Path("docs/figures")
NORMAL = np.array([0.1, 0.2, -0.97])
NAMED = "k_s = {}, k_d = {}, F = {}"
DEFAULT = Mechanics()


def press(vertex: int, mechanics: Mechanics) -> Press:
    """The paper's load on a vertex."""
    return Press.at(vertex, NORMAL, held(mechanics.load_steps, mechanics.steps))


def contact_path(theta: tuple[float, ...], mesh: Mesh, vertex: int, mechanics: Mechanics) -> np.ndarray:
    """Motion of a pressed vertex in double precision, shape [T, 3]."""
    return simulate(theta, mesh, press(vertex, mechanics), mechanics, dtype=np.float64)


def sheet(size: int, spacing: float = 0.0027) -> tuple[Mesh, int]:
    """A wavy square mesh and the vertex in its middle."""
    row, column = np.mgrid[:size, :size]
    z = 0.5 + spacing * (0.3 * np.sin(column / 1.7) + 0.2 * np.cos(row / 1.3))
    points = np.stack([column * spacing, row * spacing, z], -1).astype(np.float32)
    return grid_mesh(points, np.ones((size, size), dtype=bool)), size // 2 * size + size // 2


def stability() -> Figure:
    """Peak displacement over k_s and k_d for each way to integrate."""
    mesh, vertex = sheet(10)
    stiffness, damping = np.geomspace(0.1, 60, 40), np.geomspace(0.01, 1.5, 36)
    ways = {
        "Euler, explicit damping (paper)": Mechanics(damping="explicit"),
        "Euler, implicit damping": DEFAULT,
        "drift–kick–drift": Mechanics(scheme="dkd"),
    }
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    for axis, (name, mechanics) in zip(axes, ways.items(), strict=True):
        with np.errstate(all="ignore"):
            peaks = [
                [np.abs(contact_path((k, d, -1e-4), mesh, vertex, mechanics)).max() for k in stiffness] for d in damping
            ]
        size = np.log10(np.nan_to_num(np.array(peaks) / 1e-4, nan=1e30, posinf=1e30))
        image = axis.pcolormesh(stiffness, damping, size, vmin=-2, vmax=4, cmap="viridis", shading="nearest")
        frequency = highest_frequency(mesh.springs, len(mesh.vertices), 1.0, mechanics)
        limit = (2 / mechanics.time_step / frequency) ** 2
        axis.axvline(limit, color="w", ls="--")
        axis.text(limit * 0.92, 0.0115, "Δt·ω = 2", color="w", ha="right", fontsize=9)
        if mechanics.damping == "explicit":
            axis.axhline(2 * mechanics.mass / mechanics.time_step, color="w", ls=":")
            axis.text(0.11, 0.3, "k_d = 2m/Δt", color="w", fontsize=9)
        axis.add_patch(Rectangle((0.1, 0.01), 0.9, 0.99, fill=False, ec="r", lw=1.5))
        axis.set(xscale="log", yscale="log", title=name, xlabel="stiffness k_s [normalised]")
    axes[0].set_ylabel("damping k_d [normalised]")
    figure.colorbar(image, ax=axes, label="log₁₀ of peak displacement / |F| [scene units]", extend="both")
    return figure


def windows() -> Figure:
    """How far windows reach, and what they cost in accuracy."""
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    step = np.arange(200)
    left.plot(step, exact_radii(200), "k", label="exact cone")
    for index, (k, d) in enumerate(((1.0, 0.005), (0.5, 0.09), (0.05, 0.5))):
        used, checked = window_radii(k, d, Mechanics(window_error=1e-4), GRID_EIGENVALUE, 200)
        left.plot(step, used, f"C{index}", label=f"k_s = {k}, k_d = {d}: used")
        left.plot(step, checked, f"C{index}--", label="and checked against")
    left.set(xlabel="step [5 ms]", ylabel="radius [springs]", title="computed radius at window_error = 1e-4")
    mesh, vertex = sheet(201)
    asked = 10.0 ** np.arange(-6, -1)
    for index, theta in enumerate(((1.0, 0.005, -0.3), (0.5, 0.09, -0.1), (0.05, 0.5, -0.3), (0.5, 0.09, -10.0))):
        truth = contact_path(theta, mesh, vertex, DEFAULT)
        seen = np.stack([contact_path(theta, mesh, vertex, Mechanics(window_error=error)) for error in asked])
        errors = np.abs(seen - truth).max(axis=(1, 2)) / np.abs(truth).max()
        right.loglog(asked, np.maximum(errors, 1e-17), f"C{index}o-", label=NAMED.format(*theta))
    right.loglog(asked, asked, "k:", label="asked = measured")
    right.set(xlabel="window_error asked for [1]", ylabel="largest error / peak displacement [1]", ylim=(1e-18, 1))
    right.set_title("measured against the exact cone, double precision")
    left.legend(fontsize=8)
    right.legend(fontsize=8, loc="lower right")
    right.grid(alpha=0.3)
    return figure


def chaos() -> Figure:
    """Growth of the derivatives, and what single precision makes of the motion."""
    mesh, vertex = sheet(121)
    load = press(vertex, DEFAULT)
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for index, theta in enumerate(((0.5, 0.09, -0.1), (0.5, 0.09, -10.0), (1.0, 0.005, -0.3), (5.34, 0.0, -5.0))):
        double, jacobian = simulate_sensitivities(theta, mesh, load, DEFAULT, dtype=np.float64)
        peak = np.abs(double).max()
        growth = np.abs(jacobian * np.array(theta)).max(axis=(1, 2)) / peak
        error = np.abs(simulate(theta, mesh, load, DEFAULT) - double).max(axis=1) / peak
        for axis, values in ((left, growth), (right, np.maximum(error, 1e-9))):
            axis.semilogy(DEFAULT.times, values, f"C{index}", label=NAMED.format(*theta))
    left.axhline(100, color="k", ls=":", label="refused from here on (single precision)")
    left.set(xlabel="time [s]", ylabel="largest |θ·∂u/∂θ| / peak displacement [1]", title="sensitivity")
    right.set(xlabel="time [s]", ylabel="|single − double| / peak displacement [1]", title="error of single precision")
    for axis in (left, right):
        axis.legend(fontsize=8)
        axis.grid(alpha=0.3)
    return figure


def main() -> None:
    """Draw everything."""
    command_line(__doc__).parse_args()
    for draw in (stability, windows, chaos):
        path = FIGURES / f"{draw.__name__}.png"
        draw().savefig(path, dpi=100)
        print(f"written: {path}", flush=True)


if __name__ == "__main__":
    run_door(main)
