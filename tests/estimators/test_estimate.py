"""The record of a frame."""

from __future__ import annotations

import dataclasses

from estimators.estimate import FrameEstimate


def test_everything_unknown_is_none() -> None:
    estimate = FrameEstimate(3, 0.12, "no_tool")
    values = dataclasses.asdict(estimate)
    assert {name for name, value in values.items() if value is not None} == {
        "frame",
        "time_s",
        "status",
        "detail",
        "verdict",
    }
