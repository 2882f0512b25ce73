"""How light changes, told by a few shapes: found again in what is visible, turned with the picture, cut off in time."""

import dataclasses

import numpy as np
import pytest

from palpate.data.brightness.sequence import SIDE
from palpate.data.contact import light_features as module
from palpate.data.contact.features import SLOTS, slot_times
from palpate.data.contact.light_features import SHAPES, LightSlots, light_amounts, light_shapes, light_slots, turned
from tests.lit_contacts import lit_contact

GENERATOR = np.random.default_rng(4)


def pictured(amounts: np.ndarray) -> np.ndarray:
    """Changes of light [N, L, L] that hold so much of the shapes [N, SHAPES]."""
    shapes, inner = light_shapes()
    found = np.full((len(amounts), SIDE, SIDE), np.nan)
    found[:, inner] = amounts @ shapes.T
    return found


def slots(count: int = 2) -> LightSlots:
    """Random contacts, the first released in view."""
    amounts = GENERATOR.normal(0, 0.1, (count, SLOTS, SHAPES))
    visible = GENERATOR.uniform(0.2, 1, (count, 2, module.RINGS))
    ones = np.ones(count)
    load = np.where(np.arange(count) == 0, 0.4, 2.0)
    others = load, 0.35 * ones, 160 * ones, 20 * ones, 0 * ones
    return LightSlots(amounts, 0.02 * np.ones((count, SLOTS)), visible, *others)


def test_amounts_are_found_again_but_for_the_ridge_and_half_hidden_ones_nearly() -> None:
    true = GENERATOR.normal(0, 0.05, (3, SHAPES))
    whole = light_amounts(pictured(true))
    np.testing.assert_allclose(whole.amounts, true, atol=0.02)
    np.testing.assert_allclose(whole.visible, 1, atol=1e-12)
    assert whole.left.max() < 0.01
    hidden = pictured(true)
    hidden[1:, : SIDE // 2] = np.nan
    some = light_amounts(hidden)
    np.testing.assert_array_equal(some.amounts[0], whole.amounts[0])
    assert np.abs(some.visible[1:] - 0.5).max() < 0.01
    assert some.left.max() < 0.01
    nothing = light_amounts(np.full((1, SIDE, SIDE), np.nan))
    assert not any(part.any() for part in nothing)


def test_a_turned_picture_has_turned_amounts_and_a_mirrored_one_mirrored_ones() -> None:
    change = pictured(GENERATOR.normal(0, 0.05, (4, SHAPES)))
    found = light_amounts(change).amounts
    # Columns lie along the angle 0 and rows along a quarter of a turn; rot90 turns from columns to negative rows.
    quarter = light_amounts(np.rot90(change, axes=(1, 2))).amounts
    np.testing.assert_allclose(quarter, turned(found, np.full(4, -np.pi / 2), np.zeros(4, bool)), atol=1e-9)
    flipped = light_amounts(change[:, ::-1]).amounts
    np.testing.assert_allclose(flipped, turned(found, np.zeros(4), np.ones(4, bool)), atol=1e-9)
    sequence = found[None]
    once = turned(turned(sequence, np.array([0.7]), np.array([False])), np.array([-0.7]), np.array([False]))
    np.testing.assert_allclose(once, sequence, atol=1e-12)


def test_what_is_not_known_yet_leaves_no_trace_in_the_vector() -> None:
    one = slots()
    cut = np.array([7, 7])
    before = one.vectors(cut)
    assert (before.shape, before.dtype) == ((2, module.LIGHT_FEATURES), np.float32)
    later = one.amounts.copy()
    later[:, 7:] += 1
    left = one.left.copy()
    left[:, 7:] += 1
    np.testing.assert_array_equal(dataclasses.replace(one, amounts=later, left=left).vectors(cut), before)
    # Nor does the time of a release that lies ahead, or what will be visible then.
    ahead = dataclasses.replace(one, load=np.array([0.5, 0.6]), visible=one.visible * [[[1], [0]]])
    np.testing.assert_array_equal(ahead.vectors(cut), before)
    assert not np.array_equal(ahead.vectors(np.array([SLOTS, SLOTS])), one.vectors(np.array([SLOTS, SLOTS])))


def test_unexplained_is_the_share_that_rings_leave() -> None:
    one = slots(1)
    shapes = light_shapes()[0]
    explained = np.square(one.amounts[0] @ shapes.T).mean(axis=1)
    expected = np.sqrt(np.square(one.left[0, :5]).sum() / (np.square(one.left[0, :5]) + explained[:5]).sum())
    assert one.unexplained(np.array([5]))[0] == pytest.approx(expected)
    assert dataclasses.replace(one, amounts=0 * one.amounts).unexplained(np.array([5]))[0] == pytest.approx(1)


def test_a_contacts_light_at_the_slots() -> None:
    """Amounts that grow evenly stay so, whatever the frame rate, and count as far as they were observed."""
    times = np.arange(1, 13) / 20
    amounts = times[:, None] * np.eye(SHAPES)[0]
    contact = lit_contact(times, pictured(amounts))
    found, known = light_slots(contact)
    assert known.tolist() == [15]
    wanted = light_amounts(pictured(np.eye(SHAPES)[:1])).amounts[0]
    np.testing.assert_allclose(found.amounts[0, :15], slot_times()[:15, None] * wanted, atol=1e-6)
    assert (found.load[0], found.focal[0]) == (pytest.approx(contact.load_seconds), pytest.approx(160))
    assert (found.distance[0], found.rim[0], found.step[0]) == (pytest.approx(0.4), 12, 0)
