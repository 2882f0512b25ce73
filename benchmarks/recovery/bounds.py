"""Cramér–Rao bounds of a contact: Fisher information of its dent at the truth.

The bounds hold on the true mesh and at the true instants, with two delays of the press as further parameters
(`estimators.direct.motion`). `known` leaves these out where the instants are known. Where the press is no step on a
vertex, its patch, direction, rise and fall are unknown as well (`estimators.direct.patch`).
"""

import dataclasses

import numpy as np

from palpate.data.contact.interaction import Interaction
from palpate.data.synthetic.scene import Scene
from palpate.data.synthetic.truth import PressedMotion
from palpate.estimators.direct.estimator import FITTED, LEAST_OBSERVATIONS
from palpate.estimators.direct.motion import PressMotion, about_tissue
from palpate.estimators.direct.patch import PatchMotion
from palpate.estimators.direct.problem import dent_problem
from palpate.estimators.onset import BETWEEN
from palpate.physics.identifiability import box_information
from palpate.physics.load import Press, PressShape, held
from palpate.physics.mechanics import RECOMMENDED


def field_information(contact: Interaction, scene: Scene, motion: PressedMotion) -> np.ndarray | None:
    """Information of log θ and both delays from the sequence of a dent with its own noise, shape [5, 5].

    None without a sequence.

    Args:
        contact: observed contact, which must begin in the true onset's frame.
    """
    sequence = contact.sequence
    if sequence is None or len(sequence.times) < LEAST_OBSERVATIONS:
        return None
    truth, logs, within = _truth(contact, scene, motion)
    offset = scene.mesh.pixels[scene.vertex] - contact.mesh.pixels[contact.vertex]
    # Depth change about the true vertex, as far as the sequence shows it.
    recentred = truth.having(depth=sequence.elsewhere(*offset.tolist()))
    kind = PressMotion if motion.shape == PressShape() else PatchMotion
    problem = dent_problem(recentred, FITTED, within, kind=kind)
    press = problem.motion
    every = press.parameters(logs, motion.shape) if isinstance(press, PatchMotion) else logs
    problem.look(every)
    # The press's shape is unknown, and of the second delay nothing is known where the release was not observed.
    found = about_tissue(problem.information(every), box_information(press.box(RECOMMENDED.log_box)), len(logs))
    return np.pad(found, (0, 5 - len(logs)))


def known(information: np.ndarray, onset: str) -> np.ndarray:
    """Information of log θ alone [..., 3, 3] from that with both delays [..., 5, 5].

    Args:
        onset: STAMP = the press began at its time stamp; BETWEEN = anywhere within a frame of it.
    """
    if onset != BETWEEN:
        return information[..., :3, :3]
    delays = box_information(np.repeat([[-1.0], [1.0]], 2, axis=1))  # a frame either way
    prior = np.diag(np.concatenate([np.zeros(3), np.diag(delays)]))
    flat = information.reshape(-1, 5, 5)
    return np.array([about_tissue(item, prior) for item in flat]).reshape(*information.shape[:-2], 3, 3)


def _truth(contact: Interaction, scene: Scene, motion: PressedMotion) -> tuple[Interaction, np.ndarray, float]:
    """True contact, its parameters [5] ([4] without an observed release), and the frame interval [s]."""
    within, step = 1 / scene.settings.fps, FITTED.time_step
    seconds = (motion.release_frame - motion.onset_frame) * within if contact.released else np.inf
    press = Press.at(scene.vertex, scene.direction, held(seconds / step, FITTED.steps))
    delays = np.array([motion.delay, motion.release_delay])[: 1 + contact.released] / within
    logs = np.concatenate([np.log(np.abs(motion.theta)), delays])
    return dataclasses.replace(contact, mesh=scene.mesh, load=press, time_step=step), logs, within
