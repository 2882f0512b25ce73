"""A way in space as a robot takes it: times, poses and expected forces."""

from typing import Any

import numpy as np

from palpate.planning.pressing import STEP, PressingCosts
from palpate.planning.roadmap import Plan

COLUMNS = ("time_s", "x", "y", "z", "qx", "qy", "qz", "qw", "expected_force_N", "low", "high")


def waypoints(costs: PressingCosts, plan: Plan) -> np.ndarray:
    """Rows of `COLUMNS` along a way at constant speed, shape [W, 11].

    Poses are the tip's, its z axis along the shaft away from the port, turned there from the frame's the shortest way;
    low and high are the force's 90 % interval [N].
    """
    gone = np.cumsum(np.linalg.norm(np.diff(plan.places, axis=0, prepend=plan.places[:1]), axis=1))
    at = np.union1d(gone, np.linspace(0.0, gone[-1], int(gone[-1] / (STEP * costs.radius)) + 2))
    tips = np.stack([np.interp(at, gone, each) for each in plan.places.T], axis=1)
    x, y, z = (tips - costs.port).T / np.maximum(np.linalg.norm(tips - costs.port, axis=1), 1e-9)
    turns = np.stack([-y, x, 0 * z, 1 + z], axis=1)
    turns[turns[:, 3] < 1e-9] = [1.0, 0.0, 0.0, 0.0]  # straight down: about x
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    force = costs.loads(tips)[0] * costs.scene.young
    return np.column_stack([at / costs.scene.speed, tips, turns, force, force / costs.spread, force * costs.spread])


def as_path(rows: np.ndarray, frame: str) -> dict[str, Any]:
    """Waypoints [W, 11] in the shape of ROS's `nav_msgs/Path`."""
    poses = []
    for time, x, y, z, *turn in rows[:, :8].tolist():
        pose = {"position": {"x": x, "y": y, "z": z}, "orientation": dict(zip("xyzw", turn, strict=True))}
        stamp = {"sec": int(time), "nanosec": int(time % 1 * 1e9)}
        poses.append({"header": {"stamp": stamp, "frame_id": frame}, "pose": pose})
    return {"header": poses[0]["header"], "poses": poses}
