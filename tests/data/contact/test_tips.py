"""The free ends of instruments, against those of drawn ones."""

import numpy as np

from palpate.data.contact.tips import free_ends, tool_tips

LIT = np.ones((60, 80), bool)


def test_a_tip_is_the_part_farthest_from_where_its_tool_enters_wherever_that_is() -> None:
    tool = np.zeros((60, 80), bool)
    tool[10:14, :30] = True
    tool[40:, 70:75] = True
    tool[30, 40:45] = True  # too small
    first, second = sorted(map(np.ndarray.tolist, tool_tips(tool, LIT, 5.0, 10)))
    assert {column for column, _ in first} - {24} == {25, 26, 27, 28, 29}  # corners lie a little farther away
    assert {row for _, row in second} - {45} == {40, 41, 42, 43, 44}
    assert all(tool[row, column] for column, row in (*first, *second))


def test_all_of_a_tool_that_enters_nowhere_may_touch() -> None:
    tool = np.zeros((60, 80), bool)
    tool[20:24, 30:40] = True
    (found,) = tool_tips(tool, LIT, 2.0, 1)
    np.testing.assert_array_equal(np.sort(found, axis=0), np.sort(np.argwhere(tool)[:, ::-1], axis=0))
    np.testing.assert_array_equal(free_ends(tool, LIT), tool)


def test_without_a_tool_there_are_none() -> None:
    assert tool_tips(np.zeros((60, 80), bool), LIT, 5.0, 1) == []
    assert not free_ends(np.zeros((60, 80), bool), LIT).any()
