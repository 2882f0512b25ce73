"""What the figures draw: the data found again in the drawn artists."""

import numpy as np
import pytest

from palpate.physics.mechanics import Mechanics
from palpate.results.paper.figures import draw_response

MECHANICS = Mechanics(time_step=0.01, steps=100, load_steps=25)
LOAD = np.clip(MECHANICS.times / 0.25, 0, 1) * np.where(
    MECHANICS.times <= 0.25, 1, np.exp(-(MECHANICS.times - 0.25) / 0.1)
)


def _trajectories(peaks):
    return np.asarray(peaks)[:, None, None] * LOAD[None, :, None] * np.array([0.0, 0.6, -0.8])


def test_figure_3_shows_displacements_relative_to_the_highest_peak_with_release_and_units():
    peaks = [0.2, 0.4, 0.1]
    figure = draw_response(_trajectories(peaks), np.array([0.2, 0.25, 0.3]), MECHANICS)
    heat, fan = figure.axes[:2]
    np.testing.assert_allclose(heat.images[0].get_array(), np.outer([1, 0.5, 0.25], LOAD), atol=1e-12)
    assert heat.images[0].get_extent() == pytest.approx([0, 1, 3.5, 0.5])
    releases = [segment[0][0] for segment in heat.collections[0].get_segments()]
    assert releases == pytest.approx([0.25, 0.2, 0.3])
    lines = {line.get_label(): line for line in fan.lines}
    np.testing.assert_allclose(lines["median"].get_ydata(), 0.5 * LOAD, atol=1e-12)
    assert lines["release (median)"].get_xdata() == pytest.approx([0.25, 0.25])
    tops = {band.get_label(): band.get_datalim(fan.transData).y1 for band in fan.collections}
    relative = np.divide(peaks, max(peaks))  # LOAD is 1 at the release
    assert tops["10–90th percentile"] == pytest.approx(np.percentile(relative, 90))
    assert tops["25–75th percentile"] == pytest.approx(np.percentile(relative, 75))
    for axes in (heat, fan):
        assert axes.get_xlabel() == "time since first contact [s]"
    assert fan.get_ylabel() == "relative displacement [–]"
    assert "1 = highest peak, 0.4 scene units" in figure.get_suptitle()


def test_trajectories_that_are_not_finite_are_left_out_and_counted():
    trajectories = _trajectories([0.2, 0.4, 0.1])
    trajectories[1, 50] = np.nan
    figure = draw_response(trajectories, np.full(3, 0.25), MECHANICS)
    np.testing.assert_allclose(figure.axes[0].images[0].get_array(), np.outer([1, 0.5], LOAD), atol=1e-12)
    assert "left out, not finite: 1" in figure.get_suptitle()


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_nothing_to_show_is_still_drawn(value):
    figure = draw_response(np.full((2, 100, 3), value), np.full(2, 0.25), MECHANICS)
    assert "1 = highest peak, 0 scene units" in figure.get_suptitle()
    figure.canvas.draw()
