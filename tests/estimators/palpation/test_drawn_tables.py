"""The judge of forces beyond a curve: what it draws, and that forces that are given lie near on a few tables."""

import numpy as np
import pytest

from tests.estimators.palpation import drawn_tables
from tests.estimators.palpation.drawn_tables import FINE, LARGEST, LAWS, draw_table, stiffening


@pytest.mark.parametrize("law", LAWS)
def test_laws_stiffen_as_asked(law: str) -> None:
    force = stiffening(*LAWS[law], 15.0)
    rise = np.diff(force)
    assert rise[-1] / rise[0] == pytest.approx(15, rel=1e-6)
    assert (rise > 0).all()
    assert (force[0], force[-1], len(force)) == (0, 1, len(FINE))


def test_a_table_is_a_loading_and_cycles_that_go_further_and_are_softer() -> None:
    tables = [draw_table(seed, *LAWS["tangent"]) for seed in range(12)]
    assert {len(table.pull) // table.way for table in tables} == {1, 2, 6}
    for table in tables:
        first, way = slice(0, table.way), table.way
        assert (np.diff(table.pull[first]) > 0).all()
        assert table.force[first].max() == pytest.approx(LARGEST, abs=0.1)
        if len(table.pull) == 6 * way:
            assert table.pull[2 * way :].max() > table.pull[first].max()
            assert table.force[3 * way - 1] < 0.96 * LARGEST


@pytest.mark.slow
def test_forces_that_are_given_lie_within_a_quarter(capsys: pytest.CaptureFixture[str]) -> None:
    assert drawn_tables.main(["--tables", "20", "--seed", "774001"]) == 0
    out = capsys.readouterr().out
    assert "Refused as a whole: 0 of 40 tables" in out
    for cut, least in (("force", 0.5), ("pull", 0.1)):
        (line,) = (line for line in out.splitlines() if line.startswith(f"| half of the {cut} | all |"))
        count, given, near = line.split("|")[3:6]
        assert int(count) == 20
        assert float(given.rstrip(" %")) / 100 > least
        assert float(near.rstrip(" %")) / 100 >= 0.95
