"""Drawn pulls of sheets of known stiffness, as sequences of a robot: do maps agree, and do their intervals hold?

    python -m tests.estimators.online.drawn_pulls --pulls 6 --seed 772001

Every seed draws a sheet of two parts, its thickness and a pull of 60 frames. Maps are compared by Spearman's rank
correlation between Gauss–Newton's and Adam's steps, and between followed points with clouds and points alone, where
both are determined; with the truth where tissue has stretched. 90 % intervals are those of Gauss–Newton's map by points
with clouds: of stiffness relative to its mean (of logarithms) where tissue has stretched, and of E by the force at the
grip and by a palpation at one place.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import dataclasses
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np
from scipy.stats import spearmanr

from palpate.common.options import options, require_within
from palpate.data.source.sequence import open_sequence
from palpate.estimators.estimate import NINETY
from palpate.estimators.online.driven import Cloud, DrivenTissue
from palpate.estimators.online.kilopascals import Kilopascals
from palpate.estimators.online.particle_field import ParticleField
from palpate.estimators.online.sequence import SequenceTissue
from palpate.estimators.online.session import Frame, Method
from palpate.estimators.online.settings import MOST_FITTED, OnlineSettings
from palpate.evaluation.online import sequences
from palpate.evaluation.online.sequences import FINE, SIDE, SPRINGS, State
from tests.sequences import FPS, SHIFT, TURN, write_sequence

MODULUS = 1.7 - 0.5**2 / 1.7
"""E times thickness of the drawn net where springs along rows are 1: it is isotropic, C₁₁ 1.7 and C₁₂ 0.5 of them."""
FRAMES, PALPATED_SD = 60, 0.15
KINDS = "stiffness", "E by force", "its stiff part", "E by palpation", "its stiff part there"
"""Of intervals."""
LEAST = 10
"""Particles that both maps determine, at least, for a rank correlation."""


@dataclass(frozen=True)
class Options:
    """Of the command."""

    pulls: int = 6
    """How many are drawn."""
    seed: int = 772001
    """Of the first pull; each further one takes the next."""
    fitted: int = 0
    """Frames to which time step, foundation and the stiffness of shapes are fitted."""

    def __post_init__(self) -> None:
        require_within(self, pulls=(1, 1000), seed=(0, 2**31), fitted=(0, MOST_FITTED))


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


def relative_holds(true: np.ndarray, field: ParticleField, stretched: np.ndarray) -> np.ndarray:
    """Where stiffness is determined, whether its interval holds, both relative to the mean where tissue stretched."""
    off = np.log(field.distance / true)
    return (np.abs(off - off[stretched].mean()) < NINETY * field.distance_log_sd)[field.known]


def rank(one: ParticleField, other: ParticleField) -> float:
    """Of two maps, where both are determined; not a number where that is hardly anywhere."""
    both = one.known & other.known
    if both.sum() < LEAST:
        return float("nan")
    return float(spearmanr(one.distance[both], other.distance[both]).statistic)


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge; returns the exit status."""
    chosen = options(Options, arguments, "tests.estimators.online.drawn_pulls", __doc__)
    held: dict[str, list[np.ndarray]] = {name: [] for name in KINDS}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(chosen.seed, chosen.seed + chosen.pulls):
            pull = draw_pull(seed, Path(folder) / str(seed))
            newton, driven = followed(pull.path, "gauss-newton", chosen.fitted)
            adam, _ = followed(pull.path, "adam", chosen.fitted)
            points, _ = followed(pull.path, "gauss-newton", chosen.fitted, clouds=False)
            true, nowhere = pull.young(newton), np.full((3, len(newton.rest)), np.nan)
            stiff = true > pull.soft
            force = nowhere if newton.young is None else newton.young
            palpated = by_palpation(pull, newton, driven)
            new = [relative_holds(true, newton, driven.stretched)]
            for young in (force, palpated):
                new += [holds(true, young), holds(true[stiff], young[:, stiff])]
            for name, each in zip(KINDS, new, strict=True):
                held[name].append(each)
            shares = ", ".join(f"{field.known.mean():.0%}" for field in (newton, adam, points))
            truth = float(spearmanr(newton.distance[driven.stretched], true[driven.stretched]).statistic)
            ranks = f"{rank(newton, adam):.2f}, with points' {rank(newton, points):.2f}, with the truth {truth:.2f}"
            counts = ", ".join(f"{name} {found[-1].sum()} of {len(found[-1])}" for name, found in held.items())
            print(f"{seed}: determined by Gauss–Newton, Adam, points alone {shares}; ranks with Adam's {ranks}")
            print(f"  intervals that hold: {counts}")
            if newton.young is not None:
                off, wide = (force[0] / true)[newton.known], (force[2] / force[0])[newton.known].max()
                parts = [off[part[newton.known]] for part in (~stiff, stiff)]
                medians = ", ".join(f"{np.median(part):.2f}" if len(part) else "none" for part in parts)
                print(
                    f"  E by force over the true one, soft and stiff part: {medians}; intervals up to {wide:.2f}-fold"
                )
            sys.stdout.flush()
    for name, found in held.items():
        some = [each for each in found if len(each)]
        if not some:
            print(f"{name}: determined on none of {len(found)} pulls")
            continue
        every, worst = np.concatenate(some), min(each.mean() for each in some)
        said = f"{every.mean():.0%} of {len(every)} intervals hold, on {len(some)} of {len(found)} pulls"
        print(f"{name}: {said}, {worst:.0%} in the worst")
    return 0


if __name__ == "__main__":
    run_door(main)
