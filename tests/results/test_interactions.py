"""What is told and drawn of runs of contact."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest

from physics.load import held
from results.interactions import MOST_PANELS, contact_panel, draw_contacts
from results.plots import ContactPanel
from tests.estimators.estimates import CONTACT, ESTIMATE, GOOD, LOAD_STEPS, MECHANICS, NONE


def test_a_panel_tells_the_verdict_first_and_no_number_surer_than_it() -> None:
    panel = contact_panel(GOOD)
    assert panel.state == "determined"
    assert panel.heading == (
        "determined: contact from frame 7 (0.280 s), k_s 0.5 ± 0.05, k_d 0.06 ± 0.012, |F| 0.1 ± 0.005"
    )
    assert panel.sentence == "Misfit 1.1 (1: it fits); F (±0.05), k_s (±0.1), k_d (±0.2) are determined."
    assert (panel.motion.times[0], panel.motion.noise, panel.motion.release) == (0.04, 0.001, 0.16)
    doubted = contact_panel(dataclasses.replace(GOOD, detail="It does not fit."))
    assert doubted.state == "doubtful"
    assert doubted.heading.startswith("determined, but doubtful: contact")
    assert doubted.heading.endswith("k_s 0.42 to 0.59, k_d 0.043 to 0.083, |F| 0.092 to 0.11")
    assert doubted.sentence.startswith("It does not fit. Misfit 1.1")
    assert doubted.sentence.endswith("Ranges are 90 % intervals.")
    loose = dataclasses.replace(GOOD, estimate=dataclasses.replace(ESTIMATE, covariance=np.eye(3)))
    assert contact_panel(loose).heading.startswith("undetermined: contact from frame 7 (0.280 s), k_s 0.097")
    assert contact_panel(NONE) == ContactPanel(
        "no_estimate", "no estimate: contact from frame 1 (0.000 s)", "Because.", None
    )


def test_motion_is_drawn_along_the_force() -> None:
    """F < 0 presses against the normal, so motion against it is positive."""
    pressed = CONTACT.observation.moved(-0.02 * np.tile(CONTACT.direction, (8, 1)), 0.001)
    seen = dataclasses.replace(GOOD, interaction=dataclasses.replace(CONTACT, observation=pressed))
    motion = contact_panel(seen).motion
    np.testing.assert_allclose(motion.observed, np.full(8, 0.02), rtol=1e-6)
    np.testing.assert_array_equal(motion.simulated, [0.0, 0.02])
    pulled = dataclasses.replace(seen, estimate=dataclasses.replace(ESTIMATE, theta=np.array([0.5, 0.06, 0.1])))
    np.testing.assert_allclose(contact_panel(pulled).motion.observed, np.full(8, -0.02), rtol=1e-6)


def test_a_release_is_told_where_one_was_seen() -> None:
    def release(load_steps: int, *delays: float) -> float | None:
        press = dataclasses.replace(CONTACT.load, factor=held(load_steps, MECHANICS.steps))
        contact = dataclasses.replace(CONTACT, load=press)
        estimate = dataclasses.replace(ESTIMATE, delays=delays)
        return contact_panel(dataclasses.replace(GOOD, interaction=contact, estimate=estimate)).motion.release

    assert release(LOAD_STEPS) == pytest.approx(0.16)
    assert release(LOAD_STEPS, -0.01, -0.02) == pytest.approx(0.14)
    assert release(MECHANICS.steps, -0.01) is None


def test_the_picture_has_a_panel_for_each_contact_and_counts_the_others() -> None:
    good, failed = contact_panel(GOOD), contact_panel(NONE)
    figure = draw_contacts([good, failed], Counter({"determined": 1, "no_estimate": 1}), "clip")
    assert [bool(axes.lines) for axes in figure.axes] == [True, False]
    assert figure._supxlabel.get_text().startswith("Runs of contact: 2, with an estimate: 1.\n")
    panels = [good] + [failed] * (MOST_PANELS - 1)
    figure = draw_contacts(panels, Counter({"determined": 1, "no_estimate": MOST_PANELS}), "clip")
    assert len(figure.axes) == MOST_PANELS
    assert f" {MOST_PANELS} are drawn, interactions.csv has all." in figure._supxlabel.get_text()
    (empty,) = draw_contacts([], Counter(), "clip").axes
    assert [text.get_text() for text in empty.texts] == ["no contact was found"]
