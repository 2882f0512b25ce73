"""Columns of a CSV file by their names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from data.source.layout import InputError
from data.source.table import read_columns


def test_columns_come_in_the_order_that_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes('﻿b,note,a\r\n1,x,2\r\n\r\nnan,"y\nz",-3e2\r\n'.encode())  # of a spreadsheet
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
