"""The smoothed tissue: planes are kept, noise is measured and removed, everything else is left alone."""

import numpy as np
import pytest

from palpate.data.contact.surface import smooth_surface

ROWS, COLUMNS = np.mgrid[:40, :60]
PLANE = (0.5 + 0.002 * COLUMNS - 0.001 * ROWS).astype(np.float32)
MASK = (ROWS > 5) & (ROWS < 35) & (np.hypot(COLUMNS - 30, ROWS - 20) > 6) & (COLUMNS < 55)


@pytest.mark.parametrize("smoothing", [0.7, 3.0, 6.0])
def test_a_plane_stays_also_at_the_edges_of_the_mask(smoothing: float) -> None:
    smooth, noise = smooth_surface(PLANE, MASK, smoothing)
    np.testing.assert_allclose(smooth, PLANE, atol=2e-7)
    assert noise < 2e-7


def test_nothing_outside_the_mask_is_read_or_changed() -> None:
    depth = np.where(MASK, PLANE, np.random.default_rng(0).uniform(0, 1, PLANE.shape)).astype(np.float32)
    before = depth.copy()
    smooth, _ = smooth_surface(depth, MASK, 3.0)
    np.testing.assert_array_equal(smooth[~MASK], before[~MASK])
    np.testing.assert_allclose(smooth[MASK], PLANE[MASK], atol=2e-7)
    np.testing.assert_array_equal(depth, before)


def test_noise_is_measured_and_taken_away() -> None:
    rows, columns = np.mgrid[:120, :200]
    plane = 0.5 + 0.001 * columns + 0.0005 * rows
    noisy = plane + np.random.default_rng(1).normal(0, 0.003, plane.shape)
    smooth, noise = smooth_surface(noisy.astype(np.float32), np.ones(plane.shape, bool), 4.0)
    assert noise == pytest.approx(0.003, rel=0.02)
    # White noise through 2g - g∗g of a Gaussian g keeps √(11/24π)/σ of its deviation; at the rim a plane keeps more.
    inside = np.s_[15:-15, 15:-15]
    assert (smooth - plane)[inside].std() == pytest.approx(0.003 * np.sqrt(11 / 24 / np.pi) / 4, rel=0.15)


def test_curved_tissue_is_not_cut_off() -> None:
    """A plane alone is off by κσ² on a paraboloid of curvature κ."""
    rows, columns = np.mgrid[:120, :160]
    curved = 0.5 + 0.5e-4 * (np.square(columns - 80.0) + np.square(rows - 60.0))
    smooth, noise = smooth_surface(curved.astype(np.float32), np.ones(curved.shape, bool), 3.0)
    inside = np.s_[25:-25, 25:-25]
    np.testing.assert_allclose(smooth[inside], curved[inside], atol=2e-5)
    assert noise == pytest.approx(1e-4 * 3.0**2, rel=0.1)


def test_no_tissue_leaves_everything_and_has_no_noise() -> None:
    smooth, noise = smooth_surface(PLANE, np.zeros(PLANE.shape, bool), 3.0)
    np.testing.assert_array_equal(smooth, PLANE)
    assert np.isnan(noise)
