"""Synthetic pulls of sheets of known stiffness, as sequences of a robot."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np

from benchmarks.online import sequences
from benchmarks.online.sequences import FINE, SIDE, SPRINGS, State
from palpate.data.source.sequence import open_sequence
from palpate.estimators.online.driven import Cloud, DrivenTissue
from palpate.estimators.online.kilopascals import Kilopascals
from palpate.estimators.online.particle_field import ParticleField
from palpate.estimators.online.sequence import SequenceTissue
from palpate.estimators.online.session import Frame, Method
from palpate.estimators.online.settings import OnlineSettings
from tests.sequences import FPS, SHIFT, TURN, write_sequence

MODULUS = 1.7 - 0.5**2 / 1.7
"""E times thickness of the drawn net where springs along rows are 1: it is isotropic, C₁₁ 1.7 and C₁₂ 0.5 of them."""
FRAMES, PALPATED_SD = 60, 0.15


@dataclass(frozen=True, eq=False)
class DrawnPull:
    """What was drawn."""

    path: Path
    """sequence.yaml, with followed points, clouds and forces."""
    contrast: float
    """Stiffness of the stiff part over that of the soft one."""
    soft: float
    """E of the soft part [kPa]."""
    angle: float
    """Of the direction across the sheet in which the stiff part lies."""
    off: float
    """How far from the sheet's middle it begins [m]."""
    draw: np.random.Generator
    """For what is drawn further."""

    def stiff(self, rest: np.ndarray) -> np.ndarray:
        """Which places of the sheet at rest, in its own frame [P, 3] [m], are stiff, shape [P]."""
        return (rest[:, :2] - SIDE / 2) @ (np.cos(self.angle), np.sin(self.angle)) > self.off

    def young(self, field: ParticleField) -> np.ndarray:
        """True E at a field's particles, shape [N] [kPa]."""
        return self.soft * np.where(self.stiff((field.rest - SHIFT) @ TURN), self.contrast, 1.0)


def net_force(state: State, stiffness: np.ndarray) -> np.ndarray:
    """What the gripper does to the drawn net whose nodes have that stiffness [N], shape [3]."""
    rest, at = sequences._grid(FINE, FINE, (SIDE, SIDE))
    now, held, total = rest + state(rest), sequences._held(rest, False), np.zeros(3)
    for right, up, weight in SPRINGS:
        first = at[: FINE - right, max(-up, 0) : FINE - max(up, 0)].ravel()
        other = at[right:, max(up, 0) : FINE - max(-up, 0)].ravel()
        apart, stiff = now[first] - now[other], weight * (stiffness[first] + stiffness[other]) / 2
        length, old = np.linalg.norm(apart, axis=1), np.linalg.norm(rest[first] - rest[other], axis=1)
        force = (stiff * (1 - old / length))[:, None] * apart
        total += force[held[first]].sum(axis=0) - force[held[other]].sum(axis=0)
    return total


def draw_pull(seed: int, folder: Path) -> DrawnPull:
    """A sheet of two parts of 1 to 20 and two to five times as many kPa, 1 to 4 mm thick, pulled any way.

    The wrench has 3 % of noise.
    """
    draw = np.random.default_rng(seed)
    contrast, soft, thick = draw.uniform(2, 5), np.exp(draw.uniform(0, np.log(20))), draw.uniform(0.001, 0.004)
    angle, off = draw.uniform(0, 2 * np.pi), draw.uniform(-0.02, 0.02)
    ahead, aside, up = draw.uniform(0.01, 0.035), draw.uniform(-0.015, 0.015), draw.uniform(0, 0.03)
    found = DrawnPull(folder / "sequence.yaml", contrast, soft, angle, off, draw)

    def way(share: np.ndarray) -> np.ndarray:
        return share[:, None] * (ahead, aside, 0) + np.sin(np.pi / 2 * share)[:, None] * (0, 0, up)

    with mock.patch.object(sequences, "STIFF", contrast):
        drawn = sequences.Sequence(False, FRAMES, way, found.stiff).pull(150, 3000, FRAMES)
        states = sequences._sheet_states(way(np.arange(1, FRAMES + 1) / FRAMES), found.stiff)
    nodes = np.where(found.stiff(sequences._grid(FINE, FINE, (SIDE, SIDE))[0]), contrast, 1.0)
    forces = -1000 * soft * thick / MODULUS * np.array([np.zeros(3), *(net_force(state, nodes) for state in states)])
    forces += draw.normal(0, 0.03 * np.abs(forces).max(), forces.shape)
    rows = np.column_stack([np.arange(FRAMES + 1) / FPS, forces])
    folder.mkdir(exist_ok=True)
    np.savetxt(folder / "forces.csv", rows, "%.10g", ",", header="time_s,Fx,Fy,Fz", comments="")
    write_sequence(folder, FRAMES, drawn=drawn, forces="forces.csv", thickness=thick)
    return found


def followed(path: Path, optimizer: str, fitted: int, clouds: bool = True) -> tuple[ParticleField, DrivenTissue]:
    """The last frame's field with that optimiser's steps, by points with clouds or alone, and its tissue."""
    settings = OnlineSettings(particles=300, fitted=fitted, method=Method(optimizer=optimizer))  # ty: ignore[invalid-argument-type]  one of its names
    tissue = SequenceTissue(open_sequence(path), settings)
    step = tissue.driven.step

    def taken(moved: np.ndarray, cloud: Cloud, led: np.ndarray) -> Frame:
        return step(moved, cloud if clouds else None, led)

    with mock.patch.object(tissue.driven, "step", taken):
        return list(tissue.fields())[-1][1], tissue.driven


def by_palpation(pull: DrawnPull, field: ParticleField, driven: DrivenTissue) -> np.ndarray:
    """E and the ends of its interval, shape [3, N] [kPa], by a palpation at a drawn place with 15 % of noise.

    Not a number where that place is not determined.
    """
    place = (*pull.draw.uniform(0.02, 0.1, 2), 0)
    at = int(np.linalg.norm((field.rest - SHIFT) @ TURN - place, axis=1).argmin())
    young = 1000 * pull.young(field)[at] * np.exp(pull.draw.normal(0, PALPATED_SD))
    found = Kilopascals(driven, (young, PALPATED_SD, at)).anchored(dataclasses.replace(field, young=None)).young
    return np.full((3, len(field.rest)), np.nan) if found is None else found


def holds(true: np.ndarray, young: np.ndarray) -> np.ndarray:
    """Where there is an interval, whether it holds."""
    some = np.isfinite(young[0])
    return ((young[1] <= true) & (true <= young[2]))[some]
