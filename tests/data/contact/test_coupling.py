"""What one step tells of contact, against closed forms and a brute-force twin, and what a mask's leak doesn't fake."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from palpate.data.contact import coupling as module
from palpate.data.contact.coupling import MIN_POINTS, TipMotion, log_ratio

WAY = np.array([3.0, -1.0])


def ring(coupling: float = 0.0, reach: float = 80.0, *, tool: np.ndarray = WAY, leak: float = 0.0) -> TipMotion:
    """Points on a grid around a tip, with noise of 0.1 px; those nearer than `leak` move as the tool does."""
    column, row = np.meshgrid(np.arange(-108.0, 109, 8), np.arange(-108.0, 109, 8))
    distance = np.hypot(column, row).ravel() - 8
    distance = distance[(distance > 0) & (distance < 100)]
    share = np.where(distance < leak, 1.0, coupling * np.exp(-distance / reach))
    noise = np.random.default_rng(0).normal(0, 0.1, (len(distance), 2))
    return TipMotion(share[:, None] * tool + noise, distance, 8.0, tool, 0.05, 0.1, 0.1)


@pytest.mark.parametrize("coupling", [0.5, 0.7, 1.0])
@pytest.mark.parametrize("reach", [30.0, 60.0, 200.0])
def test_tissue_that_moves_with_the_tool_is_told_from_tissue_that_does_not(coupling: float, reach: float) -> None:
    assert log_ratio(ring(coupling, reach)) > 3
    assert log_ratio(ring()) < -3


def test_a_tool_that_does_not_move_tells_nothing() -> None:
    still = ring(tool=np.zeros(2))
    assert abs(log_ratio(still)) < 1
    # Nor one that moves no farther than the background's motion is known.
    assert abs(log_ratio(dataclasses.replace(ring(tool=WAY / 10), background_sd=1.0))) < 0.5


def test_too_few_points_tell_nothing() -> None:
    few = ring()
    few = dataclasses.replace(few, moved=few.moved[: MIN_POINTS - 1], distance=few.distance[: MIN_POINTS - 1])
    assert log_ratio(few) == 0.0


@pytest.mark.parametrize("leak", [8.0, 16.0, 24.0])
def test_tool_pixels_that_a_mask_leaves_to_the_tissue_do_not_fake_contact(leak: float) -> None:
    leaky = ring(leak=leak)
    assert (np.linalg.norm(leaky.moved - WAY, axis=1) < 0.5).sum() > 4
    assert log_ratio(leaky) < -3


def test_tissue_that_all_moves_alike_is_an_error_of_the_background() -> None:
    """Equal motion of all points beside the tool, of the size of the background's error, speaks for nothing."""
    still = ring()
    carried = dataclasses.replace(still, moved=still.moved + np.array([0.5, 0.0]), background_sd=0.5)
    assert log_ratio(carried) < 0
    assert log_ratio(dataclasses.replace(ring(1.0), background_sd=0.5)) > 3


def test_it_is_the_ratio_of_marginal_likelihoods() -> None:
    """A brute-force twin: every sum written out."""
    reaches, couplings = (40.0, 80.0, 160.0), (0.4, 0.6, 0.8, 1.0)
    observed = ring(0.6)
    observed = dataclasses.replace(observed, moved=observed.moved[:20], distance=observed.distance[:20], tool_sd=0.3)
    weight = (observed.spacing / module.CORRELATION_LENGTH) ** 2
    own = observed.noise**2 + observed.background_sd**2

    def density(off: np.ndarray, variance: np.ndarray | float) -> np.ndarray:
        """Density of every point's [20, 2]."""
        return np.exp(-np.square(off).sum(axis=1) / (2 * variance)) / (2 * math.pi * variance)

    axis = np.array([-1.8, -0.9, 0.0, 0.9, 1.8])
    gauss = np.exp(-np.square(axis) / 2) / np.exp(-np.square(axis) / 2).sum()
    held, apart = 0.0, 0.0
    for one, two in itertools.product(range(5), repeat=2):
        error = observed.background_sd * axis[[one, two]]
        prior, tool, moved = gauss[one] * gauss[two], observed.tool - error, observed.moved - error
        way = tool @ tool
        leaked = density(moved - tool, own + observed.tool_sd**2 + module.TOOL_SPREAD**2 * way)
        plain = (1 - module.LEAKED - module.OUTLIERS) * density(moved, own)
        still = plain + module.LEAKED * leaked + module.OUTLIERS * density(moved, 4 * (own + way))
        apart += prior * math.exp(weight * np.log(still).sum())
        for three, reach, coupling in itertools.product(range(5), reaches, couplings):
            longer = 1 + axis[three] * observed.tool_sd / math.sqrt(way)
            share = coupling * np.exp(-observed.distance / reach) * longer
            found = density(moved - share[:, None] * tool, own + (module.HELD_SPREAD * share) ** 2 * way)
            total = np.log(module.HELD * found + (1 - module.HELD) * still).sum()
            held += prior * gauss[three] / 12 * math.exp(weight * total)
    assert log_ratio(observed) == pytest.approx(math.log(held / apart), abs=1e-9)
