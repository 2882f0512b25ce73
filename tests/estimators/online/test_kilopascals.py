"""Kilopascals of a field: how often the intervals hold on drawn pulls of known E, and what tells none."""

import dataclasses
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from palpate.data.source.sequence import open_sequence
from palpate.estimators.online.kilopascals import Kilopascals, Palpated, particle_at
from palpate.estimators.online.sequence import SequenceTissue
from palpate.estimators.online.session import Method
from palpate.estimators.online.settings import OnlineSettings
from palpate.evaluation.online import sequences
from palpate.evaluation.online.sequences import FINE, SIDE, SPRINGS, Sequence, State
from tests.sequences import FPS, SHIFT, TURN, write_sequence

MODULUS = 1.7 - 0.5**2 / 1.7
"""E times thickness of the drawn net where springs along rows are 1: it is isotropic, C₁₁ 1.7 and C₁₂ 0.5 of them."""
FRAMES, PALPATED_SD = 60, 0.15


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


class Told(NamedTuple):
    """Of a drawn pull, at the N particles."""

    true: np.ndarray
    """E, shape [N] [kPa]."""
    known: np.ndarray
    """Where stiffness is determined, shape [N], bool."""
    stiff: np.ndarray
    by_force: np.ndarray
    """E and the ends of its interval, shape [3, N] [kPa]."""
    by_palpation: np.ndarray
    """Likewise; not a number where E was palpated at a place that is not determined."""


def told(seed: int, folder: Path, patch: pytest.MonkeyPatch, fitted: int = 0) -> Told:
    """A sheet of two parts of 1 to 20 and two to five times as many kPa, 1 to 4 mm thick, pulled any way.

    The wrench has 3 % of noise; E is palpated at one place with 15 %.
    """
    draw = np.random.default_rng(seed)
    contrast, soft, thick = draw.uniform(2, 5), np.exp(draw.uniform(0, np.log(20))), draw.uniform(0.001, 0.004)
    angle, off = draw.uniform(0, 2 * np.pi), draw.uniform(-0.02, 0.02)
    ahead, aside, up = draw.uniform(0.01, 0.035), draw.uniform(-0.015, 0.015), draw.uniform(0, 0.03)

    def stiff(rest: np.ndarray) -> np.ndarray:
        return (rest[:, :2] - SIDE / 2) @ (np.cos(angle), np.sin(angle)) > off

    def way(share: np.ndarray) -> np.ndarray:
        return share[:, None] * (ahead, aside, 0) + np.sin(np.pi / 2 * share)[:, None] * (0, 0, up)

    patch.setattr(sequences, "STIFF", contrast)
    drawn = Sequence(False, FRAMES, way, stiff).pull(150, 3000, FRAMES)
    states = sequences._sheet_states(way(np.arange(1, FRAMES + 1) / FRAMES), stiff)
    nodes = np.where(stiff(sequences._grid(FINE, FINE, (SIDE, SIDE))[0]), contrast, 1.0)
    forces = -1000 * soft * thick / MODULUS * np.array([np.zeros(3), *(net_force(state, nodes) for state in states)])
    forces += draw.normal(0, 0.03 * np.abs(forces).max(), forces.shape)
    rows = np.column_stack([np.arange(FRAMES + 1) / FPS, forces])
    folder.mkdir(exist_ok=True)
    np.savetxt(folder / "forces.csv", rows, "%.10g", ",", header="time_s,Fx,Fy,Fz", comments="")
    path = write_sequence(folder, FRAMES, drawn=drawn, forces="forces.csv", thickness=thick)
    settings = OnlineSettings(particles=300, fitted=fitted, method=Method(optimizer="gauss-newton"))
    tissue = SequenceTissue(open_sequence(path), settings)
    field = list(tissue.fields())[-1][1]
    where = stiff((field.rest - SHIFT) @ TURN)
    true = soft * np.where(where, contrast, 1.0)
    at = particle_at((field.rest - SHIFT) @ TURN, np.array([*draw.uniform(0.02, 0.1, 2), 0.0]), 0.01)
    young = 1000 * true[at] * np.exp(draw.normal(0, PALPATED_SD))
    other = Kilopascals(tissue.driven, Palpated(young, PALPATED_SD, at)).anchored(
        dataclasses.replace(field, young=None)
    )
    nothing = np.full((3, len(true)), np.nan)
    both = (nothing if found.young is None else found.young for found in (field, other))
    return Told(true, field.known, where, *both)


def holds(true: np.ndarray, young: np.ndarray) -> np.ndarray:
    """Where an interval is told, whether it holds."""
    some = np.isfinite(young[0])
    return ((young[1] <= true) & (true <= young[2]))[some]
