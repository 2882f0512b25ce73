"""Small contacts and test records for the tests of the evaluation."""

import numpy as np

from evaluation.baselines import reference_theta, simulate_cases
from physics.mechanics import Bounds, Mechanics
from physics.mesh import grid_mesh

MECHANICS = Mechanics(steps=40, load_steps=20)
BOUNDS = Bounds(stiffness=(0.05, 2.0), damping=(0.005, 0.3), force=(-0.5, 0.0), initial=(0.5, 0.09, -0.1))
SIZE = 6
STEPS = np.arange(7, 40, 8)


def sheet():
    """A curved sheet of 6×6 vertices, 0.04 scene units apart."""
    u, v = np.meshgrid(*[np.linspace(-0.1, 0.1, SIZE)] * 2)
    points = np.stack([u, v, 0.6 + u**2 + 0.1 * v], axis=-1).astype(np.float32)
    return grid_mesh(points, np.ones((SIZE, SIZE), bool), max_edge=0.1)


def case(theta, vertex=14, load_steps=20, noise=0.0, seed=0):
    """A contact whose observation is the simulation with θ, plus noise [scene units]."""
    contact = {
        "mesh": sheet(),
        "vertex": vertex,
        "direction": np.array([0.0, 0.0, -1.0], np.float32),
        "load_steps": load_steps,
        "steps": STEPS,
        "displacement": np.zeros((len(STEPS), 3), np.float32),
        "weight": np.ones(len(STEPS), np.float32),
    }
    trajectory, _ = simulate_cases(np.asarray(theta), [contact], MECHANICS)
    jitter = np.random.default_rng(seed).normal(0, noise, (len(STEPS), 3)) if noise else 0.0
    return {**contact, "displacement": (trajectory[0][STEPS] + jitter).astype(np.float32)}


def record(theta, estimate, clip="a", frame=0, with_mesh=True, **changes):
    """A test record of a contact with true θ and an estimate."""
    contact = case(theta, vertex=14 + frame % 3, noise=1e-4, seed=frame)
    estimate = np.asarray(estimate, dtype=np.float32)
    trajectory, error = simulate_cases(estimate, [contact], MECHANICS)
    reference, reference_error = simulate_cases(reference_theta(estimate[None]), [contact], MECHANICS)
    result = {
        "clip": clip,
        "frame": frame,
        "theta": estimate,
        "trajectory": trajectory[0],
        "reference_trajectory": reference[0],
        "observation": {name: contact[name] for name in ("steps", "displacement", "weight")},
        "load_steps": contact["load_steps"],
        "error_predicted": float(error[0]),
        "error_reference": float(reference_error[0]),
        "next_depth_error": 0.004 + 1e-5 * frame,
        "copy_error": 0.005 + 2e-5 * frame,
        "theta_sensitivity": 0.001,
    }
    if with_mesh:
        result["case"] = {name: contact[name] for name in ("mesh", "vertex", "direction")}
    return {**result, **changes}
