"""The pictures of docs/physics.md: stability, convergence, windows, chaos, spreading.

`python -m benchmarks.physics_plots` from the checkout; they go to docs/figures.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from physics.load import Press, held
from physics.mechanics import Mechanics, highest_frequency
from physics.mesh import Mesh, grid_mesh
from physics.msd.cone import GRID_EIGENVALUE, exact_radii, window_radii
from physics.msd.reference import free_vertices, spring_force
from physics.msd.simulation import simulate, simulate_field, simulate_sensitivities

FIGURES = Path("docs/figures")
NORMAL = np.array([0.1, 0.2, -0.97])


def press(vertex: int, mechanics: Mechanics = Mechanics()) -> Press:  # noqa: B008 (frozen)
    """The paper's load on a vertex."""
    return Press.at(vertex, NORMAL, held(mechanics.load_steps, mechanics.steps))


def sheet(size: int, spacing: float = 0.0027) -> tuple[Mesh, int]:
    """A wavy square mesh and the vertex in its middle."""
    row, column = np.mgrid[:size, :size]
    z = 0.5 + spacing * (0.3 * np.sin(column / 1.7) + 0.2 * np.cos(row / 1.3))
    points = np.stack([column * spacing, row * spacing, z], -1).astype(np.float32)
    return grid_mesh(points, np.ones((size, size), dtype=bool)), size // 2 * size + size // 2


def stability(path: Path) -> None:
    """Peak displacement over k_s and k_d for each way to integrate."""

    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    mesh, vertex = sheet(10)
    stiffness, damping = np.geomspace(0.1, 60, 40), np.geomspace(0.01, 1.5, 36)
    ways = {
        "Euler, explicit damping (paper)": Mechanics(damping="explicit"),
        "Euler, implicit damping": Mechanics(),
        "drift–kick–drift": Mechanics(scheme="dkd"),
    }
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    for axis, (name, mechanics) in zip(axes, ways.items(), strict=True):
        with np.errstate(all="ignore"):
            peaks = [
                [
                    np.abs(simulate((k, d, -1e-4), mesh, press(vertex, mechanics), mechanics, dtype=np.float64)).max()
                    for k in stiffness
                ]
                for d in damping
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
    figure.savefig(path / "stability.png", dpi=100)


def exact(mesh: Mesh, vertex: int, theta: tuple, mechanics: Mechanics) -> np.ndarray:
    """Displacement of the contact vertex at each step [T, 3] by an adaptive method of eighth order (DOP853)."""
    stiffness, damping, force = theta
    count = len(mesh.vertices)
    vertices = mesh.vertices.astype(np.float64)
    first, second = mesh.springs.T
    rest = vertices[second] - vertices[first]
    free = free_vertices(mesh, press(vertex, mechanics), mechanics)

    def derivative(_: float, state: np.ndarray, factor: float) -> np.ndarray:
        displacement, velocity = state.reshape(2, count, 3)
        pull = spring_force(displacement, rest, mesh.springs)
        total = -damping * velocity
        np.add.at(total, first, stiffness * pull)
        np.add.at(total, second, -stiffness * pull)
        total[vertex] += factor * force * NORMAL
        return np.concatenate([velocity.ravel(), (total * free[:, None] / mechanics.mass).ravel()])

    options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-13}
    release = mechanics.load_steps * mechanics.time_step
    early, late = mechanics.times[: mechanics.load_steps], mechanics.times[mechanics.load_steps :]
    early[-1] = release
    loaded = solve_ivp(derivative, (0, release), np.zeros(6 * count), t_eval=early, args=(1.0,), **options).y
    let_go = solve_ivp(derivative, (release, late[-1]), loaded[:, -1], t_eval=late, args=(0.0,), **options).y
    return np.concatenate([loaded, let_go], axis=1).T.reshape(-1, 2, count, 3)[:, 0, vertex]


def convergence(path: Path) -> None:
    """Error against the time step for both schemes."""

    from matplotlib.figure import Figure

    mesh, vertex = sheet(10, 0.01)
    figure = Figure(figsize=(6.5, 4.5), layout="constrained")
    axis = figure.subplots()
    steps = np.array([1, 2, 4, 8, 16, 32])
    for theta, style in (((0.5, 0.09, -0.02), "-"), ((0.6, 0.02, -0.02), "--")):
        reference = exact(mesh, vertex, theta, Mechanics(steps=100, load_steps=40))
        for scheme, colour in (("euler", "C0"), ("dkd", "C1")):
            errors = []
            for finer in steps:
                mechanics = Mechanics(time_step=0.005 / finer, steps=100 * finer, load_steps=40 * finer, scheme=scheme)
                seen = simulate(theta, mesh, press(vertex, mechanics), mechanics, dtype=np.float64)[finer - 1 :: finer]
                errors.append(np.abs(seen - reference).max() / np.abs(reference).max())
            order = -np.polyfit(np.log(steps[2:]), np.log(errors[2:]), 1)[0]
            label = f"{scheme}, k_s = {theta[0]}, k_d = {theta[1]}: order {order:.2f}"
            axis.loglog(5 / steps, errors, colour + "o" + style, label=label)
    axis.axvline(5, color="0.7", ls=":")
    axis.set_xticks(5 / steps, [f"{value:.3g}" for value in 5 / steps])
    axis.minorticks_off()
    axis.set(xlabel="time step Δt [ms]", ylabel="largest error / peak displacement [1]")
    axis.set_title("10×10 sheet against DOP853 (dotted: the default Δt)")
    axis.legend(fontsize=8)
    axis.grid(alpha=0.3)
    figure.savefig(path / "convergence.png", dpi=100)


def windows(path: Path) -> None:
    """How far windows reach, and what they cost in accuracy."""

    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    step = np.arange(200)
    left.plot(step, exact_radii(200), "k", label="exact cone")
    for index, (k, d) in enumerate(((1.0, 0.005), (0.5, 0.09), (0.05, 0.5))):
        used, checked = window_radii(k, d, Mechanics(window_error=1e-4), GRID_EIGENVALUE, 200)
        left.plot(step, used, f"C{index}", label=f"k_s = {k}, k_d = {d}: used")
        left.plot(step, checked, f"C{index}--", label="and checked against")
    left.set(xlabel="step [5 ms]", ylabel="radius [springs]", title="computed radius at window_error = 1e-4")
    left.legend(fontsize=8)
    mesh, vertex = sheet(201)
    asked = 10.0 ** np.arange(-6, -1)
    for index, theta in enumerate(((1.0, 0.005, -0.3), (0.5, 0.09, -0.1), (0.05, 0.5, -0.3), (0.5, 0.09, -10.0))):
        truth = simulate(theta, mesh, press(vertex), Mechanics(), dtype=np.float64)
        seen = [
            simulate(theta, mesh, press(vertex), Mechanics(window_error=error), dtype=np.float64) for error in asked
        ]
        errors = [max(np.abs(one - truth).max() / np.abs(truth).max(), 1e-17) for one in seen]
        right.loglog(asked, errors, f"C{index}o-", label="k_s = {}, k_d = {}, F = {}".format(*theta))
    right.loglog(asked, asked, "k:", label="asked = measured")
    right.set(xlabel="window_error asked for [1]", ylabel="largest error / peak displacement [1]")
    right.set_title("measured against the exact cone, double precision")
    right.legend(fontsize=8, loc="lower right")
    right.set_ylim(1e-18, 1)
    right.grid(alpha=0.3)
    figure.savefig(path / "windows.png", dpi=100)


def chaos(path: Path) -> None:
    """Growth of the derivatives, and what single precision makes of the motion."""

    from matplotlib.figure import Figure

    mesh, vertex = sheet(121)
    time = Mechanics().times
    figure = Figure(figsize=(12, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for index, theta in enumerate(((0.5, 0.09, -0.1), (0.5, 0.09, -10.0), (1.0, 0.005, -0.3), (5.34, 0.0, -5.0))):
        label = "k_s = {}, k_d = {}, F = {}".format(*theta)
        double, jacobian = simulate_sensitivities(theta, mesh, press(vertex), Mechanics(), dtype=np.float64)
        single = simulate(theta, mesh, press(vertex), Mechanics())
        peak = np.abs(double).max()
        left.semilogy(time, np.abs(jacobian * np.array(theta)).max(axis=(1, 2)) / peak, f"C{index}", label=label)
        right.semilogy(time, np.maximum(np.abs(single - double).max(axis=1) / peak, 1e-9), f"C{index}", label=label)
    left.axhline(100, color="k", ls=":", label="refused from here on (single precision)")
    left.set(xlabel="time [s]", ylabel="largest |θ·∂u/∂θ| / peak displacement [1]", title="sensitivity")
    right.set(xlabel="time [s]", ylabel="|single − double| / peak displacement [1]", title="error of single precision")
    for axis in (left, right):
        axis.legend(fontsize=8)
        axis.grid(alpha=0.3)
    figure.savefig(path / "chaos.png", dpi=100)


def spreading(path: Path) -> None:
    """Where the sheet moves, at release and at the end."""

    from matplotlib.figure import Figure

    mesh, vertex = sheet(121)
    field = np.linalg.norm(simulate_field((0.5, 0.09, -0.1), mesh, press(vertex), Mechanics()), axis=2)
    figure = Figure(figsize=(10, 4.3), layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, step in zip(axes, (49, 199), strict=True):
        size = np.log10(np.maximum(field[step].reshape(121, 121), 1e-12))
        image = axis.imshow(size, vmin=-10, vmax=-1, extent=(-60, 60, 60, -60))
        axis.set(xlabel="column from the contact [springs]", title=f"after {5 * (step + 1)} ms")
    axes[0].set_ylabel("row from the contact [springs]")
    figure.colorbar(image, ax=axes, label="log₁₀ displacement [scene units]")
    figure.savefig(path / "spreading.png", dpi=100)


def main() -> None:
    """Draw everything."""
    for draw in (stability, convergence, windows, chaos, spreading):
        draw(FIGURES)
        print(f"written: {FIGURES / draw.__name__}.png", flush=True)


if __name__ == "__main__":
    main()
