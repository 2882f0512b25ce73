"""Columns of numbers from a CSV file, whose content is not trusted."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palpate.common.doors import plain
from palpate.common.files import read_file
from palpate.common.settings import LARGEST
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError

MOST_BYTES = 2**26
"""Largest table that is read [bytes]; an hour of a sensor at 1000 rows a second is smaller."""


def reason(error: Exception) -> str:
    """Reason why a file can't be read, in at most 120 letters, which don't repeat its content."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, UnicodeError):
        return "it is no text"
    if isinstance(error, KeyError):
        return f"there is no {plain(str(error))[:120]}"
    if isinstance(error, (TypeError, AttributeError, RecursionError)):
        return "it is built otherwise"
    return plain(str(error))[:120]


def read_columns(path: Path, columns: Sequence[str], what: str) -> np.ndarray:
    """Columns of a table with a head, shape [rows, columns]; they need not be finite.

    Args:
        columns: names of the columns; others are left out.
        what: the kind of table that is expected, for the error message.

    Raises:
        InputError: it can't be read, lacks a column, or holds something that is no number or larger than LARGEST.
    """
    give = f"give a CSV file with the columns {', '.join(columns)}, separated by commas, and numbers alone below"
    try:
        text = io.StringIO(read_file(path, MOST_BYTES).decode("utf-8-sig"), newline="")
        rows = csv.DictReader(text, restval="", skipinitialspace=True)  # the value of what a short row lacks
        rows.fieldnames = [name.strip() for name in rows.fieldnames or ()]
        found = [[float(row[name]) for name in columns] for row in rows]
    except (OSError, ValueError, KeyError, csv.Error) as error:
        raise InputError(f"{printable(path)} is no {what} ({reason(error)}); {give}.") from error
    table = np.array(found, dtype=np.float64).reshape(-1, len(columns))
    if (np.abs(table[np.isfinite(table)]) > LARGEST).any():
        raise InputError(f"{printable(path)} holds a number beyond ±{LARGEST:g}; correct the file.")
    return table


def read_series(path: Path, columns: Sequence[str], what: str, least: int) -> np.ndarray:
    """Columns of a table over time, of which the first rises, shape [rows, columns]; all values are finite.

    Args:
        columns: names of the columns.
        what: expected kind of table, for the error message.
        least: smallest number of rows.

    Raises:
        InputError: as in `read_columns`; or the table is too short, a value is not finite, or the times don't rise.
    """
    found = read_columns(path, columns, what)
    if len(found) < least:
        give = f"give a CSV file with the columns {', '.join(columns)}, and {least} rows or more"
        raise InputError(f"{path} has {len(found)} rows; {give}.")
    if not np.isfinite(found).all():
        raise InputError(f"{path} holds a value that is not finite; leave such rows out.")
    if not (np.diff(found[:, 0]) > 0).all():
        raise InputError(f"{path} holds a time that is not after the one before; sort its rows by {columns[0]}.")
    return found
