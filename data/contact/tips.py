"""The free ends of instruments in a mask: the part that may touch."""

import cv2
import numpy as np

END = 0.11
"""Part of an instrument that may touch: so far back from the end which is farthest from where it enters, as a share of
the picture's longer side."""


def tool_tips(tool: np.ndarray, lit: np.ndarray, reach: float, least: int) -> list[np.ndarray]:
    """Places (column, row) in the free end of every tool, [P, 2] each; in all of a tool that enters nowhere.

    Args:
        tool: mask, bool [h, w].
        lit: where the picture shows anything, bool [h, w]: tools enter at its edge.
        reach: how far the free end goes back from what is farthest from where a tool enters [px].
        least: parts of the mask with fewer pixels are no tool.
    """
    edge = cv2.dilate((~lit).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    edge[[0, 1, 2, -3, -2, -1]] = edge[:, [0, 1, 2, -3, -2, -1]] = True
    count, number, stats, _ = cv2.connectedComponentsWithStats(tool.astype(np.uint8))
    tips = []
    for index in range(1, count):
        if stats[index, cv2.CC_STAT_AREA] < least:
            continue
        part = np.argwhere(number == index)
        entry = part[edge[part[:, 0], part[:, 1]]]
        if len(entry):
            away = np.linalg.norm(part - entry.mean(axis=0), axis=1)
            part = part[away > away.max() - reach]
        tips.append(part[:, ::-1])
    return tips


def free_ends(tool: np.ndarray, lit: np.ndarray, reach: float | None = None) -> np.ndarray:
    """Where the free ends of instruments are, bool [h, w], by their mask and by where the picture shows anything."""
    ends = np.zeros(tool.shape, bool)
    for tip in tool_tips(tool, lit, END * max(tool.shape) if reach is None else reach, 1):
        ends[tip[:, 1], tip[:, 0]] = True
    return ends
