"""Tables as text: digits, what is missing, and what would break a table."""

import csv
import io

from palpate.common.tables import to_csv


def test_csv_keeps_all_digits_unless_told_otherwise_and_leaves_empty_what_is_missing():
    rows = [{"a|b": "|F|", "<x>": 0.1234567891}, {"a|b": "x, y", "<x>": None}, {"a|b": 3}]
    read = list(csv.reader(io.StringIO(to_csv(rows))))
    assert read == [["a|b", "<x>"], ["|F|", "0.1234567891"], ["x, y", ""], ["3", ""]]
    assert to_csv(rows[:1], ("<x>", "a|b", "c"), ".3g") == "<x>,a|b,c\n0.123,|F|,\n"
    assert to_csv([], ("a", "b")) == "a,b\n"
