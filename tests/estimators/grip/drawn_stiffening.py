"""Whether drawn sheets that stiffen, and such as don't, are distinguished by how their motion spreads.

    python -m tests.estimators.grip.drawn_stiffening --seed 601 --clips 6

Every clip is drawn, prepared and estimated as in the recovery's suites of grips. A sheet stiffens by the tension
k (exp(b e) - 1)/b of its springs, e their elongation over their length. Its pull is straight, so that all of it moves
along that and one line from the grip outwards tells how far (finite volumes, at rest in every frame).
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from unittest import mock

import numpy as np
from scipy.linalg import solve_banded

from palpate.common.options import options, require_within
from palpate.data.synthetic import grip
from palpate.data.synthetic.clip import draw_truth, synthetic_clip
from palpate.data.synthetic.scene import Scene, SceneError
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.data.tracks.following import SPACING
from palpate.estimators.contract import ClipInfo
from palpate.estimators.estimate import NINETY
from palpate.estimators.grip.recorder import GripRecorder
from palpate.estimators.open import EstimatorOptions, open_estimator
from palpate.estimators.records import InteractionEstimate
from palpate.estimators.session import estimates_of
from palpate.evaluation.recovery.grip_truth import log_of
from palpate.evaluation.recovery.suites import EVERY

LINEAR = "retraction", "foundation", "breathing", "creep", "regions"
"""Suites of sheets that don't stiffen."""
STRAIGHT = 0, 2, 5, 10, 30
"""b of straight pulls on sheets of the suite foundation."""
KINDS = (*(f"b {b}" for b in STRAIGHT), *LINEAR)
CELL, FAR = 0.25, 300.0
"""Of the line from the grip outwards: a cell, and where it ends [grid px]."""
MOST_STEPS, PRECISE = 1000, 1e-9
"""Of Newton's method: at most, and the last step [grid px]."""


@dataclass(frozen=True)
class Options:
    """Of the command."""

    seed: int = 601
    """Of the first clip; each further one takes the next."""
    clips: int = 6
    """Of each kind."""
    only: str = ""
    """Names of kinds with commas between them; all where it is left out."""

    def __post_init__(self) -> None:
        require_within(self, seed=(0, 2**31), clips=(1, 1000))


def begun(pull: float, b: float) -> np.ndarray:
    """Where `line_of` may begin: no steeper than what the law lets grow by e⁵, shape [N] [grid px]."""
    return pull * np.maximum(1 - CELL * (np.arange(int(FAR / CELL)) + 0.5) / max(20.0, pull * b / 5), 0.0)


def line_of(pull: float, anchor: float, b: float) -> tuple[np.ndarray, float]:
    """Displacement along a line from the grip's edge outwards, shape [N], and the force that holds the grip.

    Args:
        pull: displacement of the grip, 0 or more [grid px].
        anchor: foundation of a node over the stiffness of a spring.
        b: of the law; 0 = linear.
    """
    moved = begun(pull, b)
    edges = grip.GRIP_RADIUS + CELL * np.arange(len(moved))
    middles = edges + CELL / 2

    def law(slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rise = np.exp(np.minimum(b * np.abs(slope), 200.0))
        return 3 * (np.sign(slope) * (rise - 1) / b if b else slope), 3 * rise

    def energy(at: np.ndarray) -> float:
        slope = np.abs(np.diff(at, prepend=pull, append=0.0)) / CELL
        slope[0] *= 2
        bent = (np.expm1(np.minimum(b * slope, 200.0)) - b * slope) / b**2 if b else slope**2 / 2
        share = np.append(0.5, np.ones(len(at)))
        return float(
            (3 * bent * share * np.append(edges, edges[-1] + CELL)).sum() + anchor * (middles * at**2).sum() / 2
        )

    for _ in range(MOST_STEPS):
        slope = np.diff(moved, prepend=pull, append=0.0) / CELL
        slope[0] *= 2
        tension, stiff = law(slope)
        around = np.append(edges, edges[-1] + CELL)
        off = -np.diff(around * tension) / CELL + anchor * middles * moved
        stiff = around * stiff / CELL**2
        stiff[0] *= 2
        bands = np.zeros((3, len(moved)))
        bands[1] = stiff[:-1] + stiff[1:] + anchor * middles
        bands[0, 1:] = bands[2, :-1] = -stiff[1:-1]
        step, share, before = solve_banded((1, 1), bands, off), 1.0, energy(moved)
        while energy(moved - share * step) > before + 1e-12 * abs(before) and share > 1e-4:
            share /= 2
        moved = moved - share * step
        if np.abs(step).max() < PRECISE:
            break
    else:
        raise RuntimeError("the line doesn't come to rest")
    within = math.pi * grip.GRIP_RADIUS**2 * anchor * pull
    return moved, float(-2 * math.pi * edges[0] * tension[0] + within)


def straight(b: float) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """What takes the place of `grip._integrate`, of a sheet that stiffens by b."""

    def integrate(
        scene: Scene, log_stiffness: np.ndarray, anchor: float, relaxation: float, path: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        targets = np.vstack([np.zeros(2), path[grip.SUBSTEPS - 1 :: grip.SUBSTEPS]])
        pulls, along = np.linalg.norm(targets, axis=1), path[-1] / np.linalg.norm(path[-1])
        row, column = scene.mesh.pixels[scene.vertex]
        down, right = np.indices(scene.mesh.grid_shape)
        apart = np.hypot(down - row, right - column)
        places = grip.GRIP_RADIUS + CELL * np.append(0, np.arange(int(FAR / CELL)) + 0.5)
        moved, held = [], []
        for pull in pulls:
            line, force = line_of(float(pull), anchor, b)
            moved.append(np.interp(apart, places, np.append(pull, line))[..., None] * along)
            held.append(force * along)
        return np.array(moved), np.array(held)

    return integrate


def drawn(kind: str, seed: int) -> tuple[Scene, grip.GrippedMotion, list[InteractionEstimate]]:
    """A clip's scene, its true motion, and what the estimator `direct` says of its runs of contact."""
    bent = kind not in LINEAR
    settings = EVERY["foundation" if bent else kind].settings(0)
    integrate = straight(float(kind.removeprefix("b "))) if bent else grip._integrate
    bend = 0.0 if bent else grip.LARGEST_BEND
    with mock.patch.multiple(grip, _integrate=integrate, LARGEST_BEND=bend):
        scene, motion = draw_truth(settings, seed)
    assert isinstance(motion, grip.GrippedMotion)
    source = open_synthetic(synthetic_clip(scene, motion, seed), PREPARE)
    session = open_estimator(EstimatorOptions("direct", threads=1)).start(ClipInfo.of(source))
    # Where tissue is stiffer is not asked, and costs most.
    with mock.patch.object(GripRecorder, "_stiffness", return_value=None):
        answer = list(estimates_of(session, source))
    return scene, motion, [item for item in answer if isinstance(item, InteractionEstimate)]


def described(scene: Scene, motion: grip.GrippedMotion, run: InteractionEstimate) -> tuple[str, bool]:
    """A run of contact with its grip in words, and whether it says that stiffening isn't determined."""
    if run.grip is None:
        return f"no grip: {run.detail}", False
    found, cell = run.grip, np.array(scene.settings.cell)
    used = run.onset + np.rint(found.times * scene.settings.fps).astype(int)
    force = motion.reaction[used] / scene.spacing * cell
    true = {
        "foundation_over_stiffness": motion.anchor * SPACING**2 / cell.prod(),
        "reaction_over_stiffness": float(np.linalg.norm(force[-1])),
    }
    said = [f"widens {found.widens:+.1f}, {'' if found.explained else 'not '}explained: {found.verdict}"]
    if found.sheet is None:
        said.append("no sheet")
    for name, value in true.items():
        log, sd = log_of(found, name)
        held = "held" if abs(log - math.log(value)) < NINETY * sd else "MISSED"
        said.append(f"{name} off by {math.exp(log) / value - 1:+.0%}, sd {sd:.2g}, {held}")
    off = np.abs(force @ force[-1] / (force[-1] @ force[-1]) - found.force)
    said.append(f"course of the force off by up to {off.max():.2f}, sd {found.force_sd.max():.2f}")
    return ", ".join(said), found.explanation.startswith("stiffening, not determined")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line of each clip, and how many of each kind are said to spread farther; returns the exit status."""
    chosen: Options = options(Options, arguments, "tests.estimators.grip.drawn_stiffening", __doc__)
    called: dict[str, list[bool]] = {}
    for seed in range(chosen.seed, chosen.seed + chosen.clips):
        for kind in chosen.only.split(",") if chosen.only else KINDS:
            begun_s = time.perf_counter()
            try:
                scene, motion, runs = drawn(kind, seed)
            except SceneError as error:
                print(f"{kind}, seed {seed}: nothing drawn, {error}")
                continue
            for run in runs:
                words, stiffens = described(scene, motion, run)
                called.setdefault(kind, []).append(stiffens)
                print(f"{kind}, seed {seed}, {time.perf_counter() - begun_s:.0f} s: {words}", flush=True)
    for kind, said in called.items():
        print(f"{kind}: {sum(said)} of {len(said)} say that stiffening isn't determined")
    return 0


if __name__ == "__main__":
    run_door(main)
