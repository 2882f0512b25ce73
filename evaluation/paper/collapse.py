"""Does the estimate follow the frames, or has it collapsed to a constant?

Bini 2026 reports k_s = 0.508 ± 0.003 on a range of [0, 1] whose middle is where an untrained sigmoid sits: a spread of
0.3 % of the range. A constant predictor has a spread of 0 and, if well chosen, a good error too. So the check asks two
things: how far the estimates spread, and whether they explain the observed motion better than constants do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from evaluation.paper.statistics import MINIMUM_FOR_WILCOXON, Comparison, judge, relative_size
from physics.mechanics import PARAMETERS, Bounds

MINIMUM_SPREAD = 0.02
"""Below this SD as a fraction of the admissible range a parameter counts as constant, unless SD/|mean| is large."""
MINIMUM_VARIATION = 0.2
"""SD/|mean| from which on a parameter counts as varying even on a range that is far too wide for the scene."""
AT_BOUND = 0.01
"""A value closer than this fraction of the range to an end counts as lying at the bound."""
MINIMUM_FRAMES = 3

Verdict = Literal["collapsed", "partly collapsed", "varies", "undetermined"]


@dataclass(frozen=True)
class ParameterSpread:
    """How one parameter spreads over the test frames; force as a magnitude, unless its range crosses 0."""

    name: str
    mean: float
    sd: float | None
    """Sample SD over all frames; a constant predictor has 0."""
    minimum: float
    maximum: float
    low: float
    high: float
    """Admissible range."""
    spread: float | None
    """SD as a fraction of the admissible range."""
    variation: float | None
    """SD/|mean|."""
    between_clips_sd: float | None
    """SD of the clips' means; None for a single clip."""
    within_clips_sd: float | None
    """SD around the own clip's mean; None when no clip has two frames."""
    at_bound: float
    """Fraction of the frames at an end of the admissible range."""
    collapsed: bool | None
    """None where there are too few frames to say."""

    @property
    def verdict(self) -> str:
        """In a word; empty where there are too few frames to say."""
        return "" if self.collapsed is None else "constant" if self.collapsed else "varies"


@dataclass(frozen=True)
class CollapseCheck:
    """Spread of all three parameters and the verdict."""

    frames: int
    clips: int
    parameters: tuple[ParameterSpread, ...]
    verdict: Verdict
    sentence: str


def _deviation(values: np.ndarray, freedom: int) -> float | None:
    return float(np.sqrt(np.square(values).sum() / freedom)) if freedom > 0 else None


def _spread(name: str, values: np.ndarray, clips: np.ndarray, low: float, high: float) -> ParameterSpread:
    """Spread of one parameter's values [n] over the clips [n]."""
    names, block = np.unique(clips, return_inverse=True)
    means = np.bincount(block, weights=values) / np.bincount(block)
    mean, width = float(values.mean()), high - low
    sd = _deviation(values - mean, len(values) - 1)
    spread = None if sd is None else sd / width
    variation = None if sd is None or mean == 0 else sd / abs(mean)
    collapsed = None
    if len(values) >= MINIMUM_FRAMES and spread is not None:
        collapsed = spread < MINIMUM_SPREAD and (variation or 0.0) < MINIMUM_VARIATION
    return ParameterSpread(
        name=name,
        mean=mean,
        sd=sd,
        minimum=float(values.min()),
        maximum=float(values.max()),
        low=low,
        high=high,
        spread=spread,
        variation=variation,
        between_clips_sd=_deviation(means - means.mean(), len(names) - 1),
        within_clips_sd=_deviation(values - means[block], len(values) - len(names)),
        at_bound=float(np.mean((values - low < AT_BOUND * width) | (high - values < AT_BOUND * width))),
        collapsed=collapsed,
    )


def check_collapse(theta: np.ndarray, clips: np.ndarray, bounds: Bounds) -> CollapseCheck:
    """Judge the spread of θ [n, 3] over the test frames of the clips [n] against the admissible box.

    Raises:
        ValueError: no frames, or θ isn't of shape [n, 3].
    """
    theta = np.asarray(theta, dtype=float)
    if theta.ndim != 2 or theta.shape[1] != 3 or not len(theta):
        raise ValueError(f"the collapse check needs θ of shape [n, 3] with n of at least 1, got {theta.shape}.")
    clips = np.asarray(clips)
    lower, upper = np.array(bounds.lower), np.array(bounds.upper)
    if upper[2] <= 0:
        theta, lower[2], upper[2] = theta * (1, 1, -1), abs(upper[2]), -lower[2]
    spreads = tuple(
        _spread(name, theta[:, column], clips, float(lower[column]), float(upper[column]))
        for column, name in enumerate(PARAMETERS)
    )
    collapsed = [spread.name for spread in spreads if spread.collapsed]
    widths = ", ".join(f"{spread.name} {_percent(spread.spread)}" for spread in spreads)
    tail = f"SD over {len(theta)} test frames in % of the admissible range: {widths}; a constant predictor has 0"
    verdict: Verdict
    if any(spread.collapsed is None for spread in spreads):
        verdict = "undetermined"
        sentence = f"Undetermined: n too small ({len(theta)} test frames, {MINIMUM_FRAMES} needed)."
    elif len(collapsed) == len(spreads):
        verdict = "collapsed"
        sentence = f"Collapsed: all three estimates are practically constant ({tail})."
    elif collapsed:
        verdict = "partly collapsed"
        verb = "is" if len(collapsed) == 1 else "are"
        sentence = f"Partly collapsed: {' and '.join(collapsed)} {verb} practically constant ({tail})."
    else:
        verdict = "varies"
        sentence = f"Varies: all three estimates vary over the frames ({tail})."
    return CollapseCheck(len(theta), len(np.unique(clips)), spreads, verdict, sentence)


def _percent(value: float | None) -> str:
    return "n too small" if value is None else f"{100 * value:.2g} %"


def describe(comparison: Comparison, regime: str, baseline: str) -> str:
    """One sentence on a paired comparison, the clip-level interval included."""
    if comparison.mean_difference is None:
        return f"{regime} can't be compared with {baseline}: no pair of finite errors."
    change = comparison.relative_change_percent
    amount = "the same as" if not comparison.mean_difference else (
        relative_size(change) if change is not None else "different from"
    )  # fmt: skip
    verdict = judge(comparison)
    if verdict == "untested":
        reason = comparison.notes.get("wilcoxon_w", "n too small")
        return f"{regime} has a mean error {amount} that of {baseline}; not tested: {reason}."
    p_value = f"{comparison.wilcoxon_p:.2g}".replace("-", "−")
    clips = f"{comparison.clips} clip{'' if comparison.clips == 1 else 's'}"
    test = f"Wilcoxon p = {p_value}, n = {comparison.n} frames of {clips}"
    text = f"{regime} has a mean error {amount} that of {baseline} ({test}): {verdict}"
    interval = comparison.difference_clip_interval
    if interval is None:
        note = comparison.notes.get("difference_clip_interval", "n too small")
        return f"{text}, frames taken as independent; clip-level interval: {note}."
    crosses = interval[0] <= 0 <= interval[1]
    return f"{text}; the clip-level interval of the difference {'includes' if crosses else 'excludes'} 0."


def conclude(check: CollapseCheck, constant: Comparison | None, reference: Comparison, contacts: int) -> str:
    """The evaluation's one-sentence conclusion, from the spread and from the two baselines.

    Args:
        contacts: different observed motions behind the test frames. Frames of one contact share their observation, so
            many frames of a few contacts prove no more than these contacts.
    """
    if constant is None:
        return f"No conclusion: the comparison with a fitted constant θ is missing. {check.sentence}"
    against_constant, against_reference = judge(constant), judge(reference)
    if against_constant == "untested":
        return f"No conclusion: n is too small to compare with the fitted constant θ. {check.sentence}"
    if against_constant == "better" and contacts < MINIMUM_FOR_WILCOXON:
        shown = f"{contacts} observed contact{'' if contacts == 1 else 's'}, {MINIMUM_FOR_WILCOXON} needed"
        return (
            "No conclusion: the estimates have a lower error than the constant θ fitted on the training contacts, but "
            f"the test frames show too few contacts to test it ({shown}). {check.sentence}"
        )
    if against_constant == "better":
        lead = "The estimates beat the constant θ fitted on the training contacts"
        interval = constant.difference_clip_interval
        if interval is None:
            lead += ", with frames taken as independent"
        elif interval[0] <= 0:
            lead += ", with frames taken as independent, though not when whole clips are resampled"
        if check.verdict not in ("varies", "partly collapsed"):
            lead += ", yet they hardly vary"
        return f"{lead}. {check.sentence}"
    lead = "No success: the estimates do not beat the constant θ fitted on the training contacts"
    if against_reference == "better":
        lead += "; they beat only the literature constants, and that is not success"
    return f"{lead}. {check.sentence}"
