"""Drawn brightness sequences: what is drawn again, errors of known size, and a coder that leaves small changes out."""

import numpy as np
import pytest

from palpate.data.brightness.sequence import SIDE
from palpate.data.contact.features import SLOTS
from palpate.data.contact.light_features import SHAPES
from palpate.estimators.network import light_draws as module
from palpate.estimators.network.light_draws import LightDraws, as_coded, draw_light, noise_factors, persistent
from palpate.physics.mechanics import RECOMMENDED


@pytest.fixture(scope="module")
def drawn() -> LightDraws:
    found = draw_light(3)
    assert found is not None
    return found


def test_a_sheet_is_drawn_again_by_its_seed_within_the_admissible_box(drawn: LightDraws) -> None:
    again, other = draw_light(3), draw_light(4)
    assert again is not None
    assert other is not None
    np.testing.assert_array_equal(again.slots.amounts, drawn.slots.amounts)
    assert len(drawn.slots) == len(drawn.logs) == module.MOTIONS * module.LIGHTS * module.CODINGS
    for values, (low, high) in ((drawn.logs, RECOMMENDED.log_box), (drawn.slots.distance, module.DISTANCES)):
        assert ((low <= values) & (values <= high)).all()
    assert not np.array_equal(other.logs, drawn.logs)
    # The sequences of one press share its parameters, and no two are equal.
    assert len(np.unique(drawn.logs, axis=0)) == module.MOTIONS
    assert len(np.unique(drawn.slots.amounts[:, -1, 0])) == len(drawn.logs)


def test_pressed_tissue_darkens_and_the_instrument_hides_part_of_it_until_it_leaves(drawn: LightDraws) -> None:
    pressed = drawn.slots.amounts[:, 3]
    assert np.median(pressed[:, :3].sum(axis=1)) < -0.05
    under, after = drawn.slots.visible[:, 0], drawn.slots.visible[:, 1]
    assert (after >= under - 1e-9).mean() > 0.95
    assert under[:, 1].mean() < 0.8 < after[:, 1].mean()


@pytest.mark.parametrize(("spread", "kept"), [(0.0, 0.0), (2.0, 0.9)])
def test_errors_are_as_large_and_as_persistent_as_asked_for(spread: float, kept: float) -> None:
    found = np.stack([persistent(np.random.default_rng(seed), 0.02, spread, kept) for seed in range(30)])
    assert found.std() == pytest.approx(0.02, rel=0.05)
    assert np.corrcoef(found[:, :-1].ravel(), found[:, 1:].ravel())[0, 1] == pytest.approx(kept, abs=0.03)
    # Two normal fields smoothed by s correlate by exp(-1/(4 s²)) from place to place.
    near = np.corrcoef(found[..., :-1].ravel(), found[..., 1:].ravel())[0, 1]
    assert near == pytest.approx(np.exp(-1 / (4 * spread**2)) if spread else 0, abs=0.03)


def test_a_coder_follows_large_changes_and_leaves_small_ones_out() -> None:
    generator = np.random.default_rng(0)
    change = generator.normal(0, 20, (3, SIDE, SIDE))
    fine = as_coded(change, 0.01, 0.5, generator)
    np.testing.assert_allclose(fine, change, atol=0.02)
    step = 8.0
    # A block's mean changes by eighths of the coefficients' step; what dead leaves to the next one is cut off.
    least = step / 8 * (1 - 0.25)
    even = np.ones((2, SIDE, SIDE))
    inner = np.s_[:, 4:-4, 4:-4]
    assert not as_coded(0.98 * least * even, step, 0.25, generator)[inner].any()
    np.testing.assert_allclose(as_coded(1.02 * least * even, step, 0.25, generator)[inner], step / 8)
    # What a frame left out counts towards the next.
    slow = np.linspace(0, 10, SLOTS)[:, None, None] * np.ones((SIDE, SIDE))
    coded = as_coded(slow, step, 0.25, generator)[inner]
    assert np.abs(coded - slow[inner]).max() <= least + 1e-9
    assert (np.diff(coded, axis=0) == 0).mean() > 0.3


def test_noise_factors_are_those_of_the_amounts() -> None:
    few, spread = next(noise_factors(20)), list(noise_factors(4))[-1]
    assert few.shape == (SHAPES, SHAPES)
    # Independent errors average out over a ring, and errors that neighbours share don't.
    assert np.linalg.norm(few, axis=1)[3] < 0.5 * np.linalg.norm(spread, axis=1)[3]
