"""The judge of maps on drawn pulls: on one of them maps agree and intervals hold."""

import re

import numpy as np
import pytest

from tests.estimators.online import drawn_pulls
from tests.estimators.online.drawn_pulls import holds, rank, relative_holds
from tests.results.fields import FIELD_SEEN


def test_what_is_counted() -> None:
    """Maps that agree nowhere far enough have no rank; intervals count where there are some."""
    assert np.isnan(rank(FIELD_SEEN, FIELD_SEEN))  # four particles are too few
    young = np.array([[2.0, 2, np.nan, 2], [1, 1, np.nan, 1], [3, 3, np.nan, 3]])
    np.testing.assert_array_equal(holds(np.array([1.5, 4, 2, 3]), young), [True, False, True])
    true, everywhere = 7 * FIELD_SEEN.distance, np.ones(4, bool)
    assert relative_holds(true, FIELD_SEEN, everywhere).all()  # their level doesn't count
    off = true * np.array([1, 1, 1, 1e9])
    assert not relative_holds(off, FIELD_SEEN, everywhere).all()


@pytest.mark.slow
def test_maps_of_a_drawn_pull_agree_and_their_intervals_hold(capsys: pytest.CaptureFixture[str]) -> None:
    assert drawn_pulls.main(["--pulls", "1", "--seed", "772001"]) == 0
    out = capsys.readouterr().out
    found = re.findall(r"Adam's ([-.\d]+), with points' ([-.\d]+), with the truth ([-.\d]+)", out)[0]
    assert min(map(float, found)) > 0.7
    shares = re.findall(r"(\d+)% of (\d+) intervals hold", out)
    assert len(shares) == 5
    for share, count in shares:
        assert int(share) >= 80
        assert int(count) > 40
