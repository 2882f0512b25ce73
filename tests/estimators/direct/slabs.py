"""Slabs beneath a surface, and depth-change sequences of their dents, for tests."""

import dataclasses
import math

import numpy as np

from palpate.data.contact.depth_sequence import DepthSequence, SequenceNoise
from palpate.data.contact.interaction import Interaction
from palpate.data.contact.patches import Patches
from palpate.estimators.direct.field import SequenceProblem
from palpate.estimators.direct.slab_motion import SlabMotion
from palpate.physics.fem.slab import Slab, slab_beneath
from palpate.physics.load import Press, held
from palpate.physics.observation import Observation
from tests.estimators.direct.test_field import FRAME, MESH, SIDE, SIGMA, SIZE

COARSE, FINE = (4, 4, 2), (6, 6, 2)
THICKNESS = 0.05
TIMES = FRAME * np.arange(1, 11)
LOAD = 5 * FRAME
VERTEX = int(np.flatnonzero((MESH.pixels == (16, 17)).all(axis=1))[0])
VERTEX_PLACE = (17.0, 16.0)
NORMAL = np.array([0.0, 0.0, -1.0])
THETA = (200.0, 6e4, -0.15)
"""E, d, F."""
LOGS = np.log(np.abs(THETA))
VISCOUS = np.log([100.0, 3e5, 0.08])
RELAXING = np.array([math.log(200.0), 0.0, math.log(0.3), math.log(0.1)])


def contact_of(released: bool = True) -> Interaction:
    press = Press.at(VERTEX, NORMAL, held(LOAD / 0.005 if released else math.inf, 100))
    return Interaction(MESH, press, Observation.of_point(VERTEX, TIMES, np.zeros((10, 3)), SIGMA), 0.005)


def slab_of(cells: tuple[int, int, int] = COARSE) -> Slab:
    return slab_beneath(MESH, VERTEX, NORMAL, THICKNESS, cells)


def motion_of(released: bool = True, times: np.ndarray = TIMES, **options) -> SlabMotion:
    pixels = MESH.pixels[[VERTEX, VERTEX + 3, VERTEX + 40]]
    return SlabMotion(contact_of(released), slab_of(), pixels, times, **options)


def showing(contact: Interaction, change: np.ndarray | None = None) -> Interaction:
    """The same with a depth-change sequence [10, SIDE, SIDE], or one of nothing."""
    change = np.zeros((10, SIDE, SIDE)) if change is None else change
    sequence = DepthSequence(TIMES, change.astype(np.float32), SequenceNoise(SIGMA, 0.0), SIZE)
    return dataclasses.replace(contact, sequence=sequence)


def problem_of(contact: Interaction, slab: Slab, **options) -> SequenceProblem[SlabMotion]:
    def motion(vertices: np.ndarray, times: np.ndarray) -> SlabMotion:
        return SlabMotion(contact, slab, MESH.pixels[vertices], times, **options)

    return SequenceProblem(contact, motion, None)


def seen(logs: np.ndarray, seed: int, cells: tuple[int, int, int], relaxing: bool = False) -> Interaction:
    """A contact whose depth-change sequence shows a slab with these parameters, with noise."""
    contact = contact_of()
    patches = Patches(MESH, VERTEX, SIZE)
    motion = SlabMotion(contact, slab_of(cells), MESH.pixels[patches.vertices], TIMES, relaxing=relaxing)
    moved = motion.at(logs)[0]
    assert np.abs(moved).max() > 5 * SIGMA
    change = patches.shown(patches.sunk(moved), patches.covering(moved)).reshape(-1, SIDE, SIDE)
    return showing(contact, change + np.random.default_rng(seed).normal(0, SIGMA, change.shape))


def empty_problem(cells: tuple[int, int, int] = COARSE) -> SequenceProblem[SlabMotion]:
    """A depth-change sequence of nothing, which `shows` fills."""
    return problem_of(showing(contact_of()), slab_of(cells))


def shows(problem: SequenceProblem[SlabMotion], moved: np.ndarray, near: np.ndarray | None = None) -> None:
    """Let the sequence show a motion without noise; pixels show the patches that they do at a motion `near`."""
    covering = problem.patches.covering(moved if near is None else near)
    problem.observed = problem.patches.shown(problem.patches.sunk(moved), covering)
