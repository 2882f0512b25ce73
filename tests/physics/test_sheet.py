"""The gripped sheet at rest against closed forms and a dense solve."""

import numpy as np
import pytest

from palpate.physics.sheet import equilibrium

NODES, LINKS, AXES = 12, 25, 2


def chain(count: int) -> np.ndarray:
    return np.column_stack([np.arange(count - 1), np.arange(1, count)])


def ends(count: int) -> np.ndarray:
    held = np.zeros(count, bool)
    held[[0, -1]] = True
    return held


def tangle(seed: int = 0) -> tuple[np.ndarray, ...]:
    """A connected net of random springs of random stiffness, three of its nodes held."""
    generator = np.random.default_rng(seed)
    others = np.array([generator.choice(NODES, 2, replace=False) for _ in range(LINKS - NODES + 1)])
    springs = np.concatenate([chain(NODES), others])
    gripped = np.zeros(NODES, bool)
    gripped[[1, 6, 7]] = True
    stiffness, anchor = generator.uniform(0.2, 3, LINKS), generator.uniform(0.05, 1, NODES)
    return springs, stiffness, anchor, gripped, generator.normal(size=(3, AXES))


def dense(springs: np.ndarray, stiffness: np.ndarray, anchor: np.ndarray) -> np.ndarray:
    """K, one spring after the other."""
    matrix = np.diag(anchor)
    for (one, two), strength in zip(springs, stiffness, strict=True):
        matrix[[one, two], [one, two]] += strength
        matrix[[one, two], [two, one]] -= strength
    return matrix


def test_on_a_foundation_a_chain_is_a_hyperbolic_sine() -> None:
    """2·cosh(q) = 2 + anchor / stiffness solves the difference equation exactly."""
    count, stiffness, anchor = 15, 0.7, 0.05
    found = equilibrium(
        chain(count), np.full(count - 1, stiffness), np.full(count, anchor), ends(count), np.array([[0.0], [3.0]])
    )
    q = np.arccosh(1 + anchor / stiffness / 2)
    expected = 3 * np.sinh(q * np.arange(count)) / np.sinh(q * (count - 1))
    np.testing.assert_allclose(found.displacement[:, 0], expected, rtol=1e-12, atol=1e-12)


def test_a_dense_solve_gives_the_same() -> None:
    springs, stiffness, anchor, gripped, motion = tangle()
    found = equilibrium(springs, stiffness, anchor, gripped, motion)
    matrix = dense(springs, stiffness, anchor)
    np.testing.assert_allclose(found.matrix.toarray(), matrix, atol=1e-12)
    free = ~gripped
    expected = np.zeros((NODES, AXES))
    expected[gripped] = motion
    expected[free] = np.linalg.solve(matrix[np.ix_(free, free)], -matrix[np.ix_(free, gripped)] @ motion)
    np.testing.assert_allclose(found.displacement, expected, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(found.reaction, (matrix @ expected)[gripped], rtol=1e-10)


@pytest.mark.parametrize(("held", "told"), [(0, "0 of 5 nodes are gripped"), (5, "5 of 5 nodes are gripped")])
def test_some_nodes_must_be_held_and_some_free(held: int, told: str) -> None:
    with pytest.raises(ValueError, match=f"{told}; hold some of them and leave some free"):
        equilibrium(chain(5), np.ones(4), np.ones(5), np.arange(5) < held, np.ones((held, 2)))


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan])
@pytest.mark.parametrize("of", ["stiffness", "anchor"])
def test_stiffness_is_positive(wrong: float, of: str) -> None:
    values = {"stiffness": np.ones(4), "anchor": np.ones(5)}
    values[of][2] = wrong
    with pytest.raises(ValueError, match="a stiffness is not positive; without any a node has no place"):
        equilibrium(chain(5), **values, gripped=ends(5), motion=np.ones((2, 2)))


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_the_grip_moves_by_numbers(wrong: float) -> None:
    with pytest.raises(ValueError, match="motion of the grip holds a number that is not finite"):
        equilibrium(chain(5), np.ones(4), np.ones(5), ends(5), np.array([[0.0, 1.0], [wrong, 0.0]]))
