"""Suites: the right error each, the same truth in all, and splits that share nothing."""

import dataclasses

import numpy as np
import pytest

from data.synthetic import clip_seed, draw_truth
from evaluation.suites import FITTED_ON, REGIMES, SPLITS, SUITES, suite_clip_seed

NAMES = ["clean", "8bit", "noisy", "flicker", "mask-error", "focal-error", "occlusion", "mismatch"]


def test_suites_are_those_that_were_agreed():
    assert list(SUITES) == NAMES
    assert all(suite.reason for suite in SUITES.values())


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("clean", {}),
        ("8bit", {"depth_noise": 0.0, "depth_bits": 8}),
        ("noisy", {"depth_noise": 0.004}),
        ("flicker", {"scale_flicker": 0.005}),
        ("mask-error", {"mask_error": 1.0}),
        ("focal-error", {"focal_error": 1.1}),
        ("occlusion", {"occlusion": 0.2}),
        ("mismatch", {"stiffness_variation": 0.3}),
    ],
)
def test_each_suite_has_one_error(name, changed):
    clean, suite = (dataclasses.asdict(SUITES[which].settings(0)) for which in ("clean", name))
    assert {key: value for key, value in suite.items() if value != clean[key]} == changed


def test_regimes_take_turns_and_half_of_each_has_nonlinear_springs_in_mismatch():
    settings = [SUITES["mismatch"].settings(index) for index in range(12)]
    assert [each.regime for each in settings] == [*REGIMES] * 4
    for regime in REGIMES:
        assert [each.nonlinearity for each in settings if each.regime == regime] == [0.0, 0.5, 0.0, 0.5]


def test_splits_share_no_seed_at_any_seed():
    seeds = [suite_clip_seed(split, seed, index) for split in SPLITS for seed in range(20) for index in range(50)]
    seeds += [clip_seed(seed, index) for seed in range(20) for index in range(50)]
    assert len(set(seeds)) == len(seeds)
    assert suite_clip_seed("test", 3, 7) == suite_clip_seed("test", 3, 7)


def test_the_constant_is_fitted_on_another_split():
    assert all(split != other for split, other in FITTED_ON.items())
    assert FITTED_ON["test"] == "validation"


def test_splits_draw_other_geometry_and_theta():
    drawn = [draw_truth(SUITES["clean"].settings(2), suite_clip_seed(split, 0, 2)) for split in ("validation", "test")]
    (first, first_motion), (second, second_motion) = drawn
    assert first.sheet.distance != second.sheet.distance
    assert not np.allclose(first_motion.theta, second_motion.theta)
