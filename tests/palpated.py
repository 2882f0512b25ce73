"""Sequences beside a robot whose tool presses a slab of known stiffness, drawn by finite elements on another mesh."""

from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from benchmarks.palpation.synthetic import Body, press

BODY = Body("slab", 0.09, 0.025)
TURN = Rotation.from_euler("xyz", (20, -15, 70), degrees=True).as_matrix()
SHIFT = np.array([0.4, -0.1, 0.25])
EYE = np.array([0.08, -0.05, 0.3])
"""Of the camera, in the slab's own frame, looking at its middle."""
FPS, BEFORE, RAMP, HELD = 10.0, 8, 4, 2
"""Frames a second; frames at rest, of the tool's way down, and under the whole force."""
RADIUS = 0.015


def write_palpation(
    folder: Path,
    presses: list[tuple[float, tuple[float, float]]],
    young: float = 8e3,
    poisson: float = 0.4,
    noise: float = 3e-4,
    count: int = 6000,
    seed: int = 1,
    cells: int = 10,
    law: str = "corotational",
    edge: float | None = RADIUS / 3,
    **changed: object,
) -> Path:
    """Draw one; returns sequence.yaml.

    Args:
        folder: where.
        presses: force [N] and place as `Body.contact` takes it.
        young, poisson, law, cells: of the slab.
        edge: longest of an element where the tool presses; None = as the cells are [m].
        noise: along the camera's sight [m].
        count: points of a cloud.
        changed: fields of the file; None leaves one out.
    """
    random = np.random.default_rng(seed)
    (folder / "clouds").mkdir(parents=True, exist_ok=True)
    look = EYE - [0, 0, BODY.height]
    eye = np.eye(4)
    eye[:3, :3] = Rotation.align_vectors([-look / np.linalg.norm(look)], [[0, 0, 1.0]])[0].as_matrix()
    eye[:3, 3] = EYE
    robot = np.eye(4)
    robot[:3, :3], robot[:3, 3] = TURN, SHIFT
    hand_eye, tool = robot @ eye, Rotation.from_matrix(TURN) * Rotation.from_euler("x", 180, degrees=True)
    tips, wrenches, number = [], [], 0

    def shoot(skin, moved: np.ndarray, contact: np.ndarray | None) -> np.ndarray:
        corners = (skin.vertices + moved)[skin.triangles]
        top = (skin.vertices[skin.triangles][..., 2] > BODY.height - 1e-9).all(axis=1)
        size = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) * top
        face, shares = random.choice(len(size), count, p=size / size.sum()), random.dirichlet([1, 1, 1], count)
        points = np.einsum("pk,pkx->px", shares, corners[face])
        if contact is not None:
            points = points[np.linalg.norm(points[:, :2] - contact[:2], axis=1) > RADIUS]
        back = (EYE - points) / np.linalg.norm(EYE - points, axis=1, keepdims=True)
        points = points + random.normal(0, noise, len(points))[:, None] * back
        return (points - eye[:3, 3]) @ eye[:3, :3]

    for which, (force, place) in enumerate(presses):
        skin, rest, vector, contact = press(BODY, young, poisson, force, place, cells, law, BODY.size / 40, edge)
        whole = skin.shares @ rest.displacement
        near = np.linalg.norm(skin.vertices - contact, axis=1).argsort()[:4]
        sink = whole[near].mean(axis=0)
        above = np.linspace(0.03, 0.003, BEFORE if which == 0 else 4)
        rows = [(contact + np.array([0, 0, high]), 0.0) for high in above]
        rows += [(contact + share * sink, share) for share in [*np.linspace(0, 1, RAMP + 1)[1:], *[1.0] * HELD]]
        rows += [(contact + np.array([0, 0, 0.01]), 0.0)]
        for tip, share in rows:
            points = shoot(skin, share * whole, contact if share else None)
            np.savez(folder / f"clouds/{number:03d}.npz", points=points)
            tips.append(tip)
            wrenches.append(tool.inv().apply(TURN @ (-share * vector)))
            number += 1
    times = np.arange(number) / FPS
    places = np.array(tips) @ TURN.T + SHIFT
    poses = np.column_stack([times, places, np.tile(tool.as_quat(), (number, 1))])
    np.savetxt(folder / "poses.csv", poses, "%.10g", ",", header="time_s,x,y,z,qx,qy,qz,qw", comments="")
    table = np.column_stack([times, np.array(wrenches) + np.array([0.3, -0.2, 0.5])])  # with the sensor's bias
    np.savetxt(folder / "forces.csv", table, "%.10g", ",", header="time_s,Fx,Fy,Fz", comments="")
    given = {"clouds": "clouds/{number}.npz", "poses": "poses.csv", "fps": FPS, "forces": "forces.csv"}
    given |= {"thickness": BODY.height, "grip_radius": RADIUS, "hand_eye": hand_eye.tolist()}
    given = {name: value for name, value in (given | changed).items() if value is not None}
    (folder / "sequence.yaml").write_text(yaml.safe_dump(given))
    return folder / "sequence.yaml"
