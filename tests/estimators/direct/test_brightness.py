"""Nuisances of brightness: what a video's coding leaves out, and amplitudes that are marginalised."""

import numpy as np

from palpate.estimators.direct.brightness import coded, without_amplitude


def test_coded_light_follows_behind_changes_and_starts_anew_where_it_was_hidden():
    light = np.array([0.0, -0.01, -0.05, -0.10, -0.09, -0.06, -0.2, -0.21])[:, None, None]
    followed = np.ones((8, 1), bool)
    followed[6] = False
    found = coded(light, np.zeros(1), followed, 2.0, np.full(1, 0.01))[:, 0, 0]
    np.testing.assert_allclose(found, [0, 0, -0.03, -0.08, -0.08, -0.08, -0.2, -0.2], atol=1e-12)
    np.testing.assert_allclose(coded(light, np.zeros(1), followed, 0.0, np.full(1, 0.01)), light)


def test_what_cannot_be_predicted_is_no_light_that_stayed():
    light = np.array([-0.1, np.nan, -0.3])[:, None, None]
    found = coded(light, np.zeros(1), np.ones((3, 1), bool), 1.0, np.full(1, 0.01))[:, 0, 0]
    np.testing.assert_allclose(found, [-0.09, np.nan, -0.3], atol=1e-12)


def test_derivatives_of_coded_light():
    generator = np.random.default_rng(2)
    light, slopes = np.cumsum(generator.normal(size=(9, 40)), axis=0) * 0.02, generator.normal(size=(9, 40, 2))
    followed, level, rest = generator.random((9, 40)) > 0.2, generator.uniform(0.01, 0.02, 40), np.zeros(40)

    def at(first: float, lag: float) -> np.ndarray:
        return coded((light + first * slopes[..., 0])[..., None], rest, followed, lag, level)[..., 0]

    columns = [light[..., None], slopes[..., :1], np.zeros((9, 40, 1))]
    found = coded(np.concatenate(columns, axis=-1), rest, followed, 0.8, level)
    np.testing.assert_allclose(found[..., 0], at(0, 0.8), atol=1e-15)
    np.testing.assert_allclose(found[..., 1], (at(1e-7, 0.8) - at(-1e-7, 0.8)) / 2e-7, atol=1e-5)
    np.testing.assert_allclose(found[..., 2], (at(0, 0.8 + 1e-7) - at(0, 0.8 - 1e-7)) / 2e-7, atol=1e-5)


def test_marginalised_amplitude_is_the_inverse_of_the_whole_covariance():
    generator = np.random.default_rng(3)
    white, along = generator.normal(size=(6, 4, 2)), generator.normal(size=(6, 4, 1))
    found = without_amplitude(white, along)
    for place in range(4):
        covariance = np.eye(6) + along[:, place] @ along[:, place].T
        expected = white[:, place].T @ np.linalg.solve(covariance, white[:, place])
        np.testing.assert_allclose(found[:, place].T @ found[:, place], expected, rtol=1e-10)
