"""The judge of alarms counts frames and alarms of a press whose force is known."""

import dataclasses
import math

import pytest

from palpate.estimators.estimate import NINETY, Estimate
from palpate.estimators.records import FrameEstimate
from palpate.results.alarm import ForceAlarm
from tests.estimators.estimates import ESTIMATE, NONE
from tests.results.drawn_alarms import Tally, watch

WIDE = math.exp(NINETY * 0.05)
"""Upper end of the estimate's force, 0.1, over that."""


def frame(number: int, estimate: Estimate | None, contact: bool = True) -> FrameEstimate:
    return FrameEstimate(number, 0.04 * number, "ok", estimate=estimate, contact=contact)


@pytest.mark.parametrize(
    ("force", "limit", "false", "over", "missed"),
    [(0.1, 0.105, 1, 0, 0), (0.1, 0.2, 0, 0, 0), (0.1, 0.05, 0, 2, 0), (0.3, 0.2, 0, 2, 2)],
)
def test_what_is_counted(force: float, limit: float, false: int, over: int, missed: int) -> None:
    tally, lost = Tally(), dataclasses.replace(ESTIMATE, misfit=2.0)
    frames = [frame(0, None, contact=False), frame(1, lost), frame(2, ESTIMATE), frame(3, ESTIMATE)]
    watch(tally, ForceAlarm(limit, "N", math.inf, 0.04), [*frames, NONE], force)
    assert (len(tally.false), tally.over, tally.missed) == (false, over, missed)
    assert tally.first == false
    assert tally.false == [pytest.approx(WIDE * 0.1 / force)] * false
    assert tally.frames["unknown"] == 1
    assert tally.frames.total() == 3
