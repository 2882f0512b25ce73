"""Synthetic clips whose tissue is a slab of finite elements: what estimates mean where no estimator's model is true.

A sheet of springs is fitted to pictures of neo-Hookean solids that are pressed, or held and pulled. Its k_s, k_d and F
are in units of its own, so that ranks are compared, and factors that one common constant doesn't explain. Where
`direct` fits finite elements instead, told how thick the tissue is, k_s stands for E and k_d for αρ:

quantity                                    of
estimated, explained                        share of the clips with an estimate, and of these whose model check passes
rank of k_s and E, F and F                  Spearman's, over clips
rank of F/k_s and F/E                       the combination that a dent's depth, or a pull, tells
rank of k_s if F is known and E             of pulls: the true force over that combination
rank of …, determined                       over clips that pass the model check: of k_s and E where k_s is determined,
                                            of a press else of k_d/k_s and αρ/E where that is, of a pull of F/k_s and
                                            F/E, and of k_s if F is known and E; empty where there are fewer than four
scatter of …                                standard deviation of the logarithm of their quotient: 0 is proportional
k_d over αm                                 median; α is the true damping per mass and m the fitted mass of a node, of
                                            finite elements the density
k_d/k_s within 25 %                         of αρ/E, of sheets up to one constant, the clips' median; damping by mass
                                            alone
E, F, αρ/E, F/E: over the true, held        of finite elements: median of the quotient, and share within the 90 %
                                            interval
E with an inclusion                         median k_s/E with a stiff ball inside over that without
relative force, off and held                a pull's force over that of the last frame: root mean square error, and
                                            share within the 90 % interval

Pulls are asked of the estimator `direct`, which alone fits grips.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from data.synthetic.clip import draw_truth, synthetic_clip
from data.synthetic.scene import Scene, SceneError
from data.synthetic.slab import GrippedSlab, PressedSlab, SlabMotion, SlabTissue
from data.synthetic.source import open_synthetic
from estimators.contract import ClipInfo
from estimators.estimate import COMBINATIONS, NINETY, GripEstimate
from estimators.open import FEM, SHEET, EstimatorOptions
from evaluation.recovery.bounds import MECHANICS
from evaluation.recovery.evaluate import OK, PREPARE, estimated, interactions
from evaluation.recovery.grips import DIRECT, log_interval
from evaluation.recovery.scores import rms
from evaluation.recovery.suites import SLAB_SUITES
from physics.doors import interruptible

COLUMNS = ("estimator", "clips", "quantity", "n", "value")
CLOSE = 0.25
"""A ratio counts as found within this share of the true one."""
LEAST = 4
"""Fewer clips have no rank."""
PRESSED, PULLED = ("determined", "ratios"), "reaction"
"""Verdicts by which a press's k_s, or else its k_d/k_s, and a pull's F/k_s are determined."""
COMPARED = ("status", "reason", "estimate", "covariance", "verdict", "misfit", "warned")
"""Fields of a `Recovery` that a `SlabRecovery` has too."""


@dataclass(frozen=True)
class SlabTask:
    """What one worker does in one go."""

    suite: str
    index: int
    seed: int
    """Seed of the clip."""
    wanted: Mapping[str, EstimatorOptions]
    """Estimators that are to be tried, by name."""


@dataclass(frozen=True)
class SlabRecovery:
    """Truth and estimate of one clip by one estimator; what doesn't exist is not a number."""

    suite: str
    index: int
    estimator: str
    seed: int
    action: str
    """`press` or `grip`."""
    status: str = OK
    """`ok`, or why there is no estimate: `no scene`, `no estimate`, `error`."""
    reason: str = ""
    tissue: np.ndarray | None = None
    """True numbers in the order of `data.synthetic.slab.SlabTissue`, shape [8]."""
    force: float = math.nan
    """Size of the true force: of a press, or of the pull in the last frame that was looked at."""
    estimate: np.ndarray | None = None
    """Of a press: [k_s, k_d, F], shape [3]; of finite elements [E, αρ, F]."""
    covariance: np.ndarray | None = None
    """Of its logarithms, shape [3, 3]."""
    fitted: str = SHEET
    """What was fitted, one of `estimators.open.MODELS`."""
    verdict: str = ""
    misfit: float = math.nan
    warned: bool | None = None
    """Whether it says that the model doesn't explain the motion; None = it never says so."""
    reaction: np.ndarray | None = None
    """Of a pull: F/k_s in the last frame that was looked at [scene units], of finite elements F/E [scene units²], and
    the standard deviation of its logarithm, shape [2]."""
    curve: np.ndarray = field(default_factory=lambda: np.zeros((3, 0)))
    """Of a pull, over that of the last frame: true force, estimated, its standard deviation, shape [3, T]."""

    @property
    def key(self) -> tuple[str, int, str]:
        """What tells it from other results of a run."""
        return self.suite, self.index, self.estimator


def asked(suite: str, index: int, estimators: Mapping[str, EstimatorOptions]) -> list[str]:
    """Which estimators a clip is for: of a pull, the one that fits grips."""
    press = SLAB_SUITES[suite].settings(index).action == "press"
    return [name for name in estimators if press or name == DIRECT]


def evaluate_slab(task: SlabTask) -> list[SlabRecovery]:
    """Results of one clip for every wanted estimator; what goes wrong becomes a result that says so."""
    settings = SLAB_SUITES[task.suite].settings(task.index)
    empty = functools.partial(SlabRecovery, task.suite, task.index, seed=task.seed, action=settings.action)

    def failed(status: str, reason: str) -> list[SlabRecovery]:
        return [empty(name, status=status, reason=reason) for name in task.wanted]

    try:
        scene, motion = draw_truth(settings, task.seed)
    except SceneError as error:
        return failed("no scene", str(error))
    try:
        if not isinstance(motion, SlabMotion):
            raise TypeError(f"{task.suite} draws no slabs.")
        tissue = np.array(dataclasses.astuple(motion.tissue))
        with interruptible():
            clip = open_synthetic(synthetic_clip(scene, motion, task.seed), PREPARE)
            frames, info = list(clip), ClipInfo.of(clip)
    except Exception as error:  # a clip that breaks the preparation is a result, and the others go on
        return failed("error", f"{type(error).__name__}: {error}")
    found = []
    for name, options in task.wanted.items():
        known: dict[str, Any] = {"tissue": tissue}
        if options.model == Path(FEM):
            known["fitted"] = FEM
            options = dataclasses.replace(options, thickness=motion.tissue.thickness)
        if isinstance(motion, PressedSlab):
            said = estimated(options, frames, info, motion.onset_frame)
            known |= {key: said[key] for key in COMPARED if key in said}
            known["force"] = float(np.abs(motion.force).max())
        elif isinstance(motion, GrippedSlab):
            try:
                with interruptible():
                    said = interactions(options, frames, info)
                    grips = [(item.onset, item.grip) for item in said if item.grip is not None]
                    detail = " ".join(item.detail for item in said)
                    known |= _pulled(*grips[0], motion, scene) if grips else {"status": "no estimate", "reason": detail}
            except Exception as error:  # an estimator that breaks on a clip is a result, and the others go on
                known |= {"status": "error", "reason": f"{type(error).__name__}: {error}"}
        found.append(empty(name, **known))
    return found


def _pulled(onset: int, grip: GripEstimate, motion: GrippedSlab, scene: Scene) -> dict[str, Any]:
    """Fields of a `SlabRecovery`: what is estimated of a pull that was seen from a frame on, beside the truth."""
    used = onset + np.rint(grip.times * scene.settings.fps).astype(int)
    true = motion.reaction[used]
    size = float(np.linalg.norm(true[-1]))
    if math.isnan(grip.reaction_over_young):
        unit = scene.spacing / scene.settings.cell[0]
        log, sd = log_interval(
            grip.reaction_over_stiffness, grip.reaction_over_stiffness_low, grip.reaction_over_stiffness_high
        )
    else:
        unit = 1.0
        log, sd = log_interval(grip.reaction_over_young, grip.reaction_over_young_low, grip.reaction_over_young_high)
    return {
        "force": size,
        "reaction": np.array([math.exp(log) * unit, sd]),
        "curve": np.array([true @ true[-1] / size**2, grip.force, grip.force_sd]),
        "verdict": grip.verdict,
        "warned": not grip.explained,
    }


def slab_rows(rows: Sequence[SlabRecovery]) -> list[dict[str, object]]:
    """Rows of `slabs.csv`: one an estimator, group of clips and quantity."""
    found: list[dict[str, object]] = []
    for estimator in dict.fromkeys(row.estimator for row in rows):
        own = [row for row in rows if row.estimator == estimator]
        for name, clips in _groups(own).items():
            for part, chosen in (("", clips), (", explained", [row for row in clips if row.warned is False])):
                quantities = [*_compared(chosen, clips if not part else None), *(_determined(chosen) if part else ())]
                found += [{"estimator": estimator, "clips": name + part, **cells} for cells in quantities]
    return found


def _groups(rows: Sequence[SlabRecovery]) -> dict[str, list[SlabRecovery]]:
    pressed, pulled = ([row for row in rows if row.action == action] for action in ("press", "grip"))
    found = {}
    for name, group in (("pressed", pressed), ("pulled", pulled)):
        told = [row for row in group if row.tissue is not None]
        found[name] = group
        found[f"{name}, damping by mass"] = [row for row in told if not _relaxes(row)]
        found[f"{name}, relaxing"] = [row for row in told if _relaxes(row)]
    return {name: group for name, group in found.items() if group}


def _relaxes(row: SlabRecovery) -> bool:
    return row.tissue is not None and SlabTissue(*row.tissue).branch > 0


def _compared(rows: Sequence[SlabRecovery], all_rows: Sequence[SlabRecovery] | None) -> Iterator[dict[str, object]]:
    """Quantities of some clips; the shares of what is estimated and explained where all of a group are given."""
    told = [row for row in rows if row.estimate is not None or row.reaction is not None]
    if all_rows is not None:
        yield {"quantity": "estimated", "n": len(all_rows), "value": len(told) / len(all_rows)}
        checked = [row for row in told if row.warned is not None]
        if checked:
            passed = sum(row.warned is False for row in checked)
            yield {"quantity": "explained", "n": len(checked), "value": passed / len(checked)}
            known = sum(row.verdict not in ("", "undetermined") for row in told)
            yield {"quantity": "something determined", "n": len(told), "value": known / len(told)}
    if len(told) < LEAST:
        return
    tissue: Any = SlabTissue(*np.transpose([row.tissue for row in told]))  # arrays, shape [n] each
    young, damping = tissue.young, tissue.damping
    force = np.array([row.force for row in told])
    if told[0].reaction is not None:
        found, sd = np.stack([row.reaction for row in told if row.reaction is not None]).T
        yield from _related("F/k_s", found, "F/E", force / young)
        rank = float(spearmanr(force / found, young).statistic)
        yield {"quantity": "rank of k_s if F is known and E", "n": len(told), "value": rank}
        if told[0].fitted == FEM:
            off = np.log(found / (force / young))
            yield {"quantity": "F/E over the true", "n": len(told), "value": float(np.exp(np.median(off)))}
            yield {"quantity": "F/E, held", "n": len(told), "value": float((np.abs(off) <= NINETY * sd).mean())}
        yield from _curves(told)
        return
    stiffness, viscosity, pressed = np.abs([row.estimate for row in told]).T
    yield from _related("k_s", stiffness, "E", young)
    yield from _related("F", pressed, "F", force)
    yield from _related("F/k_s", pressed / stiffness, "F/E", force / young)
    solid = all(row.fitted == FEM for row in told)
    if (damping > 0).all():
        mass = tissue.density if solid else MECHANICS.mass
        yield {"quantity": "k_d over αm", "n": len(told), "value": float(np.median(viscosity / damping / mass))}
        yield from _related("k_d", viscosity, "α", damping)
        yield from _related("k_d/k_s", viscosity / stiffness, "αρ/E", damping * tissue.density / young)
        off = np.log(viscosity / stiffness) - np.log(damping * tissue.density / young)
        close = np.abs(np.expm1(off if solid else off - np.median(off))) <= CLOSE
        yield {"quantity": f"k_d/k_s within {CLOSE:.0%}", "n": len(told), "value": float(close.mean())}
    if solid:
        yield from _absolute(told, young, damping * tissue.density, force)
    stiff = tissue.inclusion != 1
    if stiff.any() and not stiff.all():
        quotient = np.log(stiffness / young)
        value = float(np.exp(np.median(quotient[stiff]) - np.median(quotient[~stiff])))
        yield {"quantity": "k_s/E with an inclusion over without", "n": int(stiff.sum()), "value": value}


def _determined(rows: Sequence[SlabRecovery]) -> Iterator[dict[str, object]]:
    """Ranks of what is determined of some clips: of k_s, or of the ratio that is known although k_s is not."""
    kinds: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        tissue = None if row.tissue is None else SlabTissue(*row.tissue)
        if tissue is not None and row.reaction is not None:
            pair = (float(row.reaction[0]), row.force / tissue.young)
            known = (row.force / pair[0], tissue.young)
            kinds.setdefault("F/k_s and F/E", []).extend([pair] * (row.verdict == PULLED))
            kinds.setdefault("k_s if F is known and E", []).extend([known] * (row.verdict == PULLED))
        elif tissue is not None and row.estimate is not None:
            stiffness, damping, _ = row.estimate
            both = {"k_s and E": (stiffness, tissue.young)}
            if tissue.damping > 0:  # a standard linear solid has none that could be compared
                both["k_d/k_s and αρ/E"] = (damping / stiffness, tissue.damping * tissue.density / tissue.young)
            for (name, pair), verdict in zip(both.items(), PRESSED, strict=False):
                kinds.setdefault(name, []).extend([pair] * (row.verdict == verdict))
    for name, pairs in kinds.items():
        rank = float(spearmanr(*zip(*pairs, strict=True)).statistic) if len(pairs) >= LEAST else math.nan
        yield {"quantity": f"rank of {name}, determined", "n": len(pairs), "value": rank}


def _absolute(
    rows: Sequence[SlabRecovery], young: np.ndarray, viscosity: np.ndarray, force: np.ndarray
) -> Iterator[dict[str, object]]:
    """Quotients with the truth, in its own units, and how often 90 % intervals hold it; truth of shape [n] each."""
    names = {"stiffness": "E", "force": "F", "force_over_stiffness": "F/E"}
    if (viscosity > 0).all():
        names["damping_over_stiffness"] = "αρ/E"
    with np.errstate(divide="ignore"):
        true = np.log([young, viscosity, force]).T
    off = np.log(np.abs([row.estimate for row in rows])) - true
    covariances = np.array([row.covariance for row in rows])
    for combination, name in names.items():
        powers = np.array(COMBINATIONS[combination])
        used = powers != 0  # there may be no damping at all
        found = off[:, used] @ powers[used]
        sd = np.sqrt(np.einsum("i,nij,j->n", powers, covariances, powers))
        yield {"quantity": f"{name} over the true", "n": len(rows), "value": float(np.exp(np.median(found)))}
        yield {"quantity": f"{name}, held", "n": len(rows), "value": float((np.abs(found) <= NINETY * sd).mean())}


def _related(name: str, found: np.ndarray, true_name: str, true: np.ndarray) -> Iterator[dict[str, object]]:
    rank = float(spearmanr(found, true).statistic)
    yield {"quantity": f"rank of {name} and {true_name}", "n": len(found), "value": rank}
    scatter = float(np.log(found / true).std(ddof=1))
    yield {"quantity": f"scatter of {name} over {true_name}", "n": len(found), "value": scatter}


def _curves(rows: Sequence[SlabRecovery]) -> Iterator[dict[str, object]]:
    # The last frame's ratio is 1 by definition.
    true, value, sd = np.concatenate([row.curve[:, :-1] for row in rows], axis=1)
    known = np.isfinite(value)
    off, sd = (value - true)[known], sd[known]
    yield {"quantity": "relative force, off", "n": len(off), "value": rms(off)}
    yield {"quantity": "relative force, held", "n": len(off), "value": float((np.abs(off) <= NINETY * sd).mean())}
