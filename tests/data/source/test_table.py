"""Columns of a CSV file by their names."""

from pathlib import Path

import numpy as np
import pytest

from palpate.data.source.layout import InputError
from palpate.data.source.table import read_columns


def test_columns_come_in_the_order_that_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes('﻿b, note,a \r\n1,x,2\r\n\r\nnan,"y\nz",-3e2\r\n'.encode())  # of a spreadsheet
    np.testing.assert_array_equal(read_columns(path, ("a", "b"), "table of something"), [[2, 1], [-300, np.nan]])


@pytest.mark.parametrize("content", ["", "a,b\n"])
def test_a_table_without_rows_has_none(tmp_path: Path, content: str) -> None:
    (tmp_path / "a.csv").write_text(content)
    assert read_columns(tmp_path / "a.csv", ("a", "b"), "table").shape == (0, 2)


@pytest.mark.parametrize("row", ["1e16", "-1e300"])
def test_a_number_beyond_all_use_is_told(tmp_path: Path, row: str) -> None:
    (tmp_path / "a.csv").write_text(f"a\n{row}\n")
    with pytest.raises(InputError, match=r"a\.csv holds a number beyond ±1e\+15; correct the file\."):
        read_columns(tmp_path / "a.csv", ("a",), "table")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a,b\n1,2\n3\n", "could not convert string to float: ''"),
        (b"a,c\n1,2\n", "there is no 'b'"),
        (b"a;b\n1,5;2\n", "there is no 'a'"),
        (b"a,b\nmm,N\n1,2\n", "could not convert string to float: 'mm'"),
        (b"\xff\xfe\x00" * 99, "it is no text"),
        (b"a,b\n" + b"9" * 200_000 + b",1\n", "field larger than field limit (131072)"),
    ],
)
def test_what_is_wrong_is_told_in_a_few_words(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(InputError) as refused:
        read_columns(tmp_path / "a.csv", ("a", "b"), "table")
    give = "give a CSV file with the columns a, b, separated by commas, and numbers alone below."
    assert str(refused.value).endswith(f"a.csv is no table ({said}); {give}")
