"""Frayed outlines: depth tells tool from tissue where masks can't."""

import numpy as np

from palpate.data.contact.geometry import TISSUE, TOOL
from palpate.data.contact.outlines import inside, near, tool_depth, uncover

NOISE = 0.001
SHAPE = (20, 24)


def flat() -> tuple[np.ndarray, np.ndarray]:
    """Tissue at 0.5 left of column 12, a tool at 0.45 in rows 6 to 13 right of it, nothing else."""
    depth, labels = np.full(SHAPE, 0.5, np.float32), np.zeros(SHAPE, np.uint8)
    labels[:, :12] = TISSUE
    labels[6:14, 12:] = TOOL
    depth[6:14, 12:] = 0.45
    return depth, labels


def test_near_and_inside_reach_two_pixels() -> None:
    mask = np.zeros(SHAPE, bool)
    mask[5:12, 5:12] = True
    assert np.argwhere(near(mask))[[0, -1]].tolist() == [[3, 3], [13, 13]]
    assert np.argwhere(inside(mask))[[0, -1]].tolist() == [[7, 7], [9, 9]]
    assert inside(np.ones(SHAPE, bool)).all()


def test_a_dent_under_the_outline_is_tissue_and_the_tool_is_not() -> None:
    depth, labels = flat()
    depth[9, 12] = 0.51  # the bottom of a dent, labelled as tool
    expected = labels.copy()
    expected[9, 12] = TISSUE
    np.testing.assert_array_equal(uncover(depth, labels, NOISE), expected)
    depth[9, 12] = 0.502  # no clearer than noise
    np.testing.assert_array_equal(uncover(depth, labels, NOISE), labels)
    depth[9, 12], depth[9, 16] = 0.45, 0.6  # behind the tissue, but not beside it
    np.testing.assert_array_equal(uncover(depth, labels, NOISE), labels)
    assert uncover(depth, labels, float("nan")) is labels


def test_a_tool_whose_depth_is_wrong_is_no_dent() -> None:
    """Photometric depth puts black plastic far away."""
    depth, labels = flat()
    depth[6:14, 12:] = 0.52
    np.testing.assert_array_equal(uncover(depth, labels, NOISE), labels)


def test_the_tools_outline_takes_the_depth_of_the_tool_beside_it() -> None:
    depth, labels = flat()
    true = depth.copy()
    depth[6, 12:], depth[6:9, 12], depth[7, 13] = 0.5, 0.5, 0.5  # a frayed corner shows the background
    depth[10, 14] = 0.0
    cleaned = tool_depth(depth, labels == TOOL)
    valid = depth > 0
    np.testing.assert_array_equal(cleaned[valid], true[valid])
    assert cleaned[10, 14] == 0
    nothing = np.zeros(SHAPE, bool)
    np.testing.assert_array_equal(tool_depth(depth, nothing), depth)
