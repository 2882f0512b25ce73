"""A way in space as a robot takes it: times, poses and expected forces."""

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.planning.pressing import PressingCosts
from palpate.planning.roadmap import Plan

COLUMNS = ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "expected_force_N", "force_low_N", "force_high_N")


def waypoints(costs: PressingCosts, plan: Plan) -> np.ndarray:
    """Return rows of `COLUMNS` along a way at constant speed, shape [W, 11].

    Poses are the tip's, its z axis along the shaft away from the port. It is turned there the shortest way, at the
    start from the frame's and then from the start's, so that poses change little by little; low and high are the
    force's 90 % interval [N].
    """
    tips, begin = costs.along(plan.places[:-1], plan.places[1:])
    tips = np.delete(tips, begin[1:], axis=0)
    at = np.cumsum(np.linalg.norm(np.diff(tips, axis=0, prepend=tips[:1]), axis=1))
    axes = tips - costs.port
    length = np.linalg.norm(axes, axis=1, keepdims=True)
    axes = np.where(length > 0, axes / np.maximum(length, 1e-9), [0.0, 0.0, 1.0])
    first = _shortest(np.array([0.0, 0.0, 1.0]), axes[:1])
    turns = (_shortest(axes[0], axes) * first).as_quat()
    force = costs.loads(tips)[0] * costs.scene.young
    return np.column_stack([at / costs.scene.speed, tips, turns, force, force / costs.spread, force * costs.spread])


def _shortest(one: np.ndarray, others: np.ndarray) -> Rotation:
    """Return the shortest turns from one unit vector [3] to others [W, 3]."""
    half = np.column_stack([np.cross(one, others), 1 + others @ one])
    half[half[:, 3] < 1e-9] = [*np.cross(one, np.roll(one, 1) + np.array([0.0, 0.0, 1e-3])), 0.0]  # to the opposite
    return Rotation.from_quat(half)
