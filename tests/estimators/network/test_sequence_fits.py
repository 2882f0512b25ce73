"""Sequences as material of the posterior's training: their information, pull, errors, and what unknown delays leave."""

import numpy as np
import pytest

from palpate.data.contact.features import SLOTS
from palpate.data.contact.sequence_features import SHAPES, dent_shapes, motion_in_sequence, shape_amounts
from palpate.data.synthetic.contacts import draw_contacts, hidden_by_tool
from palpate.data.synthetic.settings import SceneSettings
from palpate.estimators.direct.problem import dent_problem
from palpate.estimators.network import fits
from palpate.estimators.network.fits import FRAME_S, MECHANICS, PARAMETERS, DepthSequences, draw_sequence_errors
from palpate.physics.depth import REACH, smooth_errors

PIXELS = (2 * REACH + 1) ** 2


def random_sequences(count: int = 3) -> DepthSequences:
    """Depth-change sequences of mixed shapes, a tool in a part of each frame."""
    generator = np.random.default_rng(0)
    change = 0.02 * generator.normal(size=(count, SLOTS, SHAPES)) @ dent_shapes().T
    hidden = np.stack([[hidden_by_tool(generator).ravel() for _ in range(SLOTS)] for _ in range(count)])
    hidden[:, SLOTS // 2 :] = 0
    change = change + hidden
    amounts, factors = shape_amounts(change.reshape(-1, PIXELS))
    amounts, factors = amounts.reshape(count, SLOTS, SHAPES), factors.reshape(count, SLOTS, SHAPES, SHAPES)
    slopes = 0.01 * generator.normal(size=(count, SLOTS, SHAPES, PARAMETERS))
    return DepthSequences(change.astype(np.float16), amounts, slopes, factors, -change[..., PIXELS // 2])


def test_sequence_information_is_that_of_the_whole_covariance() -> None:
    """All slots are visible at once, with the rest surface's error the same in all of them."""
    sequences, generator = random_sequences(), np.random.default_rng(1)
    noise = np.array([1e-3, 5e-4, 3e-3])
    errors = 1e-3 * generator.normal(size=sequences.amounts.shape)
    known = (np.arange(SLOTS) < np.array([[SLOTS], [7], [2]])).astype(float)
    information, pull = fits.sequence_information(sequences.amount_slopes, sequences.factors, errors, noise, known)
    smooth = dent_shapes().T @ smooth_errors()
    for index, seen in enumerate(known.sum(axis=1).astype(int)):
        covariance = np.kron(np.ones((seen, seen)), smooth @ smooth.T)
        for slot in range(seen):
            part = slice(slot * SHAPES, (slot + 1) * SHAPES)
            covariance[part, part] += sequences.factors[index, slot] @ sequences.factors[index, slot].T
        covariance *= noise[index] ** 2
        slopes = sequences.amount_slopes[index, :seen].reshape(-1, PARAMETERS)
        whole = slopes.T @ np.linalg.solve(covariance, slopes)
        np.testing.assert_allclose(information[index], whole, rtol=1e-6, atol=1e-7 * whole.max())
        expected = slopes.T @ np.linalg.solve(covariance, errors[index, :seen].ravel())
        np.testing.assert_allclose(pull[index], expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


def test_the_rest_surfaces_share_is_that_of_its_columns() -> None:
    smooth = dent_shapes().T @ smooth_errors()
    np.testing.assert_allclose(fits.smooth_share() @ fits.smooth_share().T, smooth @ smooth.T, atol=1e-11)


@pytest.mark.parametrize("count", [1, 2])
def test_without_delays_is_the_schur_complement(count: int) -> None:
    """And its pull moves φ where that of all parameters, with the delays' prior about 0, does."""
    generator = np.random.default_rng(2)
    slopes = generator.normal(size=(4, 30, 3 + count))
    errors, delays = generator.normal(size=(4, 30)), generator.uniform(-0.5, 0.5, (4, count))
    information = np.einsum("bkp,bkq->bpq", slopes, slopes)
    pull = np.einsum("bkp,bk->bp", slopes, errors)
    found, pulled = fits.without_delays(information, pull, delays)
    prior = 12 / fits.DELAY_RANGE**2
    for index in range(4):
        weighed = information[index] + np.diag([0.0] * 3 + [prior] * count)
        np.testing.assert_allclose(np.linalg.inv(found[index]), np.linalg.inv(weighed)[:3, :3], rtol=1e-9)
        # The optimum of ½|slopes·d - errors|² + ½·prior·|delays + d's|², in φ.
        optimum = np.linalg.solve(weighed, pull[index] - np.concatenate([np.zeros(3), prior * delays[index]]))
        np.testing.assert_allclose(np.linalg.solve(found[index], pulled[index]), optimum[:3], rtol=1e-8)


def test_drawn_errors_have_the_covariance_of_the_pixels() -> None:
    """Errors of amounts, and of the middle pixel with them: as least squares of noisy pixels have them."""
    sequences, count, sigma = random_sequences(1), 3000, 2e-3
    amounts, alone = draw_sequence_errors(
        sequences, np.zeros(count, int), np.full(count, sigma), np.random.default_rng(3)
    )
    shapes = dent_shapes()
    middle, still = shapes[PIXELS // 2], fits.smooth_share() @ fits.smooth_share().T
    for slot in (0, SLOTS - 1):
        spread = sequences.factors[0, slot] @ sequences.factors[0, slot].T
        values = np.column_stack([amounts[:, slot], alone[:, slot]]) / sigma
        expected = np.zeros((SHAPES + 1, SHAPES + 1))
        expected[:SHAPES, :SHAPES] = spread + still
        # A pixel's error is as large as the noise, and goes with the amounts that it is a part of.
        expected[:SHAPES, -1] = expected[-1, :SHAPES] = (spread + still) @ middle
        expected[-1, -1] = 1 + middle @ still @ middle
        sizes = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(np.cov(values.T) / sizes, expected / sizes, atol=0.1)
    # The rest surface's is the same in all frames.
    first, last = amounts[:, 0] / sigma, amounts[:, -1] / sigma
    np.testing.assert_allclose(first.T @ last / count, still, atol=0.1)


def test_drawn_rounding_is_that_of_the_pixels() -> None:
    """No error is larger than half a step; amounts hold no more of it than noise of its size would bring."""
    sequences, count = random_sequences(2), 60
    index = np.arange(count) % 2
    amounts, alone = draw_sequence_errors(
        sequences, index, np.full(count, fits.ROUNDING_NOISE), np.random.default_rng(4)
    )
    rest = 0.5 * fits.ROUNDING_NOISE
    assert np.abs(alone).max() < fits.LEVEL / 2 + rest
    assert np.abs(alone).max() > 0.9 * fits.LEVEL / 2
    assert alone.std() == pytest.approx(fits.ROUNDING_NOISE, rel=0.1)
    assert np.sqrt(np.square(amounts[..., 0]).mean()) == pytest.approx(fits.ROUNDING_NOISE, rel=0.15)


@pytest.mark.parametrize("within", [FRAME_S, 0.0])
def test_an_exact_sequence_is_explained(within: float) -> None:
    """Sequence of a contact of one scene, the instants of whose press are known to a frame, or exactly."""
    settings = SceneSettings(width=214, height=120, regime="critical")
    (drawn,) = draw_contacts(settings, 5, 1, MECHANICS.time_step, within, sequence=True)
    start, contact = np.log(np.abs(drawn.theta)), drawn.interaction
    logs, slopes, rms, change, amounts, tangents, factors, middle = fits.fit_sequence((contact, start, within))
    np.testing.assert_allclose(logs[:3], start, atol=0.05)
    assert rms < 2e-4
    assert (logs.shape, slopes.shape) == ((PARAMETERS,), (SLOTS, PARAMETERS))
    assert (change.dtype, change.shape) == (np.float16, (SLOTS, PIXELS))
    seen = contact.sequence.change.reshape(SLOTS, -1)
    np.testing.assert_allclose(change, seen, atol=5e-5)
    expected, spread = shape_amounts(np.where(np.isfinite(change), seen, np.nan))
    np.testing.assert_allclose(amounts, expected, atol=2e-4)
    np.testing.assert_allclose(factors, spread)
    np.testing.assert_allclose(middle, -(motion_in_sequence(contact) @ contact.direction), atol=1e-6)
    if not within:
        assert not logs[3:].any()
        assert not slopes[:, 3:].any()
        assert not tangents[..., 3:].any()
    # Of the amounts, derivatives are those of what the pixels show.
    field = dent_problem(contact, MECHANICS, within, fits.NOMINAL_NOISE)
    own = logs[: 5 if within else 3]
    field.look(own)
    for column, step in enumerate(1e-4 * np.eye(len(own))[:3]):
        ends = (field.first.change(field.motion.at(at)[0], at) for at in (own + step, own - step))
        up, down = (shape_amounts(np.where(field.first.seen, end, np.nan))[0] for end in ends)
        found = (up - down) / 2e-4
        np.testing.assert_allclose(tangents[..., column], found, atol=2e-5 * np.abs(found).max())
