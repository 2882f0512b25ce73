"""The scenes of the path tracer, without the path tracer: their motion, their instruments, their sentences."""

import sys

import numpy as np
import pytest

from benchmarks.path_tracer import DISTANCE, FPS, FRAMES, GRID, TIPS, drawn, instrument, main, texture, tissue_motion
from palpate.data.source.camera import back_project
from palpate.data.source.layout import InputError


def flat() -> np.ndarray:
    return DISTANCE * back_project(np.ones((GRID.height, GRID.width)), GRID).astype(np.float64)


def test_a_press_dents_as_deep_as_wanted_while_it_lasts_and_its_surroundings_rest() -> None:
    case = drawn(np.random.default_rng(3), hovers=False)
    moved, force, normal = tissue_motion(case, flat())
    column, row = case["pixel"]
    depth, times = -moved[:, row, column] @ normal, np.arange(FRAMES) / FPS
    assert force < 0
    assert (depth[times < case["onset_s"]] == 0).all()
    pressed = depth[(times > case["onset_s"] + 0.05) & (times < case["release_s"])]
    assert 0.8 * case["depth"] * DISTANCE < pressed.max() <= case["depth"] * DISTANCE + 1e-6
    assert depth[-1] < 0.6 * pressed.max()
    assert np.abs(moved[:, :20]).max() < 0.01 * pressed.max()


def test_an_instrument_that_hovers_moves_nothing() -> None:
    moved, force, _ = tissue_motion(drawn(np.random.default_rng(3), hovers=True), flat())
    assert force == 0
    assert not moved.any()


@pytest.mark.parametrize("tip", TIPS)
def test_instruments_are_as_wide_as_their_profile_says(tip: str) -> None:
    vertices, triangles = instrument(tip)
    radii = np.hypot(vertices[:, 1], vertices[:, 2])
    for place, radius in TIPS[tip]:
        np.testing.assert_allclose(radii[vertices[:, 0] == place], radius)
    assert triangles.min() == 0
    assert triangles.max() == len(vertices) - 1


def test_tissue_is_red_and_differs_by_its_seed() -> None:
    one, other = (texture(np.random.default_rng(seed)) for seed in (1, 2))
    assert one.shape == (900, 1600, 3)
    assert np.median(one[..., 0] / one[..., 1]) > 2
    assert np.abs(one - other).mean() > 0.02
    np.testing.assert_array_equal(one, texture(np.random.default_rng(1)))


def test_without_the_path_tracer_it_is_one_sentence(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(InputError, match="pip install mitsuba"):
        main(["--output", str(tmp_path)])
