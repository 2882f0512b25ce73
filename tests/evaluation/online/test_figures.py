"""The paper's figures: their units and instants."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.evaluation.online.compare import METHODS, Case
from palpate.evaluation.online.figures import draw_all, instants
from palpate.evaluation.online.sequences import SEQUENCES, Pull

FRAMES = 12


@pytest.fixture(scope="module")
def pull() -> Pull:
    return SEQUENCES["thin-shell-1"].pull(36, 50, FRAMES)


def case_at(pull: Pull, ahead: list[int]) -> Case:
    """Gaps of as many mm as the frame's number, a Chamfer distance of 2 mm."""
    count, particles = len(ahead), pull.body.count
    fields = np.ones((count, particles))
    gaps = np.array(ahead)[:, None] * 1e-3 * fields
    states = np.broadcast_to(pull.body.rest, (count, particles, 3))
    each = np.ones(count)
    return Case(np.full(FRAMES, 0.002), np.array(ahead) - 1, each, gaps, states, each, fields, fields, 0.0, 1.0)


@pytest.mark.parametrize(
    ("ahead", "shown"),
    [([10, 20, 30, 40, 50], [40, 50]), ([20, 40, 50, 80], [40, 50]), ([10, 20, 30], [20, 30]), ([12], [12])],
)
def test_figure_8_shows_the_paper_s_instants_or_the_last_two(pull: Pull, ahead: list[int], shown: list[int]) -> None:
    case = case_at(pull, ahead)
    assert [1 + int(case.ahead[at]) for at in instants(case)] == shown
    cases = {("thin-shell-1", "k2", method): case for method in METHODS}
    figure = draw_all(cases, {"thin-shell-1": pull})["figure_8.png"]
    drawn = [axes for axes in figure.axes if axes.collections and axes.get_title()]
    wanted = [f"thin-shell-1, k2\n{m}, t = {t} + 10" for t in shown for m in ("PBD", "PBD-RM", "PBD-RM-ON")]
    assert [axes.get_title() for axes in drawn] == wanted
    values = [np.unique(axes.collections[0].get_array()) for axes in drawn]
    np.testing.assert_allclose(np.concatenate(values), np.repeat(shown, 3))  # mm
    for axes in drawn:
        assert axes.collections[0].get_clim() == pytest.approx((0.0, max(shown)))


def test_figure_5_is_in_mm_as_the_paper_s(pull: Pull) -> None:
    figure = draw_all({("thin-shell-1", "k2", "PBD"): case_at(pull, [10])}, {"thin-shell-1": pull})["figure_5.png"]
    assert figure.axes[0].get_ylabel() == "Chamfer distance [mm]"
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), 2.0)
