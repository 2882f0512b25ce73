"""Files that appear complete or not at all."""

import pytest

from physics.files import replacing


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("earlier")
    return path


def test_a_file_takes_its_place_when_it_is_complete(table):
    with replacing(table) as partial:
        partial.write_text("new")
        assert (table.read_text(), partial.suffix) == ("earlier", ".csv")
    assert {path.name: path.read_text() for path in table.parent.iterdir()} == {"table.csv": "new"}


@pytest.mark.parametrize("reason", [OSError("full"), KeyboardInterrupt()])
def test_what_fails_half_way_leaves_the_earlier_file_and_nothing_else(table, reason):
    def write():
        with replacing(table) as partial:
            partial.write_text("half")
            raise reason

    with pytest.raises(type(reason)):
        write()
    assert {path.name: path.read_text() for path in table.parent.iterdir()} == {"table.csv": "earlier"}
