"""Does the estimate follow the frames, or has it collapsed to a constant?

Bini 2026 reports k_s = 0.508 ± 0.003 on a range of [0, 1] whose middle is where an untrained sigmoid sits: a spread of
0.3 % of the range. A constant predictor has a spread of 0 and, if well chosen, a good error too. So the check has two
questions: how far the estimates spread, and whether they explain the observed motion better than constants do.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from palpate.evaluation.paper.statistics import MINIMUM_FOR_WILCOXON, SIGNIFICANCE, Statistics, format_number, judge
from palpate.physics.mechanics import PARAMETERS, Bounds

MINIMUM_SPREAD = 0.02
"""Below this SD as a fraction of the admissible range a parameter counts as constant, unless SD/|mean| is large."""
MINIMUM_VARIATION = 0.2
"""SD/|mean| from which on a parameter counts as varying even on a range that is far too wide for the scene."""
AT_BOUND = 0.01
"""A value closer than this fraction of the range to an end counts as lying at the bound."""
MINIMUM_CONTACTS = 3
"""Fewest different motions for a verdict: fewer may well have the same θ."""


def as_reported(theta: np.ndarray, bounds: Bounds) -> np.ndarray:
    """θ [..., 3] with the force as a magnitude, unless its range crosses 0."""
    return np.abs(theta) if bounds.force[1] <= 0 else theta


def spread_of(frames: pd.DataFrame, bounds: Bounds, contacts: int) -> pd.DataFrame:
    """Spread of the parameters, as reported, over the test frames in the admissible box.

    Args:
        frames: one row a test frame with its `clip` and parameters.
        bounds: the box.
        contacts: number of different observed motions behind the frames.

    Returns:
        One row a parameter. `sd` is the sample SD over all frames, of which a constant predictor has 0; `low` and
        `high` are the admissible range, `sd_of_range` and `sd_of_mean` the SD as a fraction of it and of |mean|,
        `between_clips_sd` the SD of the clips' means, `within_clips_sd` that around the own clip's mean, `at_bound` the
        fraction of frames at an end of the range.
    """
    low, high = np.sort(as_reported(np.array([bounds.lower, bounds.upper]), bounds), axis=0)
    values = frames[list(PARAMETERS)]
    by_clip, width = values.groupby(frames["clip"]), high - low
    spread = values.agg(["mean", "std", "min", "max"]).T.set_axis(["mean", "sd", "minimum", "maximum"], axis="columns")
    within = np.square(values - by_clip.transform("mean")).sum() / (len(values) - by_clip.ngroups)
    spread = spread.assign(
        low=low,
        high=high,
        sd_of_range=spread["sd"] / width,
        sd_of_mean=spread["sd"] / spread["mean"].abs(),
        between_clips_sd=by_clip.mean().std(),
        within_clips_sd=np.sqrt(within),
        at_bound=((values - low < AT_BOUND * width) | (high - values < AT_BOUND * width)).mean(),
    )
    constant = (spread["sd_of_range"] < MINIMUM_SPREAD) & ~(spread["sd_of_mean"] >= MINIMUM_VARIATION)
    few = contacts < MINIMUM_CONTACTS
    return spread.assign(verdict="n too small" if few else np.where(constant, "constant", "varies"))


def describe_spread(spread: pd.DataFrame) -> str:
    """The verdict on the spread of all three parameters, in one sentence."""
    widths = ", ".join(f"{name} {format_number(100 * share)} %" for name, share in spread["sd_of_range"].items())
    grounds = f"(SD in % of the admissible range: {widths}; a constant predictor has 0)."
    if (spread["verdict"] == "n too small").any():
        return f"Undetermined, n too small: whether the estimates vary or have collapsed to a constant {grounds}"
    constant = spread.index[spread["verdict"] == "constant"]
    verdict = ("Varies", "Partly collapsed", "Partly collapsed", "Collapsed")[len(constant)]
    return f"{verdict}; practically constant over the test frames: {' and '.join(constant) or 'none'} {grounds}"


def conclude(spread: pd.DataFrame, constant: Statistics, reference: Statistics) -> str:
    """The evaluation's conclusion, from the spread and from the comparisons with two baselines.

    Args:
        spread: from `spread_of`.
        constant, reference: comparisons with the constant θ and with the literature constants.
    """
    verdict = judge(constant)
    clips, rival = int(constant["clips"].value), "the constant θ fitted on the training contacts"
    if not clips:
        lead = f"No conclusion: on no test frame can the estimates be compared with {rival}"
    elif clips < MINIMUM_FOR_WILCOXON:
        lead = (
            f"{'One clip' if clips == 1 else f'{clips} clips'}: too few to judge whether the estimates beat {rival}. "
            f"With fewer than {MINIMUM_FOR_WILCOXON} clips no two-sided signed-rank test over clips can fall below "
            f"p = {SIGNIFICANCE:g}, and frames of one clip are not independent"
        )
    elif verdict == "too few to judge":
        lead = f"Too few frames to judge whether the estimates beat {rival}: {constant['wilcoxon_w']}"
    elif verdict == "better":
        lead = f"The estimates beat {rival}"
        if not constant["difference_clip_interval"].low > 0:
            lead += ", with frames taken as independent; resampled clips do not confirm it"
    else:
        lead = f"No success: the estimates do not beat {rival}"
        if judge(reference) == "better":
            lead += "; they beat only the literature constants, and that is not success"
    return f"{lead}. {describe_spread(spread)}"
