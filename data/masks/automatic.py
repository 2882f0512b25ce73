"""Tool and tissue masks of raw video: instruments by the network that ships, other lit pixels as tissue.

The network looks twice at every picture (`models.instruments.network.TwoLooks`), and what it gives is no calibrated
probability: 0.5 decides. It is averaged over time: that of the frame before is moved along the optical flow. Parts
count if they are large, enter the view, and were there in the frame before. docs/masks.md reports the accuracy.
"""

from pathlib import Path

import cv2
import numpy as np
from scipy.special import expit

from palpate.common.files import file_sha256
from palpate.common.provenance import MASKS, ROOT
from palpate.data.labels import TISSUE, TOOL, UNSURE
from palpate.data.masks.lit import lit_picture, picture_field
from palpate.data.picture_network import PictureNetwork, resized
from palpate.data.source.frames import Frame
from palpate.data.tracks.flow import FlowCarrier

WEIGHTS = ROOT / MASKS
"""File of the network that ships: a picture [1, 3, H, W] in [0, 1] to logits [1, 1, H/2, W/2] of an instrument."""


class AutomaticMasks:
    """Mask source (see masks.MaskSource) for raw video; frames must come in order.

    Args:
        path: the network; by default the one that ships.
        every: number of frames of which the network runs in one; in between its probability moves along the flow.
        threads, device: CPU threads and device, as in `PictureNetwork`.
    """

    def __init__(self, path: Path = WEIGHTS, *, every: int = 1, threads: int = 0, device: str = "cpu") -> None:
        self.network, self._every = PictureNetwork(path, threads=threads, device=device), every
        self._carrier = FlowCarrier()
        self.identity = f"automatic:{file_sha256(path)}" + (f":{every}" if every > 1 else "")
        self.reset()

    def reset(self) -> None:
        """Forget the frames of the clip so far."""
        self._gray: np.ndarray | None = None
        self._probability = np.zeros((0, 0), np.float32)
        self._since = 0
        """Frames since the network ran."""

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map uint8 [H, W] of a frame."""
        image = frame.picture
        lit = lit_picture(image)
        probability, before = self._averaged(image)
        view = picture_field(cv2.resize(lit.astype(np.uint8), probability.shape[::-1]) > 0)
        kept = np.where(instrument_parts(probability, view, before), probability, np.minimum(probability, 0.4))
        kept = cv2.resize(kept, image.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        # Pixels with a larger probability may be an instrument; it is one above one half.
        labels = lit * np.uint8(TISSUE)
        labels[kept > 0.1] = UNSURE
        labels[kept > 0.5] = TOOL
        return labels

    def probability(self, image: np.ndarray) -> np.ndarray:
        """Probability of an instrument in one picture [H, W, 3], at half of the network's size, float32 [h, w]."""
        return self._seen(self._small(image))

    def _small(self, image: np.ndarray) -> np.ndarray:
        height, width = self.network.fixed_size("NCHW")
        assert height is not None and width is not None  # noqa: PT018  the file fixes them
        return resized(image, height, width)

    def _seen(self, small: np.ndarray) -> np.ndarray:
        return expit(self.network.run(small.transpose(2, 0, 1)[None] * np.float32(1 / 255))[0][0, 0])

    def _averaged(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Probability of an instrument at half of the network's size, and that before, moved; float32 [h, w] each.

        The first frame of a clip is its own frame before.
        """
        small = self._small(image)
        height, width = small.shape[:2]
        gray = cv2.cvtColor(resized(small, height // 2, width // 2), cv2.COLOR_RGB2GRAY)
        before = None
        if self._gray is not None:
            before = self._carrier.carried(self._probability, self._gray, gray, cv2.INTER_LINEAR)
        now = before
        if now is None or self._since % self._every == 0:
            own = self._seen(small)
            now = own if before is None else 0.7 * own + (1 - 0.7) * before
        self._since += 1
        self._gray, self._probability = gray, now
        return now, now if before is None else before


def instrument_parts(probability: np.ndarray, view: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Connected parts that are instruments, bool [h, w]: large, and there in the frame before, too.

    An instrument enters the view: a part begins at the view's end, or not far from it for its length, and reaches into
    the view.

    Args:
        probability: probability of an instrument, [h, w].
        view: the endoscope's view, bool [h, w], convex.
        before: the probability in the frame before, moved to this one's.
    """
    mask = ((probability > 0.5) & view).astype(np.uint8)
    within = cv2.distanceTransform(np.pad(view.astype(np.uint8), 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    count, numbers, boxes, _ = cv2.connectedComponentsWithStats(mask)
    kept = np.zeros(count, bool)
    # Smallest part of an instrument, as a share of the picture.
    for index in np.flatnonzero(boxes[:, cv2.CC_STAT_AREA] >= 0.004 * mask.size):
        left, top, width, height, _ = boxes[index]
        box = np.s_[top : top + height, left : left + width]
        part = numbers[box] == index
        depth = within[box][part]
        # A part that reaches less far into the view is its rim, as a share of the picture's longer side.
        # How far from the view's end a part may begin, as a multiple of its length: tissue or a shadow hides the rest.
        enters = depth.min() - 2 <= 0.3 * np.hypot(width, height) and depth.max() >= 0.04 * max(mask.shape)
        # A part has been there before if the frame before has so much probability in it, moved along the flow.
        kept[index] = index > 0 and enters and before[box][part].max() >= 0.3
    return kept[numbers]
