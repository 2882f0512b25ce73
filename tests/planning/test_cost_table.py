"""The table of presses: symmetry, the kernel between them, the cache."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from palpate.common.output import ForeignFile
from palpate.planning import cost_table
from palpate.planning.cost_table import (
    ANGLES,
    PLACES,
    CostTable,
    digest,
    grid_of,
    mirrored,
    open_table,
    representatives,
)
from palpate.planning.press import PressCurve, simulate_press
from palpate.planning.scene import SoftObject
from tests.planning.cases import quick_press

CURTAIN = SoftObject(size=(0.04, 0.006, 0.05), young=2e4, cells=(4, 1, 3), longest=0.01)


def smooth_press(kind: SoftObject, radius: float, place: np.ndarray, angle: float) -> PressCurve:
    """Dearer in the middle and head on; nothing is simulated."""
    known = quick_press(kind, radius, place, angle)
    middle = np.exp(-((place[0] / kind.size[0]) ** 2))
    return dataclasses.replace(known, work=known.work * middle * (1 + np.sin(angle) ** 2))


def works(places: np.ndarray, angles: np.ndarray) -> np.ndarray:
    return np.array([smooth_press(CURTAIN, 0.005, *each).work for each in zip(places, angles, strict=True)])


def test_a_quarter_of_the_presses_tells_all_of_a_block_that_is_held_alike() -> None:
    whole = PLACES * len(ANGLES) + 2 * len(ANGLES)
    places, angles = grid_of(CURTAIN)
    assert len(places) == whole
    alike = representatives(CURTAIN, places, angles)
    assert len(np.unique(alike)) == 46  # of the front half, and half of what is in the middle or at an end
    np.testing.assert_allclose(works(places[alike], angles[alike]), works(places, angles), rtol=1e-9)
    leaning = dataclasses.replace(CURTAIN, held=("top", "left"))
    # Seen from behind alone.
    assert len(np.unique(representatives(leaning, places, angles))) == PLACES * len(ANGLES) + 2 * 5


@pytest.mark.slow
def test_mirror_images_cost_the_same_when_they_are_simulated() -> None:
    """But for the diagonals of the mesh, which are no mirror images."""
    place, angle = np.array([-0.012, -0.003]), np.pi / 2 + 0.4
    one = simulate_press(CURTAIN, 0.005, place, angle).work[-1]
    for image, way in cost_table._images(CURTAIN, place, angle)[1:]:
        assert simulate_press(CURTAIN, 0.005, image, way).work[-1] == pytest.approx(one, rel=0.05)


def test_between_presses_the_kernel_is_the_paper_s() -> None:
    """Frank 2010, equation 4, by hand; along the length linear."""
    places, angles = np.array([[0.0, -0.003], [0.01, -0.003]]), np.full(2, np.pi / 2)
    work = np.array([[0.0, 1.0, 2.0], [0.0, 3.0, 6.0]])
    table = CostTable(places, angles, np.array([0.0, 0.01, 0.02]), work, 0.01)
    at = np.array([[0.004, -0.003]])
    weights = np.exp(-np.square(np.array([0.4, 0.6]) / cost_table.WIDTH) / 2)
    wanted = weights @ [1.5, 4.5] / weights.sum()
    assert table.cost(at, angles[:1], np.array([0.015])) == pytest.approx(wanted)
    assert table.cost(*mirrored(at * [1, -1], -angles[:1]), np.array([0.015])) == pytest.approx(wanted)
    assert table.cost(at, angles[:1], np.array([0.7])) == pytest.approx(weights @ [2, 6] / weights.sum())


def test_a_smooth_cost_is_met_between_the_presses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost_table, "simulate_press", smooth_press)
    table, simulated = open_table(CURTAIN, 0.005, tmp_path)
    assert simulated == 46
    chance = np.random.default_rng(0)
    x, angles = chance.uniform(-0.018, 0.018, 50), np.pi / 2 + chance.uniform(-0.9, 0.9, 50)
    places = np.column_stack([x, np.full(50, -0.003)])
    found = table.cost(places, angles, np.full(50, 0.008))
    np.testing.assert_allclose(found, 0.8 * works(places, angles)[:, -1], rtol=0.08)


def test_a_second_scene_with_the_same_block_finds_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost_table, "simulate_press", smooth_press)
    first, _ = open_table(CURTAIN, 0.005, tmp_path)
    again, simulated = open_table(CURTAIN, 0.005, tmp_path)
    assert simulated == 0
    assert open_table(CURTAIN, 0.006, tmp_path)[1] > 0
    np.testing.assert_array_equal(first.work, again.work)
    assert digest(dataclasses.replace(CURTAIN, young=3e4), 0.005) != digest(CURTAIN, 0.005) != digest(CURTAIN, 0.006)
    path = tmp_path / f"presses-{digest(CURTAIN, 0.005)}.npz"
    path.write_bytes(b"mine")
    with pytest.raises(ForeignFile):
        open_table(CURTAIN, 0.005, tmp_path)
