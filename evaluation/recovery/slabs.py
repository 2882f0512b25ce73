"""Synthetic clips whose tissue is a slab of finite elements: what estimates mean where no estimator's model is true.

A sheet of springs is fitted to pictures of neo-Hookean solids that are pressed, or held and pulled. Its k_s, k_d and F
are in units of its own, so that ranks are compared, and factors that one common constant doesn't explain. Where
`direct` fits finite elements instead, given how thick the tissue is, k_s stands for E and k_d for αρ:

quantity                                    of
estimated, explained                        share of the clips with an estimate, and of these whose model check passes
rank of k_s and E, F and F                  Spearman's, over clips
rank of F/k_s and F/E                       the combination that a dent's depth determines
rank of …, determined                       over presses that pass the model check: of k_s and E where k_s is
                                            determined, else of k_d/k_s and αρ/E where that is; empty where there are
                                            fewer than four
scatter of …                                standard deviation of the logarithm of their quotient: 0 is proportional
k_d over αm                                 median; α is the true damping per mass and m the fitted mass of a node, of
                                            finite elements the density
k_d/k_s within 25 %                         of αρ/E, of sheets up to one constant, the clips' median; damping by mass
                                            alone
E, F, αρ/E, F/E: over the true, held        of finite elements: median of the quotient, and share within the 90 %
                                            interval
relative force, off and held                a pull's force over that of the last frame: root mean square error, and
                                            share within the 90 % interval

Pulls are asked of the estimator `direct`, which alone fits grips.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

from palpate.data.synthetic.slab import SlabTissue
from palpate.estimators.estimate import COMBINATIONS, NINETY
from palpate.estimators.open import FEM
from palpate.evaluation.harness import Row
from palpate.evaluation.recovery.bounds import MECHANICS
from palpate.evaluation.recovery.grips import curve_errors
from palpate.evaluation.recovery.scores import coverage, rms

Quantity = tuple[str, int, float]
"""Its name, of how many it is, and its value."""
COLUMNS = ("suite", "estimator", "clips", "quantity", "n", "value")
CLOSE = 0.25
"""A ratio counts as found within this share of the true one."""
LEAST = 4
"""Fewer clips have no rank."""
PRESSED = "determined", "ratios"
"""Verdicts by which a press's k_s, or else its k_d/k_s, is determined."""


def slab_table(rows: Sequence[Row]) -> pd.DataFrame:
    """`slabs.csv`: a row a suite, estimator, group of clips and quantity."""
    found: list[Row] = []
    for suite, estimator in dict.fromkeys((row["suite"], row["estimator"]) for row in rows):
        own = [row for row in rows if (row["suite"], row["estimator"]) == (suite, estimator)]
        for name, clips in _groups(own).items():
            explained = [row for row in clips if row.get("warned") is False]
            quantities = {name: [*_shares(clips), *_compared(clips)]}
            quantities[f"{name}, explained"] = [*_compared(explained), *_determined(explained)]
            found += [
                dict(zip(COLUMNS, (suite, estimator, of, quantity, n, float(value)), strict=True))
                for of, cells in quantities.items()
                for quantity, n, value in cells
            ]
    return pd.DataFrame(found, columns=COLUMNS)


def _groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    found = {}
    for name, action in (("pressed", "press"), ("pulled", "grip")):
        found[name] = [row for row in rows if row["action"] == action]
        drawn = [row for row in found[name] if "tissue" in row]
        found[f"{name}, damping by mass"] = [row for row in drawn if not SlabTissue(*row["tissue"]).branch > 0]
        found[f"{name}, relaxing"] = [row for row in drawn if SlabTissue(*row["tissue"]).branch > 0]
    return {name: group for name, group in found.items() if group}


def _estimated(rows: Sequence[Row]) -> list[Row]:
    """Those with an estimate."""
    return [row for row in rows if "estimate" in row or "curve" in row]


def _shares(rows: Sequence[Row]) -> Iterator[Quantity]:
    """Of all clips of a group: what is estimated, explained and determined."""
    estimated = _estimated(rows)
    yield "estimated", len(rows), len(estimated) / len(rows)
    checked = [row["warned"] for row in estimated if "warned" in row]
    if checked:
        yield "explained", len(checked), checked.count(False) / len(checked)
        known = sum(row.get("verdict", "") not in ("", "undetermined") for row in estimated)
        yield "something determined", len(estimated), known / len(estimated)


def _compared(rows: Sequence[Row]) -> Iterator[Quantity]:
    """Quantities of those that have an estimate."""
    estimated = _estimated(rows)
    count = len(estimated)
    if count < LEAST:
        return
    if "curve" in estimated[0]:
        off, sd = curve_errors([row["curve"] for row in estimated])
        yield "relative force, off", len(off), rms(off)
        yield "relative force, held", len(off), coverage(off, sd)
        return
    tissue: Any = SlabTissue(*np.transpose([row["tissue"] for row in estimated]))  # arrays, shape [n] each
    young, damping = tissue.young, tissue.damping
    force = np.array([row["true_force"] for row in estimated])
    solid = all(row.get("fitted") == FEM for row in estimated)
    stiffness, viscosity, pressed = np.abs([row["estimate"] for row in estimated]).T
    yield from _related("k_s", stiffness, "E", young)
    yield from _related("F", pressed, "F", force)
    yield from _related("F/k_s", pressed / stiffness, "F/E", force / young)
    by_mass = bool((damping > 0).all())
    if by_mass:
        mass = tissue.density if solid else MECHANICS.mass
        yield "k_d over αm", count, np.median(viscosity / damping / mass)
        yield from _related("k_d/k_s", viscosity / stiffness, "αρ/E", damping * tissue.density / young)
        off = np.log(viscosity / stiffness) - np.log(damping * tissue.density / young)
        close = np.abs(np.expm1(off if solid else off - np.median(off))) <= CLOSE
        yield f"k_d/k_s within {CLOSE:.0%}", count, close.mean()
    if solid:
        # In the truth's own units; there may be no damping at all.
        with np.errstate(divide="ignore"):
            off = np.log([stiffness, viscosity, pressed]).T - np.log([young, damping * tissue.density, force]).T
        covariances = np.array([row["covariance"] for row in estimated])
        names = {"stiffness": "E", "force": "F", "force_over_stiffness": "F/E"}
        for combination, name in (names | ({"damping_over_stiffness": "αρ/E"} if by_mass else {})).items():
            powers = np.array(COMBINATIONS[combination])
            sd = np.sqrt(np.einsum("i,nij,j->n", powers, covariances, powers))
            yield from _over_true(name, off[:, powers != 0] @ powers[powers != 0], sd)


def _determined(rows: Sequence[Row]) -> Iterator[Quantity]:
    """Ranks of what is determined of some clips: of k_s, or of the ratio that is known although k_s is not."""
    kinds: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        if "estimate" not in row:
            continue
        tissue, (stiffness, damping, _) = SlabTissue(*row["tissue"]), row["estimate"]
        pairs = {"k_s and E": (stiffness, tissue.young, row["verdict"] == PRESSED[0])}
        if tissue.damping > 0:  # a standard linear solid has none that could be compared
            true = tissue.damping * tissue.density / tissue.young
            pairs["k_d/k_s and αρ/E"] = damping / stiffness, true, row["verdict"] == PRESSED[1]
        for name, (found, true, sure) in pairs.items():
            kinds.setdefault(name, []).extend([(found, true)] * sure)
    for name, pairs in kinds.items():
        rank = spearmanr(*zip(*pairs, strict=True)).statistic if len(pairs) >= LEAST else math.nan
        yield f"rank of {name}, determined", len(pairs), rank


def _over_true(name: str, off: np.ndarray, sd: np.ndarray) -> Iterator[Quantity]:
    """Quotient with the truth, of its logarithms [n], and how often 90 % intervals hold it."""
    yield f"{name} over the true", len(off), np.exp(np.median(off))
    yield f"{name}, held", len(off), (np.abs(off) <= NINETY * sd).mean()


def _related(name: str, found: np.ndarray, true_name: str, true: np.ndarray) -> Iterator[Quantity]:
    yield f"rank of {name} and {true_name}", len(found), spearmanr(found, true).statistic
    yield f"scatter of {name} over {true_name}", len(found), np.log(found / true).std(ddof=1)
