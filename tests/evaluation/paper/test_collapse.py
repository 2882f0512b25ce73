"""The collapse check on estimates that vary, that don't, and that are too few."""

import numpy as np
import pandas as pd
import pytest

from palpate.evaluation.paper.statistics import as_reported, compare, conclude, describe_spread, spread_of
from palpate.physics.mechanics import PARAMETERS, Bounds

BOUNDS = Bounds()
SIGNED = Bounds(force=(-10, 10))


def _theta(spread, seed=0):
    noise = np.random.default_rng(seed).normal(size=(100, 3))
    noise = (noise - noise.mean(axis=0)) / noise.std(axis=0, ddof=1)
    return np.array([0.508, 0.09, -7.79]) + noise * spread


def _spread(theta, bounds=BOUNDS, contacts=100):
    return spread_of(pd.DataFrame(as_reported(theta, bounds), columns=list(PARAMETERS)), bounds, contacts)


VARIES = _spread(_theta([0.1, 0.03, 1.0]))


def test_the_papers_own_estimates_count_as_collapsed():
    spread = _spread(_theta([0.0027, 0.0162, 0.1841]))
    assert spread["verdict"].tolist() == ["constant"] * 3
    assert spread.loc["stiffness", "sd"] == pytest.approx(0.0027)
    assert spread.loc["stiffness", "sd_of_range"] == pytest.approx(0.0027)
    assert spread.loc["damping", "sd_of_mean"] == pytest.approx(0.18)
    assert spread.loc["force", "sd_of_range"] == pytest.approx(0.01841)
    sentence = describe_spread(spread)
    assert sentence.startswith("Collapsed; practically constant over the test frames: stiffness and damping and force")
    assert "stiffness 0.27 %" in sentence


def test_estimates_that_vary_all_or_in_part():
    assert VARIES["verdict"].tolist() == ["varies"] * 3
    assert describe_spread(VARIES).startswith("Varies; practically constant over the test frames: none (SD")
    sentence = describe_spread(_spread(_theta([0.001, 0.03, 1.0])))
    assert sentence.startswith("Partly collapsed; practically constant over the test frames: stiffness (SD")


def test_a_box_far_too_wide_does_not_make_a_varying_estimate_a_constant():
    # F between −0.03 and −0.09 on a range of [−10, 0]: 0.2 % of the range, but a third of the mean.
    theta = _theta([0.1, 0.03, 0.0])
    theta[:, 2] = -np.linspace(0.03, 0.09, 100)
    assert _spread(theta).loc["force", "verdict"] == "varies"


def test_force_is_a_magnitude_unless_its_range_crosses_zero():
    force = VARIES.loc["force"]
    assert (force["low"], force["high"]) == (0, 10)
    assert force["mean"] == pytest.approx(7.79)
    assert _spread(_theta([0.1, 0.03, 1.0]), bounds=SIGNED).loc["force", "mean"] == pytest.approx(-7.79)


def test_values_at_the_bounds_are_counted():
    theta = np.tile([0.5, 0.1, -5.0], (4, 1))
    theta[:, 1] = [0.0, 0.005, 0.5, 1.0]
    assert _spread(theta).loc["damping", "at_bound"] == 0.75


def test_frames_of_too_few_contacts_are_undetermined():
    """One contact has one θ, however many frames show it."""
    spread = _spread(_theta([0.001, 0.001, 0.01]), contacts=2)
    assert spread["verdict"].tolist() == ["n too small"] * 3
    assert describe_spread(spread).startswith("Undetermined, n too small")
    assert np.isnan(_spread(_theta([0.1, 0.1, 1])[:1], contacts=1).loc["stiffness", "sd"])


def _compare(shift, clips=None):
    noise = np.random.default_rng(0).normal(0, 0.1, 100)
    return compare(np.ones(100), 1 + shift + noise, np.repeat(list("abcdefghij"), 10) if clips is None else clips)


CONSTANT = _spread(_theta([0.001, 0.001, 0.01]))
BETTER, WORSE = _compare(0.5), _compare(-0.5)
BEAT = "The estimates beat the constant θ fitted on the training contacts"


@pytest.mark.parametrize(
    ("spread", "constant", "start"),
    [
        (VARIES, BETTER, f"{BEAT}. Varies"),
        (CONSTANT, BETTER, f"{BEAT}. Collapsed"),
        (VARIES, WORSE, "No success: the estimates do not beat the constant θ"),
        (VARIES, compare(np.ones(2), np.ones(2), np.zeros(2)), "One clip: too few to judge whether the estimates beat"),
        (VARIES, compare(np.ones(9), np.ones(9), np.arange(9)), "Too few frames to judge whether the estimates beat"),
        (VARIES, compare(np.ones(9), np.full(9, np.nan), np.zeros(9)), "No conclusion: on no test frame"),
    ],
)
def test_conclusions(spread, constant, start):
    assert conclude(spread, constant, BETTER).startswith(start)


def test_beating_only_the_literature_is_not_success():
    text = "they beat only the literature constants, and that is not success"
    assert text in conclude(VARIES, WORSE, BETTER)
    assert "literature" not in conclude(VARIES, WORSE, WORSE)


def test_success_on_frames_but_not_on_clips_is_said():
    # One clip in eight carries the whole gain: frames alone call it better, resampled clips don't.
    clips = np.repeat(list("abcdefgh"), 25)
    baseline = np.r_[np.full(25, 3.0), np.full(175, 1.001)]
    doubtful = compare(np.ones(200), baseline - np.r_[np.zeros(175), np.full(25, 0.4)], clips)
    assert "resampled clips do not confirm it" in conclude(VARIES, doubtful, BETTER)


@pytest.mark.parametrize("frames", [BETTER, WORSE])
@pytest.mark.parametrize(("clips", "start"), [(1, "One clip: too few to judge"), (5, "5 clips: too few to judge")])
def test_many_frames_of_few_clips_conclude_nothing(frames, clips, start):
    """Neither success nor none: 6 clips are the fewest of which a signed-rank test can reach p < 0.05."""
    few = _compare(0.5 if frames is BETTER else -0.5, np.arange(100) % clips)
    text = conclude(_spread(_theta([0.1, 0.03, 1.0]), contacts=1), few, few)
    assert text.startswith(start)
    assert "With fewer than 6 clips" in text
    assert "success" not in text
    assert "practically constant" not in text
