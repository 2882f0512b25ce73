"""Presses in plain videos: the summary of given rows, and one drawn press from its MP4 alone."""

from __future__ import annotations

import math

import pytest

from palpate.evaluation.plain_video import measured_video, summarised


def test_summary_counts_what_is_determined_and_held():
    frames = {"pressed_frames": 9, "pressed_found": 8, "other_frames": 22, "other_found": 1}
    known = {"force_determined": 1, "force_sd": 0.1}
    rows = [frames | known | {"force_error": error} for error in (0.05, -0.15, 0.4)] + [frames]
    found = summarised(rows).set_index("measure")
    assert found.loc["pressed frames called contact", ["count", "of"]].tolist() == [32, 36]
    assert found.loc["other frames called contact", ["count", "of"]].tolist() == [4, 88]
    assert found.loc["force", ["count", "of"]].tolist() == [3, 4]
    assert found.loc["force", "median error"] == pytest.approx(0.15)
    assert found.loc["force", "held"] == pytest.approx(2 / 3)
    assert found.loc["damping", "count"] == 0
    assert math.isnan(found.loc["damping", "held"])


@pytest.mark.slow
def test_a_press_is_found_and_its_ratios_determined_from_a_video_alone():
    """The demo's third clip, under-damped: everything is determined, and every interval holds."""
    from palpate.data.synthetic.clip import clip_seed

    found = measured_video(clip_seed(1, 2), 32)
    assert found["verdict"] == "determined"
    assert found["pressed_found"] == found["pressed_frames"] == 8
    assert found["other_found"] <= 1
    for name in ("stiffness", "damping", "force", "damping_over_stiffness", "force_over_stiffness"):
        assert found[f"{name}_determined"]
        assert abs(found[f"{name}_error"]) < min(1.645 * found[f"{name}_sd"], 0.25), name
