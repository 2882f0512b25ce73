"""Depth of the tissue before it was touched, from all frames that show it at rest."""

from collections import deque

import cv2
import numpy as np

from palpate.data.contact.geometry import TISSUE, TOOL, RestTissue
from palpate.data.contact.outlines import near
from palpate.data.labels import OTHER
from palpate.data.prepared import PreparedFrame

FRAMES = 8
"""Number of frames before a contact whose depths are averaged."""


class RestDepth:
    """Depth of the tissue at rest, averaged over the frames before a contact that show the same view."""

    def __init__(self) -> None:
        self._frames: deque[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = deque(maxlen=FRAMES)

    def push(self, prepared: PreparedFrame) -> None:
        """Remember a frame without contact; any other ends the rest."""
        if prepared.in_contact or not (prepared.visible and prepared.has_depth):
            self._frames.clear()
        else:
            labels = prepared.labels
            tissue, other = (labels == TISSUE) & (prepared.depth > 0), (labels == OTHER) & ~near(labels == TOOL)
            self._frames.append((_grey(prepared), prepared.depth, tissue, other))

    def at(self, onset: PreparedFrame) -> RestTissue:
        """Depth of the first frame in contact with its tissue averaged over the remembered frames.

        A frame is moved by the shift of the picture between the two, and by the median difference of the depths: the
        camera may move slowly. Next to the tool, whose frayed outline may count as tissue, only the remembered frames
        count if they show the tissue.

        Tissue is known that is visible now, or was visible where the tool is now. A hole in the mesh where the tool
        presses would change its response, and so would an edge of the tissue behind the tool that is taken for hidden.
        """
        tissue, tool = (onset.labels == TISSUE) & (onset.depth > 0), onset.labels == TOOL
        total, count = np.where(tissue, onset.depth, 0).astype(np.float64), tissue.astype(np.float64)
        grey, outline, beyond = _grey(onset), tissue & near(tool), np.zeros_like(tissue)
        for before, depth, valid, other in self._frames:
            shift, _ = cv2.phaseCorrelate(before, grey)
            # The picture lay elsewhere.
            if max(abs(shift[0]), abs(shift[1])) > 3.0:
                continue
            move = np.array([[1, 0, round(shift[0])], [0, 1, round(shift[1])]], np.float64)
            moved, visible, ended = (
                cv2.warpAffine(part, move, depth.shape[::-1], flags=cv2.INTER_NEAREST)
                for part in (depth, valid.astype(np.uint8), other.astype(np.uint8))
            )
            visible, beyond = visible > 0, beyond | (ended > 0)
            shared = tissue & visible
            if shared.any():
                used = shared | (tool & visible)
                total[used] += moved[used] + np.median(onset.depth[shared] - moved[shared])
                count[used] += 1
        alone = outline & (count > 1)
        total[alone] -= onset.depth[alone]
        count[alone] -= 1
        known = count > 0
        resting = np.where(known, total / np.maximum(count, 1), onset.depth).astype(np.float32)
        return RestTissue(resting, known, beyond & ~known)


def _grey(prepared: PreparedFrame) -> np.ndarray:
    """Grey picture on the grid, float32."""
    return cv2.resize(prepared.shown.gray, prepared.depth.shape[::-1], interpolation=cv2.INTER_AREA).astype(np.float32)
