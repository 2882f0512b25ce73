"""Light of drawn tissue whose motion and light are known: how well it is predicted, and what it adds to motion."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip.lattice import BEYOND, GripFrame, SheetFit, continued, lattice_springs
from palpate.estimators.records import InteractionEstimate
from palpate.evaluation.real import brightness
from palpate.evaluation.real.pulled import evaluate_pull
from tests.evaluation.real_clips import pull_clip

SIZE, SHAPE, SPACING, COUNT = np.array([256, 192]), (96, 128), 8, 12
WAYS = np.linspace(2, 12, COUNT)[:, None] * np.array([1.0, 0.4]) + np.random.default_rng(5).normal(size=(COUNT, 2))
"""Of the grip in every frame [px]."""


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(6)


def smooth(random: np.random.Generator, width: float) -> np.ndarray:
    """Noise of unit size on the lattice."""
    found = cv2.GaussianBlur(random.normal(size=SHAPE), (0, 0), width)
    return found / found.std()


def drawn() -> tuple[brightness.LitPull, np.ndarray]:
    """A sheet that is gripped at its left, without light as yet; and the displacements of its nodes [T, M, 2]."""
    points = SPACING * np.stack(np.meshgrid(np.arange(1, 31), np.arange(1, 23)), axis=-1).reshape(-1, 2).astype(float)
    nodes = continued(points, SPACING, BEYOND)
    sheet = SheetFit(len(points), len(nodes), lattice_springs(nodes, SPACING), None)
    gripped = np.hypot(points[:, 0] - 40, points[:, 1] - 96) < 28
    moved = [sheet.held(GripFrame(np.where(gripped[:, None], way, 0.0), gripped)).found.displacement for way in WAYS]
    frames = [GripFrame(each[: len(points)], gripped) for each in moved]
    nothing = np.zeros((COUNT, *SHAPE))
    return brightness.LitPull(points, SPACING, SIZE, list(range(COUNT)), frames, nothing[0], nothing), np.array(moved)


def test_light_that_goes_with_the_motion_is_predicted(random: np.random.Generator) -> None:
    """Texture that is carried along is predicted by motion alone; what also darkens as the grip moves, by light."""
    pull, moved = drawn()
    rest, shares = 0.2 * smooth(random, 3), 0.01 * smooth(random, 8)
    origins = [pull.origin(each) for each in moved]
    carried = np.array([brightness.light_at(rest, origin, SIZE) for origin in origins])
    own = [
        brightness.light_at(shares * (way @ [1.0, -0.5]), origin, SIZE)
        for way, origin in zip(WAYS, origins, strict=True)
    ]
    matt, _ = brightness.evaluate_light(replace(pull, rest=rest, light=carried))
    assert matt["skill of motion: sheet"] > 0.97
    assert matt["skill of light: nothing moves"] == pytest.approx(0, abs=1e-6)
    assert matt["skill of light: sheet"] > 0.9
    shaded, _ = brightness.evaluate_light(replace(pull, rest=rest, light=carried + own))
    assert shaded["skill of light: sheet, brightness"] > 0.9
    assert shaded["skill of light: followed motion, brightness"] > 0.9
    assert shaded["skill of light: sheet"] < 0.8
    assert shaded["skill of light: nothing moves, brightness"] < shaded["skill of light: sheet, brightness"] - 0.1
    assert shaded["skill of light over 32 px: sheet"] < 0.3
    assert shaded["skill of light over 32 px: sheet, brightness"] > 0.9
    assert shaded["skill of motion: sheet, brightness"] == pytest.approx(matt["skill of motion: sheet"], abs=0.02)


def test_noise_is_not_predicted(random: np.random.Generator) -> None:
    pull, _ = drawn()
    noise = 0.1 * random.normal(size=(COUNT, *SHAPE))
    found, figure = brightness.evaluate_light(replace(pull, light=noise))
    assert found["change of light"] == pytest.approx(0.1, rel=0.02)
    assert all(value < 1e-6 for name, value in found.items() if name.startswith("skill of light"))
    assert found["skill of motion: sheet, brightness"] <= found["skill of motion: sheet"]
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend[:2] == ["nothing moves", "nothing moves, brightness"]
    assert "frame 11, predicted by\nsheet, places, brightness" in [axes.get_title() for axes in figure.axes]


def test_light_that_tells_of_other_motion_adds_to_what_a_sheet_predicts(random: np.random.Generator) -> None:
    """Each piece of tissue moves anew in every frame, and its light says by how much: that of others doesn't."""
    pull, _ = drawn()
    pieces = random.normal(size=(COUNT, 6, 8))
    pieces -= np.median(pieces, axis=(1, 2), keepdims=True)
    light = 0.1 * np.repeat(np.repeat(pieces, 16, axis=1), 16, axis=2)
    rows, columns = (pull.points[:, [1, 0]] / 32).astype(int).T
    own = 0.5 * pieces[:, rows, columns, None] * np.array([0.6, -0.8])
    frames = [
        GripFrame(frame.moved + np.where(frame.gripped[:, None], 0, each), frame.gripped)
        for frame, each in zip(pull.frames, own, strict=True)
    ]
    found, _ = brightness.evaluate_light(replace(pull, frames=frames, light=light))
    off = {name: 1 - value for name, value in found.items()}
    assert off["skill of motion: sheet, brightness"] < 0.3 * off["skill of motion: sheet"]
    assert off["skill of motion: sheet, brightness of other places"] > 0.9 * off["skill of motion: sheet"]
    assert off["skill of motion: sheet, places, brightness"] < 0.3 * off["skill of motion: sheet, places"]


def test_too_little_light_is_a_sentence() -> None:
    pull, _ = drawn()
    light = np.full((COUNT, *SHAPE), np.nan)
    light[:, :20, :20] = 0.0
    with pytest.raises(NoEstimate, match="fewer than 500 places of tissue that is predicted"):
        brightness.evaluate_light(replace(pull, light=light))


def test_shares_are_those_of_the_first_half_place_by_place(random: np.random.Generator) -> None:
    drivers = random.normal(size=(10, 40, 2))
    shares = random.normal(size=(40, 2, 3))
    values = np.einsum("tpk,pkc->tpc", drivers, shares)
    values[:, 7] = np.nan
    values[5:, 8] = 1e6  # of the later half
    found = brightness.by_place(drivers, values, 5)
    others = np.arange(40) > 8
    left = (found - values)[:, others]
    assert np.sqrt(np.square(left).mean()) < 0.02 * values[:, others].std()
    assert (found[:, 7] == 0).all()
    np.testing.assert_allclose(found[5:, 8], drivers[5:, 8] @ shares[8], atol=0.2)


def test_nothing_is_expected_where_shares_don_t_last(random: np.random.Generator) -> None:
    drivers = random.normal(size=(10, 400, 1))
    values = drivers.copy()
    values[3:5] *= -1  # the last third of the first half
    assert brightness.by_place(drivers, drivers, 5).any()
    assert not brightness.by_place(drivers, values, 5).any()


def test_skill_of_light_is_one_less_error_over_change_without_the_gain() -> None:
    change = np.array([-0.3, -0.1, 0.0, 0.1, 0.3])
    assert brightness.light_skill(0.25 * change + 7, change - 2) == pytest.approx(0.25)
    assert brightness.light_skill(0 * change, change) == 0
    assert brightness.light_skill(-change, change) == pytest.approx(-1)


def test_wide_means_hide_texture_and_keep_what_is_wide() -> None:
    texture = np.where(np.indices((60, 80)).sum(axis=0) % 2, 1.0, -1.0)
    texture[20:25, 30:40] = np.nan
    width = np.array([6.0, 6.0])
    found = brightness.averaged(texture + 3, width)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(texture))
    assert np.nanmax(np.abs(found - 3)) < 0.1
    assert brightness.averaged(texture, 0 * width) is texture


def test_light_between_places_is_that_of_the_known_ones() -> None:
    places = brightness.lattice_places((4, 6), np.array([12, 8]))
    np.testing.assert_allclose(places[[0, -1], [0, -1]], [[0.5, 0.5], [10.5, 6.5]])
    light = places @ [1.0, 10.0]
    moved = places[1:-1, 1:-1] + [0.5, -0.25]
    np.testing.assert_allclose(brightness.light_at(light, moved, np.array([12, 8])), moved @ [1.0, 10.0], atol=0.2)
    light[1, 2] = np.nan
    found = brightness.light_at(light, places + np.array([0.5, 0.0]), np.array([12, 8]))
    assert np.isnan(found[1, 2])  # mostly the unknown one
    assert found[1, 1] == pytest.approx(light[1, 1])  # of it alone


def test_the_frames_are_those_that_the_session_judges_and_lie_in_the_view_at_rest(tmp_path: Path) -> None:
    """Of a camera that moves by up to 7 px."""
    clip = pull_clip(tmp_path, np.linspace(0, 3, 9), camera=(2.0, -1.0))
    run = evaluate_pull(clip, {}).run
    read = brightness.read_light(clip, run)
    assert run.grip is not None
    assert len(read.frames) == len(run.grip.times) == len(read.light)
    found, _ = brightness.evaluate_light(read)
    assert found["skill of motion: sheet"] == pytest.approx(run.grip.skill)
    assert found["skill of light: sheet, places"] > 0.5
    with pytest.raises(NoEstimate, match="In 0 frames enough light of tissue is visible; 6 are needed"):
        brightness.read_light(clip, InteractionEstimate(0, 0, 0.0))
