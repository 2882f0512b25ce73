"""The judge of alarms counts frames and alarms of a press whose force is known."""

import dataclasses
import math

import pytest

from palpate.estimators.estimate import NINETY, Estimate
from palpate.estimators.records import FrameEstimate
from palpate.results.alarm import ForceAlarm
from tests.estimators.estimates import ESTIMATE, NONE
from tests.results import drawn_alarms
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


@pytest.mark.slow
def test_the_command_judges_a_clean_and_a_noisy_press(capsys: pytest.CaptureFixture[str]) -> None:
    assert drawn_alarms.main(["--presses", "2", "--seed", "775001"]) == 0
    first, _, *table = capsys.readouterr().out.splitlines()
    assert first == "2 presses, forces of 0.036 to 0.053"
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table[2:] if line]
    wanted = [(suite, f"{limit:g}") for suite in drawn_alarms.SUITES for limit in drawn_alarms.LIMITS]
    assert [(row[0], row[1]) for row in rows] == wanted
    assert {row[2] for row in rows} == {"0 of 0"}  # neither force lies over a limit by more than an interval
    assert all(row[4] == "" for row in rows if row[1] == "0.03")  # no press lies under that
