"""Errors of depth-change sequences."""

import numpy as np

from palpate.physics import depth


def test_smooth_errors_are_those_of_a_gaussian_process() -> None:
    columns = 1e-3 * depth.smooth_errors()
    places = np.mgrid[: 2 * depth.REACH + 1, : 2 * depth.REACH + 1].reshape(2, -1).T
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    expected = (depth.REST_SHARE * 1e-3) ** 2 * np.exp(-0.5 * (apart / depth.REST_LENGTH) ** 2)
    found = columns @ columns.T
    # As few columns as hold so much of it.
    assert np.trace(found) >= depth.REST_KEPT * np.trace(expected)
    assert np.trace(found) - np.square(columns[:, -1]).sum() < depth.REST_KEPT * np.trace(expected)
    np.testing.assert_allclose(columns.T @ columns, np.diag(np.square(columns).sum(axis=0)), atol=1e-15)
    np.testing.assert_allclose(found, expected, atol=0.06 * (depth.REST_SHARE * 1e-3) ** 2)
    assert np.linalg.eigvalsh(expected - found).min() > -1e-9 * expected.max()
