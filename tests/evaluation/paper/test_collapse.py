"""The collapse check on estimates that vary, that don't, and that are too few."""

import numpy as np
import pytest

from evaluation.paper.collapse import check_collapse, conclude, describe
from evaluation.paper.statistics import compare
from physics.mechanics import Bounds

BOUNDS = Bounds()
CLIPS = np.repeat(["a", "b"], 50)


def _theta(spread, seed=0):
    noise = np.random.default_rng(seed).normal(size=(100, 3))
    noise = (noise - noise.mean(axis=0)) / noise.std(axis=0, ddof=1)
    return np.array([0.508, 0.09, -7.79]) + noise * spread


def test_the_papers_own_estimates_count_as_collapsed():
    check = check_collapse(_theta([0.0027, 0.0162, 0.1841]), CLIPS, BOUNDS)
    assert check.verdict == "collapsed"
    stiffness, damping, force = check.parameters
    assert stiffness.sd == pytest.approx(0.0027)
    assert stiffness.spread == pytest.approx(0.0027)
    assert damping.variation == pytest.approx(0.18)
    assert force.spread == pytest.approx(0.01841)
    assert check.sentence.startswith("Collapsed: all three")
    assert "stiffness 0.27 %" in check.sentence


def test_estimates_that_vary():
    check = check_collapse(_theta([0.1, 0.03, 1.0]), CLIPS, BOUNDS)
    assert check.verdict == "varies"
    assert [p.collapsed for p in check.parameters] == [False, False, False]


def test_partly_collapsed_names_the_parameter():
    check = check_collapse(_theta([0.001, 0.03, 1.0]), CLIPS, BOUNDS)
    assert check.verdict == "partly collapsed"
    assert check.sentence.startswith("Partly collapsed: stiffness is practically constant")


def test_a_box_far_too_wide_does_not_make_a_varying_estimate_a_constant():
    # F between −0.03 and −0.09 on a range of [−10, 0]: 0.2 % of the range, but a third of the mean.
    theta = _theta([0.1, 0.03, 0.0])
    theta[:, 2] = -np.linspace(0.03, 0.09, 100)
    assert check_collapse(theta, CLIPS, BOUNDS).parameters[2].collapsed is False


def test_force_is_a_magnitude_unless_its_range_crosses_zero():
    force = check_collapse(_theta([0.1, 0.03, 1.0]), CLIPS, BOUNDS).parameters[2]
    assert (force.low, force.high) == (0, 10)
    assert force.mean == pytest.approx(7.79)
    signed = Bounds(force=(-10, 10))
    assert check_collapse(_theta([0.1, 0.03, 1.0]), CLIPS, signed).parameters[2].mean == pytest.approx(-7.79)


def test_spread_between_and_within_clips():
    theta = np.tile([0.5, 0.1, -5.0], (4, 1))
    theta[:, 0] = [0.2, 0.4, 0.6, 0.8]  # clip means 0.3 and 0.7, ±0.1 within
    stiffness = check_collapse(theta, np.array(list("aabb")), BOUNDS).parameters[0]
    assert stiffness.between_clips_sd == pytest.approx(np.sqrt(2 * 0.2**2))
    assert stiffness.within_clips_sd == pytest.approx(np.sqrt(4 * 0.1**2 / 2))
    assert check_collapse(theta, np.array(list("aaaa")), BOUNDS).parameters[0].between_clips_sd is None


def test_values_at_the_bounds_are_counted():
    theta = np.tile([0.5, 0.1, -5.0], (4, 1))
    theta[:, 1] = [0.0, 0.005, 0.5, 1.0]
    assert check_collapse(theta, np.array(list("aabb")), BOUNDS).parameters[1].at_bound == 0.75


def test_too_few_frames_are_undetermined():
    check = check_collapse(_theta([0.1, 0.1, 1])[:2], CLIPS[:2], BOUNDS)
    assert check.verdict == "undetermined"
    assert "n too small (2 test frames, 3 needed)" in check.sentence
    single = check_collapse(_theta([0.1, 0.1, 1])[:1], CLIPS[:1], BOUNDS)
    assert single.parameters[0].sd is None


def test_no_frames_is_an_error():
    with pytest.raises(ValueError, match="n of at least 1"):
        check_collapse(np.empty((0, 3)), np.empty(0), BOUNDS)


def _compare(shift, clips=None):
    noise = np.random.default_rng(0).normal(0, 0.1, 100)
    return compare(np.ones(100), 1 + shift + noise, np.repeat(list("abcd"), 25) if clips is None else clips)


VARIES = check_collapse(_theta([0.1, 0.03, 1.0]), CLIPS, BOUNDS)
CONSTANT = check_collapse(_theta([0.001, 0.001, 0.01]), CLIPS, BOUNDS)
BEAT = "The estimates beat the constant θ fitted on the training contacts"


@pytest.mark.parametrize(
    ("check", "constant", "reference", "start"),
    [
        (VARIES, _compare(0.5), _compare(0.5), f"{BEAT}. Varies"),
        (CONSTANT, _compare(0.5), _compare(0.5), f"{BEAT}, yet"),
        (VARIES, _compare(-0.5), _compare(0.5), "No success: the estimates do not beat the constant θ"),
        (VARIES, None, _compare(0.5), "No conclusion: the comparison with a fitted constant θ is missing"),
        (VARIES, compare(np.ones(2), np.ones(2), np.zeros(2)), _compare(0.5), "No conclusion: n is too small"),
    ],
)
def test_conclusions(check, constant, reference, start):
    assert conclude(check, constant, reference, contacts=100).startswith(start)


def test_beating_only_the_literature_is_not_success():
    assert "they beat only the literature constants, and that is not success" in conclude(
        VARIES, _compare(-0.5), _compare(0.5), contacts=100
    )
    assert "literature" not in conclude(VARIES, _compare(-0.5), _compare(-0.5), contacts=100)


def test_success_on_frames_but_not_on_clips_is_said():
    # One clip in four carries the whole gain: frames alone call it better, resampled clips don't.
    baseline = np.r_[np.full(25, 3.0), np.full(75, 1.001)]
    by_clip = compare(np.ones(100), baseline - np.r_[np.zeros(75), np.full(25, 0.4)], np.repeat(list("abcd"), 25))
    assert "though not when whole clips are resampled" in conclude(VARIES, by_clip, by_clip, contacts=100)
    one_clip = _compare(0.5, np.zeros(100))
    assert "with frames taken as independent." in conclude(VARIES, one_clip, one_clip, contacts=100)


def test_many_frames_of_few_contacts_conclude_nothing():
    text = conclude(CONSTANT, _compare(0.5), _compare(0.5), contacts=1)
    assert text.startswith("No conclusion: the estimates have a lower error than the constant θ")
    assert "(1 observed contact, 6 needed)" in text
    assert conclude(VARIES, _compare(-0.5), _compare(0.5), contacts=1).startswith("No success")


def test_descriptions():
    text = describe(_compare(0.25), "A", "B")
    assert text.startswith("A has a mean error 2")
    assert "% below that of B (Wilcoxon p = " in text
    assert text.endswith("n = 100 frames of 4 clips): better; the clip-level interval of the difference excludes 0.")
    assert "not tested: n too small" in describe(compare(np.ones(2), np.zeros(2) + 3, np.zeros(2)), "A", "B")
    assert "no pair of finite errors" in describe(compare([np.nan], [1.0], ["a"]), "A", "B")
