"""What the pictures of a clip and of its contacts hold."""

import dataclasses
import warnings
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from palpate.estimators.estimate import NINETY
from palpate.estimators.records import InteractionEstimate
from palpate.physics.load import held
from palpate.results.panels import NOTICE, OBSERVED
from palpate.results.plots import MOST_PANELS, draw_fits, write_figure
from palpate.results.surface_plot import draw_surface_errors
from palpate.results.verdicts import COLORS, state
from tests.estimators.estimates import CONTACT, ESTIMATE, GOOD, LOAD_STEPS, MECHANICS, NONE
from tests.results.fields import FIELD_SEEN, GRIP, PULL, TIMES


def curve(axes: Axes, label: str) -> tuple[np.ndarray, np.ndarray]:
    """Finite points of a curve by its label."""
    (found,) = [line.get_xydata() for line in axes.lines if line.get_label() == label]
    return tuple(found[np.isfinite(found).all(axis=1)].T)


def legend(axes: Axes) -> list[str]:
    return [entry.get_text() for entry in axes.get_legend().get_texts()]


def heading(axes: Axes) -> str:
    return axes.texts[0].get_text()


def extent(area: PolyCollection) -> Bbox:
    """Box around all of a coloured area, in the data's units."""
    return Bbox.union([path.get_extents() for path in area.get_paths()])


def color_of(name: str) -> tuple[float, ...]:
    return tuple(channel / 255 for channel in COLORS[name])


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(lambda item: hasattr(item, "get_text"))]


def test_long_and_odd_names_are_written_whole_and_inside(tmp_path: Path) -> None:
    figure = draw_fits([dataclasses.replace(GOOD, detail="a path " * 60)], Counter(), "W" * 200 + " $x_1$ \udce4 名")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_figure(tmp_path / "fit.png", figure)
    picture = cv2.imread(str(tmp_path / "fit.png"))
    assert picture.shape[1] == 1500
    for side in (picture[:, :5], picture[:, -5:], picture[:4], picture[-4:]):
        assert side.min() == 255  # nothing is cut
    title, footer = figure.get_suptitle(), figure.get_supxlabel()
    assert figure.axes[0].get_title("left").replace("\n", " ").startswith(("a path " * 60).strip())
    assert title.replace("\n", "").startswith("W" * 200)
    assert title.replace("\n", " ").endswith(r" \$x_1\$ ? 名")
    assert footer.endswith(NOTICE)
    assert not any("…" in text for text in texts(figure))


# --- runs of contact ---


def fits(*runs: InteractionEstimate) -> list[Axes]:
    return draw_fits(runs, Counter(map(state, runs)), "clip").axes


def observed(axes: Axes) -> np.ndarray:
    """Times and displacements with error bars, shape [2, n]."""
    (bars,) = axes.containers
    return bars.lines[0].get_xydata().T


def test_a_fit_shows_observation_simulation_and_release() -> None:
    (axes,) = fits(GOOD)
    assert to_rgb(axes.texts[0].get_color()) == pytest.approx(color_of("determined"))
    noise = "observed, 90 % interval of the noise"
    assert legend(axes) == ["simulated with the fit", "far from the observed one", "release, 0.160 s", noise]
    np.testing.assert_allclose(observed(axes), (CONTACT.observation.times, np.zeros(8)))
    np.testing.assert_allclose(curve(axes, "simulated with the fit"), ([0.0, 0.32], [0.0, 0.02]))
    assert curve(axes, "release, 0.160 s")[0] == pytest.approx(0.16)
    (bars,) = axes.collections
    assert to_rgb(bars.get_color()[0]) == pytest.approx(to_rgb(OBSERVED))
    np.testing.assert_allclose([bar[:, 1] for bar in bars.get_segments()], [[-0.001 * NINETY, 0.001 * NINETY]] * 8)
    assert axes.get_xlabel() == "time since the first frame in contact [s]"
    assert axes.get_ylabel() == "displacement along the force\n[scene units (normalised)]"


def test_motion_is_drawn_along_the_force() -> None:
    """F < 0 presses against the normal, so motion against it is positive."""
    pressed = CONTACT.observation.moved(-0.02 * np.tile(CONTACT.direction, (8, 1)), 0.001)
    seen = dataclasses.replace(GOOD, interaction=dataclasses.replace(CONTACT, observation=pressed))
    np.testing.assert_allclose(observed(*fits(seen))[1], np.full(8, 0.02), rtol=1e-6)
    pulled = dataclasses.replace(seen, estimate=dataclasses.replace(ESTIMATE, theta=np.array([0.5, 0.06, 0.1])))
    np.testing.assert_allclose(observed(*fits(pulled))[1], np.full(8, -0.02), rtol=1e-6)


@pytest.mark.parametrize(
    ("observed_mm", "far"),
    [
        ([2.5, 5, 7.5, 10, 12.5, 15, 17.5, 20], []),
        ([4.9, 2.6, 7.5, 10, 12.5, 15, 17.5, 20], []),  # a factor of nearly two
        ([2.5, 5, 7.5, 4.9, 12.5, 15, 36, -20], [3, 6, 7]),
        ([1.0, 5, 7.5, 10, np.nan, 15, 17.5, 20], []),  # by less than twice the noise, and not seen
    ],
)
def test_a_fit_that_is_far_from_the_motion_says_where(observed_mm: list[float], far: list[int]) -> None:
    """The simulated motion rises by 2.5 a frame."""
    places = -1e-3 * np.array(observed_mm)[:, None] * CONTACT.direction
    run = dataclasses.replace(
        GOOD, interaction=dataclasses.replace(CONTACT, observation=CONTACT.observation.moved(places, 0.001))
    )
    (axes,) = fits(run)
    assert ("far from the observed one" in legend(axes)) == bool(far)
    sentence = f"more than twice or less than half the observed one on {len(far)} of 8 frames (×)."
    assert (sentence in axes.get_title("left").replace("\n", " ")) == bool(far)
    if far:
        crosses = curve(axes, "far from the observed one")
        np.testing.assert_allclose(crosses, (0.04 * (np.array(far) + 1), 0.0025 * (np.array(far) + 1)), rtol=1e-6)


@pytest.mark.parametrize(
    ("load_steps", "delays", "told"),
    [
        (LOAD_STEPS, (), ["release, 0.160 s"]),
        (LOAD_STEPS, (-0.01, -0.02), ["release, 0.140 s"]),
        (MECHANICS.steps, (-0.01,), []),
        (MECHANICS.steps - 1, (), []),  # after the last observation
    ],
)
def test_a_release_is_told_where_one_was_seen(load_steps: int, delays: tuple[float, ...], told: list[str]) -> None:
    press = dataclasses.replace(CONTACT.load, factor=held(load_steps, MECHANICS.steps))
    contact = dataclasses.replace(CONTACT, load=press)
    estimate = dataclasses.replace(ESTIMATE, delays=delays)
    (axes,) = fits(dataclasses.replace(GOOD, interaction=contact, estimate=estimate))
    assert legend(axes)[2:-1] == told


def test_a_fit_tells_the_verdict_first_and_no_number_surer_than_it() -> None:
    (axes,) = fits(GOOD)
    values = "k_s 0.5 ± 0.083, k_d 0.06 ± 0.02, |F| 0.1 ± 0.0082"
    assert heading(axes) == f"determined: contact from frame 7 (0.280 s), {values}"
    told = "Misfit 1.1 (1: it fits); F (to a factor of 1.09), k_s (to a factor of 1.18), k_d (to a factor of 1.39) "
    told += "are determined. Ranges and ± are 90 % intervals."
    assert axes.get_title("left").replace("\n", " ").endswith(told)
    (doubted,) = fits(dataclasses.replace(GOOD, detail="It does not fit."))
    assert to_rgb(doubted.texts[0].get_color()) == pytest.approx(color_of("doubtful"))
    assert heading(doubted).startswith("determined, but doubtful: contact")
    assert heading(doubted).replace("\n", " ").endswith("k_s 0.42 to 0.59, k_d 0.043 to 0.083, |F| 0.092 to 0.11")
    assert doubted.get_title("left").startswith("It does not fit. The simulated displacement is more than")
    assert doubted.get_title("left").endswith("Ranges and ± are 90 % intervals.")
    loose = dataclasses.replace(GOOD, estimate=dataclasses.replace(ESTIMATE, covariance=np.eye(3)))
    assert heading(fits(loose)[0]).startswith("undetermined: contact from frame 7 (0.280 s), k_s 0.097")


def test_a_grip_shows_how_the_force_changes_and_names_no_other_number() -> None:
    (axes,) = fits(dataclasses.replace(NONE, grip=GRIP, detail="No onset."))
    assert heading(axes) == "relative force: contact from frame 1 (0.000 s)"
    assert to_rgb(axes.texts[0].get_color()) == pytest.approx(color_of("relative_force"))
    told = "Skill 0.60 in frames that were not fitted (1: exact). No k_s, k_d or |F|."
    assert axes.get_title("left").startswith(told)
    np.testing.assert_allclose(curve(axes, "force along that of the last frame"), (GRIP.times, GRIP.times / 3))
    assert extent(axes.collections[0]).y1 == pytest.approx(1.0)


def test_a_contact_without_estimate_says_why_without_axes() -> None:
    reason = "The onset of the contact was not seen. " * 9
    first, second = fits(GOOD, dataclasses.replace(NONE, detail=reason))
    assert first.axison
    assert not second.axison
    assert heading(second) == "no estimate: contact from frame 1 (0.000 s)"
    assert second.get_title("left").replace("\n", " ") == reason.strip()


def test_the_picture_counts_the_runs_that_are_not_drawn() -> None:
    figure = draw_fits([GOOD, NONE], Counter({"determined": 1, "no_estimate": 1}), "clip")
    assert [bool(axes.lines) for axes in figure.axes] == [True, False]
    assert figure.get_supxlabel().startswith("Runs of contact: 2, with an estimate: 1.\n")
    runs = [GOOD] + [NONE] * (MOST_PANELS - 1)
    figure = draw_fits(runs, Counter({"determined": 1, "no_estimate": MOST_PANELS}), "clip")
    assert len(figure.axes) == MOST_PANELS
    assert f" {MOST_PANELS} are drawn, interactions.csv has all." in figure.get_supxlabel()
    (empty,) = fits()
    assert heading(empty) == "no contact was found"
    assert not empty.axison


def test_a_field_that_was_found_is_told_and_shown() -> None:
    run = dataclasses.replace(NONE, field=PULL, detail=PULL.explanation)
    assert run.verdict == "stiffness_ratios"
    axes, _ = fits(run)
    assert heading(axes) == "stiffness ratios, 75% of the motion explained: contact from frame 1 (0.000 s)"
    assert to_rgb(axes.texts[0].get_color()) == pytest.approx(color_of("stiffness_ratios"))
    assert "leaves 25% of the motion; stiffness is determined at 75% of the particles" in axes.get_title("left")
    motion, picture = axes.child_axes
    np.testing.assert_allclose(curve(motion, "observed"), (TIMES, [0, 2, 5]))
    np.testing.assert_allclose(curve(motion, "simulated, moved by the instrument alone"), (TIMES, [0, 1.5, 4.2]))
    assert extent(motion.collections[0]).y1 == pytest.approx(1.0)
    np.testing.assert_array_equal(picture.images[0].get_array(), PULL.picture)
    arrows = [(item.get_offsets().tolist(), item.U.tolist(), item.V.tolist()) for item in picture.collections]
    assert arrows == [([[10.0, 10.0]], [3.0], [4.0]), ([[10.0, 10.0]], [3.0], [3.0])]
    figure = draw_fits([run], Counter({"stiffness_ratios": 1}), "clip")
    assert figure.get_supxlabel().startswith("Runs of contact: 1, with an estimate: 1.")


def test_below_a_field_are_its_course_and_its_map() -> None:
    _, below = fits(dataclasses.replace(NONE, field=PULL))
    shares, course, mapped = below.child_axes
    np.testing.assert_allclose(curve(shares, "motion explained so far"), (TIMES[1:], [0.7, 0.75]))
    np.testing.assert_allclose(curve(shares, "particles determined against stretch"), (TIMES, [0, 0.5, 0.75]))
    np.testing.assert_allclose(curve(course, "against stretch, median"), (TIMES[1:], [3, 4]))
    (triangles,) = mapped.collections
    assert len(triangles.get_paths()) == 1  # of two, since a corner of the other one isn't known
    np.testing.assert_allclose(triangles.get_array(), [1.0])
    nothing = dataclasses.replace(FIELD_SEEN, known=np.zeros(4, bool), skill=0.2)
    run = dataclasses.replace(NONE, field=dataclasses.replace(PULL, last=nothing))
    assert run.verdict == "undetermined"
    _, below = fits(run)
    shares, mapped = below.child_axes
    assert not mapped.collections
    assert mapped.get_title("left") == "stiffness: determined nowhere"


def test_surface_errors_are_means_over_cells() -> None:
    chance = np.random.default_rng(4)
    places = chance.uniform(-40, 40, (6000, 2))
    away = np.linalg.norm(places, axis=1)
    left = np.where(away < 16, np.nan, 0.6 * np.exp(-(((away - 16) / 8) ** 2)) + chance.normal(0, 0.3, len(places)))
    figure = draw_surface_errors(places, left, 16.0, "a press of 0.5 N")
    panel, bar = figure.axes
    low, high = panel.collections[0].get_clim()
    assert (low, bar.get_ylabel()) == (-high, f"measured less simulated surface, up to {high:.2f} mm")
    assert high == pytest.approx(0.6, abs=0.15)
    assert figure.get_supxlabel().endswith(NOTICE)
    beside = (away >= 16) & (away < 24)
    assert panel.get_title() == f"{left[beside].mean():+.2f} mm next to the tool"
