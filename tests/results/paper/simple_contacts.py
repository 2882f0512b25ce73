"""Small contacts and test records for the tests of the evaluation."""

import math

import numpy as np
import torch

from palpate.data.contact.interaction import Interaction
from palpate.models.records import with_reference_tissue
from palpate.physics import Bounds, Mechanics, Observation, Press, grid_mesh, held
from palpate.results.paper.simulated import simulate_contacts

MECHANICS = Mechanics(steps=40, load_steps=20)
BOUNDS = Bounds(stiffness=(0.05, 2.0), damping=(0.005, 0.3), force=(-0.5, 0.0), initial=(0.5, 0.09, -0.1))
SIZE = 6
STEPS = np.arange(7, 40, 8)


def sheet():
    """A curved sheet of 6×6 vertices, 0.04 scene units apart."""
    u, v = np.meshgrid(*[np.linspace(-0.1, 0.1, SIZE)] * 2)
    points = np.stack([u, v, 0.6 + u**2 + 0.1 * v], axis=-1).astype(np.float32)
    return grid_mesh(points, np.ones((SIZE, SIZE), bool), max_edge=0.1)


def contact(theta, vertex=14, load_steps=20, noise=0.0, seed=0):
    """A contact whose observation is the simulation with θ, plus noise [scene units]."""
    load = Press.at(vertex, np.array([0.0, 0.0, -1.0], np.float32), held(load_steps, MECHANICS.steps))
    unseen = Observation.of_point(vertex, MECHANICS.times[STEPS], np.zeros((len(STEPS), 3)), math.nan)
    still = Interaction(sheet(), load, {"point": unseen}, MECHANICS.time_step)
    (trajectory,), _ = simulate_contacts(np.asarray(theta), [still], MECHANICS)
    jitter = np.random.default_rng(seed).normal(0, noise, (len(STEPS), 3)) if noise else 0.0
    return observing(still, trajectory[STEPS] + jitter)


def observing(one, displacement):
    """Contact with other displacements [N, 3] [scene units]."""
    return one.having(point=one.observation.moved(displacement, math.nan))


def record(theta, estimate, clip="a", frame=0, **changes):
    """A test record of a contact with true θ and an estimate."""
    seen = contact(theta, vertex=14 + frame % 3, noise=1e-4, seed=frame)
    estimate = np.asarray(estimate, dtype=np.float32)
    trajectory, error = simulate_contacts(estimate, [seen], MECHANICS)
    constants = with_reference_tissue(torch.from_numpy(estimate[None])).numpy()
    reference, reference_error = simulate_contacts(constants, [seen], MECHANICS)
    told = {"clip": clip, "frame": frame, "mesh": seen.mesh, "load": seen.load, "observation": seen.observation}
    told |= {"theta": estimate, "trajectory": trajectory[0], "reference_trajectory": reference[0]}
    told |= {"error_predicted": float(error[0]), "error_reference": float(reference_error[0])}
    told |= {"next_depth_error": 0.004 + 1e-5 * frame, "copy_error": 0.005 + 2e-5 * frame}
    return told | {"theta_sensitivity": 0.001} | changes
