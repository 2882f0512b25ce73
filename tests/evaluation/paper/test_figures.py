"""What the figures draw: the data behind them, and the data found again in the drawn artists."""

import numpy as np
import pytest

from evaluation.paper.figures import draw_next_depth, draw_response, draw_theta, response, theta_series
from physics.mechanics import Bounds, Mechanics

MECHANICS = Mechanics(time_step=0.01, steps=100, load_steps=25)
LOAD = np.clip(MECHANICS.times / 0.25, 0, 1) * np.where(
    MECHANICS.times <= 0.25, 1, np.exp(-(MECHANICS.times - 0.25) / 0.1)
)


def _trajectories(peaks):
    return np.asarray(peaks)[:, None, None] * LOAD[None, :, None] * np.array([0.0, 0.6, -0.8])


def test_response_is_relative_to_the_highest_peak_and_sorted():
    data = response(_trajectories([0.2, 0.4, 0.1]), [25, 25, 25], MECHANICS)
    assert data.order.tolist() == [1, 0, 2]
    assert data.peak == pytest.approx(0.4)
    np.testing.assert_allclose(data.relative, np.outer([1, 0.5, 0.25], LOAD), atol=1e-12)
    np.testing.assert_allclose(data.release, 0.25)
    assert data.times[0] == pytest.approx(0.01)


def test_response_percentiles_are_numpys():
    peaks = np.random.default_rng(0).uniform(0.1, 1, 31)
    data = response(_trajectories(peaks), [25] * 31, MECHANICS)
    expected = np.percentile(peaks / peaks.max(), [10, 25, 50, 75, 90])
    np.testing.assert_allclose(data.percentiles[:, 24], expected)  # LOAD is 1 at the release


def test_trajectories_that_are_not_finite_are_left_out_and_counted():
    trajectories = _trajectories([0.2, 0.4, 0.1])
    trajectories[1, 50] = np.nan
    data = response(trajectories, [25, 30, 35], MECHANICS)
    assert data.order.tolist() == [0, 2]
    assert data.left_out == 1
    np.testing.assert_allclose(data.release, [0.25, 0.35])
    assert "left out, not finite: 1" in draw_response(data).get_suptitle()


def test_figure_3_shows_the_data_with_release_and_units():
    data = response(_trajectories([0.2, 0.4, 0.1]), [25] * 3, MECHANICS)
    heat, fan = draw_response(data).axes[:2]
    np.testing.assert_array_equal(heat.images[0].get_array(), data.relative)
    assert heat.images[0].get_extent() == pytest.approx([0, 1, 3.5, 0.5])
    assert heat.lines[0].get_xdata() == pytest.approx([0.25, 0.25])
    lines = {line.get_label(): line for line in fan.lines}
    np.testing.assert_array_equal(lines["median"].get_ydata(), data.percentiles[2])
    assert lines["release, 0.25 s"].get_xdata() == pytest.approx([0.25, 0.25])
    bands = {band.get_label(): band.get_datalim(fan.transData) for band in fan.collections}
    assert bands["10–90th percentile"].y1 == pytest.approx(data.percentiles[4].max())
    assert bands["25–75th percentile"].y1 == pytest.approx(data.percentiles[3].max())
    for axes in (heat, fan):
        assert axes.get_xlabel() == "time since first contact [s]"
    assert fan.get_ylabel() == "relative displacement [–]"


def test_releases_that_differ_are_drawn_row_by_row():
    data = response(_trajectories([0.2, 0.4]), [20, 30], MECHANICS)
    heat, fan = draw_response(data).axes[:2]
    segments = heat.collections[0].get_segments()
    assert [segment[0][0] for segment in segments] == pytest.approx([0.3, 0.2])
    assert "range of releases" in fan.get_legend_handles_labels()[1]


@pytest.mark.parametrize("trajectories", [np.zeros((2, 100, 3)), np.full((2, 100, 3), np.nan)])
def test_nothing_to_show_is_still_drawn(trajectories):
    data = response(trajectories, [25, 25], MECHANICS)
    assert data.peak == 0
    draw_response(data).canvas.draw()


def test_theta_is_ordered_by_clip_and_frame_with_force_as_magnitude():
    theta = np.array([[0.1, 0.2, -3.0], [0.2, 0.3, -4.0], [0.3, 0.4, -5.0]])
    data = theta_series(theta, ["b", "a", "a"], [0, 7, 3], Bounds())
    np.testing.assert_array_equal(data.values[:, 0], [0.3, 0.2, 0.1])
    np.testing.assert_array_equal(data.values[:, 2], [5.0, 4.0, 3.0])
    assert data.clip_starts.tolist() == [0, 2]
    assert data.clip_names == ("a", "b")
    np.testing.assert_array_equal(data.limits, [[0, 1], [0, 1], [0, 10]])
    pulling = theta_series(theta, ["b", "a", "a"], [0, 7, 3], Bounds(force=(-2, 6), initial=(0.5, 0.5, 1)))
    np.testing.assert_array_equal(pulling.limits[2], [0, 6])


def test_theta_figure_draws_estimates_box_and_baselines():
    theta = np.tile([0.5, 0.1, -5.0], (4, 1))
    data = theta_series(theta, ["a", "a", "b", "b"], [0, 1, 0, 1], Bounds())
    figure = draw_theta(data, constant=(0.3, 0.2, -0.4))
    box = figure.axes[4]
    lines = {line.get_label(): line for line in box.lines}
    np.testing.assert_array_equal(lines["estimate"].get_ydata(), 5.0)
    assert lines["constant θ fitted on training contacts"].get_ydata()[0] == 0.4
    assert box.get_ylim()[0] <= 0 < 10 <= box.get_ylim()[1]
    assert any("literature value 5.34: outside the range" in text.get_text() for text in figure.axes[0].texts)
    damping = {line.get_label(): line for line in figure.axes[2].lines}
    assert damping["literature value"].get_ydata()[0] == 0.127
    low, high = figure.axes[5].get_ylim()
    assert low < 5 < high < 6
    assert [tick.get_text() for tick in figure.axes[4].get_xticklabels()] == ["a", "b"]


def test_many_clips_are_not_named_on_the_axis():
    theta = np.random.default_rng(0).uniform(0.1, 0.9, (30, 3)) * (1, 1, -10)
    figure = draw_theta(theta_series(theta, [f"clip {i}" for i in range(30)], [0] * 30, Bounds()))
    figure.canvas.draw()
    assert not any("clip" in tick.get_text() for tick in figure.axes[4].get_xticklabels())


def test_next_depth_shows_both_on_one_scale_and_their_difference():
    real, predicted = np.full((4, 6), 0.5), np.full((4, 6), 0.4)
    panels = [axes for axes in draw_next_depth(real, predicted).axes if axes.images]
    drawn = [axes.images[0] for axes in panels]
    np.testing.assert_array_equal(drawn[0].get_array(), real)
    np.testing.assert_array_equal(drawn[1].get_array(), predicted)
    np.testing.assert_allclose(drawn[2].get_array(), 0.1)
    assert drawn[0].get_clim() == drawn[1].get_clim() == (0, 0.5)
