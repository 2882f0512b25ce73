"""What the picture of a clip's contacts holds."""

import dataclasses
import warnings
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb

from palpate.estimators.records import InteractionEstimate
from palpate.physics.identifiability import NINETY
from palpate.results.artefacts.fit import MOST_PANELS, draw_fits, write_figure
from palpate.results.verdicts import NOTES, state
from tests.estimators.estimates import CONTACT, ESTIMATE, GOOD, NONE
from tests.results.fields import GRIP, PULL, TIMES


def fits(*runs: InteractionEstimate) -> list[Axes]:
    return draw_fits(runs, Counter(map(state, runs)), "clip").axes


def curve(axes: Axes, label: str) -> np.ndarray:
    (found,) = [line.get_xydata() for line in axes.lines if line.get_label() == label]
    return found.T


def heading(axes: Axes) -> str:
    return axes.texts[0].get_text().replace("\n", " ")


def observed(axes: Axes) -> np.ndarray:
    """Times and displacements with error bars, shape [2, n]."""
    (bars,) = axes.containers
    return bars.lines[0].get_xydata().T


def test_long_and_odd_names_are_written_whole_and_inside(tmp_path: Path) -> None:
    figure = draw_fits([dataclasses.replace(GOOD, detail="a path " * 60)], Counter(), "W" * 200 + " $x_1$ \udce4 名")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_figure(tmp_path / "fit.png", figure)
    picture = cv2.imread(str(tmp_path / "fit.png"))
    assert picture.shape[1] == 1500
    for side in (picture[:, :5], picture[:, -5:], picture[:4], picture[-4:]):
        assert side.min() == 255  # nothing is cut
    assert figure.axes[0].get_title("left").replace("\n", " ").startswith(("a path " * 60).strip())
    assert figure.get_suptitle().replace("\n", " ").endswith(r" \$x_1\$ ? 名")
    assert figure.get_supxlabel().endswith("Research software, not a medical device.")


def test_a_fit_shows_verdict_numbers_observation_simulation_and_release() -> None:
    (axes,) = fits(GOOD)
    numbers = "k_s 0.500 ± 0.083 f/u, k_d 0.060 ± 0.020 f·s/u, |F| 0.1000 ± 0.0082 f"
    assert heading(axes) == f"stiffness, damping and force known: contact from frame 7, {numbers}"
    assert to_rgb(axes.texts[0].get_color()) == pytest.approx(np.divide(NOTES["determined"].color, 255))
    np.testing.assert_allclose(observed(axes), (CONTACT.observation.times, np.zeros(8)))
    np.testing.assert_allclose(curve(axes, "simulated with the fit"), ([0.0, 0.32], [0.0, 0.02]))
    assert curve(axes, "release, 0.160 s")[0] == pytest.approx(0.16)
    (bars,) = axes.collections
    np.testing.assert_allclose([bar[:, 1] for bar in bars.get_segments()], [[-0.001 * NINETY, 0.001 * NINETY]] * 8)
    (doubted,) = fits(dataclasses.replace(GOOD, detail="It does not fit."))
    assert heading(doubted).endswith("k_s 0.42 to 0.59 f/u, k_d 0.043 to 0.083 f·s/u, |F| 0.092 to 0.11 f")
    assert doubted.get_title("left").startswith("It does not fit.")


def test_motion_is_drawn_along_the_force() -> None:
    """F < 0 presses against the normal, so motion against it is positive."""
    pressed = CONTACT.observation.moved(-0.02 * np.tile(CONTACT.direction, (8, 1)), 0.001)
    seen = dataclasses.replace(GOOD, interaction=CONTACT.having(point=pressed))
    np.testing.assert_allclose(observed(*fits(seen))[1], np.full(8, 0.02), rtol=1e-6)
    pulled = dataclasses.replace(seen, estimate=dataclasses.replace(ESTIMATE, theta=np.array([0.5, 0.06, 0.1])))
    np.testing.assert_allclose(observed(*fits(pulled))[1], np.full(8, -0.02), rtol=1e-6)


def test_pulls_show_their_force_and_fields_their_motion() -> None:
    grip, field = fits(dataclasses.replace(NONE, grip=GRIP), dataclasses.replace(NONE, field=PULL, detail="Told."))
    assert heading(grip) == "only the change of force known: contact from frame 1"
    np.testing.assert_allclose(curve(grip, "force along that of the last frame"), (GRIP.times, GRIP.times / 3))
    assert heading(field) == "only stiffer places known: contact from frame 1"
    assert field.get_title("left") == "Told."
    np.testing.assert_allclose(curve(field, "observed"), (TIMES, [0, 2, 5]))
    np.testing.assert_allclose(curve(field, "simulated"), (TIMES, [0, 1.5, 4.2]))


def test_contacts_without_estimate_say_why_and_those_not_drawn_are_counted() -> None:
    reason = "The onset of the contact was not seen. " * 9
    figure = draw_fits([GOOD, dataclasses.replace(NONE, detail=reason)], Counter(determined=1, no_estimate=1), "clip")
    first, second = figure.axes
    assert first.axison
    assert not second.axison
    assert heading(second) == "no estimate: contact from frame 1"
    assert second.get_title("left").replace("\n", " ") == reason.strip()
    assert figure.get_supxlabel().startswith("Contacts: 2, with an estimate: 1. u and f: ")
    counts = Counter(determined=1, no_estimate=MOST_PANELS)
    figure = draw_fits([GOOD] + [NONE] * (MOST_PANELS - 1), counts, "clip")
    assert f" {MOST_PANELS} are drawn, interactions.csv has all." in figure.get_supxlabel()
    assert fits() == []
