"""Corrections of masks at their outlines, which are off by a pixel or two, by the depth around them.

A tool lies between the camera and the tissue. So a pixel at a frayed outline is tool if it shows something in front of
the tissue, and no tool if it lies behind the tissue around it.
"""

import cv2
import numpy as np

from palpate.data.labels import TISSUE, TOOL

FRAY = 2
"""Uncertainty of outlines [grid pixels]."""


def near(mask: np.ndarray, reach: int = FRAY) -> np.ndarray:
    """Pixels within `reach` rows and columns of a mask, itself included, bool [h, w]."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8)) > 0


def inside(mask: np.ndarray) -> np.ndarray:
    """Pixels of a mask that its outline doesn't make uncertain, bool [h, w]; what touches the border counts as in."""
    return mask & ~near(~mask)


def uncover(depth: np.ndarray, labels: np.ndarray, noise: float) -> np.ndarray:
    """Labels in which tool pixels at the tissue's outline that lie clearly behind all tissue around them are tissue.

    Such is the bottom of a dent that a frayed outline of the pressing tool covers. Where much of the tool's outline
    lies behind, the tool's depth itself is wrong, as a photometric depth of black plastic is, and says nothing.

    Args:
        depth: z, shape [h, w] [scene units], 0 = invalid.
        labels: label map, shape [h, w].
        noise: standard deviation of the depth [scene units]; NaN leaves the labels as they are.
    """
    if not noise > 0:
        return labels
    tissue = np.where(labels == TISSUE, depth, 0).astype(np.float32)
    around = cv2.dilate(tissue, np.ones((2 * FRAY + 1,) * 2, np.uint8))
    outline = (labels == TOOL) & (around > 0) & (depth > 0)
    # A depth lies clearly behind others from this many standard deviations of its noise.
    behind = outline & (depth > around + 3.0 * noise)
    # A larger share of the tool's outline isn't the bottom of a dent.
    if behind.sum() > 0.25 * outline.sum():
        return labels
    return np.where(behind, np.uint8(TISSUE), labels)


def tool_depth(depth: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """Depth in which the tool's outline lies as near as the tool next to it, shape [h, w] [scene units].

    A pixel of a frayed outline shows the tissue behind the tool, and makes a hovering tool seem to touch it.

    Args:
        depth: z, shape [h, w] [scene units], 0 = invalid.
        tool: pixels of the tool, shape [h, w], bool.
    """
    valid, reach = tool & (depth > 0), 4  # rows and columns within which an outline takes its depth from the tool
    rows, columns = np.nonzero(valid & near(~tool, reach))
    if len(rows) == 0:
        return depth
    padded = np.pad(np.where(valid, depth, np.inf), reach, constant_values=np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (2 * reach + 1,) * 2)
    values = np.sort(windows[rows, columns].reshape(len(rows), -1), axis=1)
    # The nearest quarter: more than half of a corner's surroundings can be background.
    quarter = np.isfinite(values).sum(axis=1) // 4
    cleaned = depth.copy()
    cleaned[rows, columns] = np.minimum(depth[rows, columns], values[np.arange(len(rows)), quarter])
    return cleaned
