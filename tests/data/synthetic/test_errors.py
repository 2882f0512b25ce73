"""Every error of observation measured against its knob."""

import dataclasses

import numpy as np
import pytest

from palpate.data.source.camera import Camera
from palpate.data.synthetic.errors import depth_bias, observe_depth, observe_labels, reported_camera, stored_to_depth
from palpate.data.synthetic.settings import SceneSettings

SMALL = SceneSettings(width=214, height=120)
DEPTH = np.linspace(0.4, 0.8, 120 * 214, dtype=np.float32).reshape(120, 214)


def observed(depth: np.ndarray = DEPTH, seed: int = 0, **changes) -> np.ndarray:
    stored = observe_depth(depth, dataclasses.replace(SMALL, **changes), np.random.default_rng(seed))
    return stored_to_depth(stored)


def test_without_errors_only_the_rounding_of_16_bits_is_left() -> None:
    assert np.abs(observed() - DEPTH).max() <= 0.5 / 65535 + 1e-7


def test_8_bits_round_to_256_levels() -> None:
    stored = observe_depth(DEPTH, dataclasses.replace(SMALL, depth_bits=8), np.random.default_rng(0))
    assert stored.dtype == np.uint8
    np.testing.assert_array_equal(np.unique(stored), np.arange(102, 205))
    assert np.abs(stored_to_depth(stored) - DEPTH).max() <= 0.5 / 255 + 1e-6


@pytest.mark.parametrize("correlation", [0.0, 1.5])
def test_depth_noise_has_the_wanted_size(correlation: float) -> None:
    noise = observed(depth_noise=0.004, depth_noise_correlation=correlation) - DEPTH
    assert noise.std() == pytest.approx(0.004, rel=0.05)
    assert abs(noise.mean()) < 4 * 0.004 * (1 + 4 * correlation) / np.sqrt(noise.size)
    neighbours = np.corrcoef(noise[:, 1:].ravel(), noise[:, :-1].ravel())[0, 1]
    # A Gaussian of standard deviation s gives a correlation exp(-1/(4 s^2)) between neighbours.
    assert neighbours == pytest.approx(np.exp(-1 / (4 * correlation**2)) if correlation else 0, abs=0.03)


def test_flicker_scales_each_frame_as_a_whole() -> None:
    ratios = [observed(seed=seed, scale_flicker=0.02) / DEPTH for seed in range(300)]
    assert max(float(np.ptp(ratio)) for ratio in ratios) < 1e-4
    assert np.std([np.log(ratio.mean()) for ratio in ratios]) == pytest.approx(0.02, rel=0.15)


def test_a_depth_s_bias_is_smooth_and_of_its_size() -> None:
    wide = dataclasses.replace(SMALL, depth_bias=0.05)
    logs = np.array([np.log(depth_bias(wide, np.random.default_rng(seed))) for seed in range(40)])
    # A few correlation lengths a picture: its edges, where the blur mirrors, vary more.
    assert 0.04 < np.sqrt(np.square(logs).mean()) < 0.08
    assert np.abs(np.diff(logs, axis=2)).max() < 0.2 * 0.05
    assert (depth_bias(SMALL, np.random.default_rng(0)) == 1).all()


def test_missing_depth_stays_missing_and_noise_makes_none() -> None:
    holes = np.where(DEPTH > 0.6, 0, 0.001).astype(np.float32)
    noisy = observed(holes, depth_noise=0.01, depth_bits=8)
    np.testing.assert_array_equal(noisy == 0, holes == 0)


def test_mask_error_displaces_outlines_by_its_size() -> None:
    settings = dataclasses.replace(SMALL, width=428, height=240, mask_error=1.0)
    labels = np.where(np.arange(428) < 214, 22, 21).astype(np.uint8) * np.ones((240, 1), np.uint8)
    edges = []
    for seed in range(40):
        shifted = observe_labels(labels, settings, np.random.default_rng(seed))
        assert set(np.unique(shifted)) == {21, 22}
        edges.append((shifted == 22).sum(axis=1) - 214)
    # One grid pixel is two pixels of this picture.
    assert np.std(edges) == pytest.approx(2.0, rel=0.15)
    assert observe_labels(labels, SMALL, np.random.default_rng(0)) is labels


def test_focal_error_changes_the_claimed_focal_length_only() -> None:
    camera = Camera.from_field_of_view(60, 214, 120)
    claimed = reported_camera(camera, dataclasses.replace(SMALL, focal_error=1.1))
    assert (claimed.fx, claimed.fy) == (pytest.approx(1.1 * camera.fx), pytest.approx(1.1 * camera.fy))
    assert (claimed.cx, claimed.cy, claimed.width) == (camera.cx, camera.cy, camera.width)
