"""Plans in space against finite elements."""

import re

import pytest

from tests.planning import drawn_bodies


@pytest.mark.slow
def test_forces_of_three_bodies_lie_in_their_intervals_and_under_the_limit(capsys):
    assert drawn_bodies.main(["--bodies", "3", "--seed", "984001", "--ompl-s", "0"]) == 0
    *bodies, last = capsys.readouterr().out.splitlines()
    assert last == "of 3: cost's interval holds 3, largest force's 3, limit kept 3"
    for body in bodies:
        told, simulated, limit = map(
            float, re.findall(r"force ([.0-9]+) N.*simulated ([.0-9]+), limit ([.0-9]+)", body)[0]
        )
        assert 0.3 < told / simulated < 3
        assert simulated < limit
