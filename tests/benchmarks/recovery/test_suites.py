"""Suites: the right error each, the same truth in all, and splits that share nothing."""

import dataclasses

from benchmarks.recovery.suites import GRID_SIZE, SPLITS, SUITES, suite_clip_seed
from palpate.data.synthetic.clip import clip_seed
from palpate.data.synthetic.truth import REGIMES

CHANGED = {
    "clean": {},
    "8bit": {"depth_noise": 0.0, "depth_bits": 8},
    "noisy": {"depth_noise": 0.004},
    "flicker": {"scale_flicker": 0.005},
    "mask-error": {"mask_error": 1.0},
    "focal-error": {"focal_error": 1.1},
    "occlusion": {"occlusion": 0.2},
    "mismatch": {"stiffness_variation": 0.3},
    "oblique": {"max_tilt_deg": 30.0},
    "late-onset": {"onset_delay": (0.0, 1.0), "release_delay": (0.0, 1.0)},
    "patch": {"patch_radius": (2.0, 5.0), "force_tilt_deg": (0.0, 20.0), "profile": "hold"}
    | {"rise": (0.1, 0.45), "fall": (0.1, 0.45)},
    "filled": {"view": "filled", "peak_displacement": (0.01, 0.04), "patch_radius": (0.0, 5.0), "max_tilt_deg": 15.0}
    | {"profile": "hold", "rise": (0.05, 0.45), "fall": (0.05, 0.45)}
    | {"lamp_offset": 0.03, "highlights": 0.3, "gloss": 300.0, "vignetting": 0.35},
}


def test_suites_are_those_that_were_agreed_and_each_has_one_error():
    assert list(SUITES) == list(CHANGED)
    clean = dataclasses.asdict(SUITES["clean"].settings(0))
    for name, suite in SUITES.items():
        assert suite.reason
        settings = dataclasses.asdict(suite.settings(0))
        assert {key: value for key, value in settings.items() if value != clean[key]} == CHANGED[name], name


def test_pictures_are_of_the_size_that_is_asked_for():
    for suite in SUITES.values():
        for settings in (suite.settings, suite.truth_settings):
            plain, large = settings(4), settings(4, (854, 480))
            assert (plain.width, plain.height, large.width, large.height) == (*GRID_SIZE, 854, 480)
            assert dataclasses.replace(large, width=plain.width, height=plain.height) == plain


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
