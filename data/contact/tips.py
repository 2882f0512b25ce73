"""The free ends of instruments in a mask: the part that may touch."""

import cv2
import numpy as np

JAWS = 6.0
"""Length of an instrument's free end in which a contact lies [grid pixels], about that of its jaws."""


def tool_tips(tool: np.ndarray, lit: np.ndarray, reach: float, least: int) -> list[np.ndarray]:
    """Places (column, row) in the free end of every tool, [P, 2] each; in all of a tool that enters nowhere.

    Args:
        tool: mask, bool [h, w].
        lit: mask of the picture's lit part, bool [h, w]: tools enter at its edge.
        reach: length of a free end, from the pixel farthest from the tool's entry [px].
        least: smallest number of pixels of a tool.
    """
    left, top, width, height = cv2.boundingRect(tool.astype(np.uint8))
    if not width:  # OpenCV crashes where no pixel is left
        return []
    edge = cv2.dilate((~lit).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    edge[[0, 1, 2, -3, -2, -1]] = edge[:, [0, 1, 2, -3, -2, -1]] = True
    count, number, stats, _ = cv2.connectedComponentsWithStats(
        tool[top : top + height, left : left + width].astype(np.uint8)
    )
    tips = []
    for index in range(1, count):
        if stats[index, cv2.CC_STAT_AREA] < least:
            continue
        part = np.argwhere(number == index) + np.array([top, left])
        entry = part[edge[part[:, 0], part[:, 1]]]
        if len(entry):
            away = np.linalg.norm(part - entry.mean(axis=0), axis=1)
            part = part[away > away.max() - reach]
        tips.append(part[:, ::-1])
    return tips


def free_ends(tool: np.ndarray, lit: np.ndarray, reach: float | None = None) -> np.ndarray:
    """Mask of the free ends of instruments, bool [h, w]; arguments as in `tool_tips`.

    By default they reach back by 0.11 of the picture's longer side: the part that may touch.
    """
    ends = np.zeros(tool.shape, bool)
    for tip in tool_tips(tool, lit, 0.11 * max(tool.shape) if reach is None else reach, 1):
        ends[tip[:, 1], tip[:, 0]] = True
    return ends
