"""Tool and tissue masks of raw video: instruments by the network that ships, other lit pixels as tissue.

The network's probability is averaged over time: that of the frame before is moved along the optical flow. Small or
unsure parts are left out. docs/reports/masks.md reports its accuracy on real pictures.
"""

from pathlib import Path

import cv2
import numpy as np
from scipy.special import expit

from palpate.common.files import file_sha256
from palpate.common.provenance import ROOT
from palpate.data.labels import TISSUE, TOOL
from palpate.data.masks.lit import lit_picture
from palpate.data.picture_network import PictureNetwork, network_input, resized
from palpate.data.source.frames import Frame

WEIGHTS = ROOT / "models" / "weights" / "instruments.onnx"
"""The network that ships: a picture [1, 3, H, W] in [0, 1] to logits [1, 2, H/2, W/2] of instrument and boundary."""
NEW_SHARE = 0.7
"""Weight of a frame's own probability; the rest is that of the frame before."""
LEAST_SHARE = 0.0015
"""Smallest part of an instrument, as a share of the picture; smaller ones are stray pixels."""
LEAST_SURE = 0.7
"""Smallest mean probability of a part."""


class AutomaticMasks:
    """Mask source (see masks.MaskSource) for raw video; frames must come in order.

    Args:
        path: the network; by default the one that ships.
        every: the network runs in one of so many frames; in between its probability is moved along the flow.
        threads, device: as of `PictureNetwork`.
    """

    def __init__(self, path: Path = WEIGHTS, *, every: int = 1, threads: int = 0, device: str = "cpu") -> None:
        self._network, self._every = PictureNetwork(path, threads=threads, device=device), every
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
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
        probability = self._averaged(image)
        kept = np.where(instrument_parts(probability), probability, np.minimum(probability, 0.4))
        labels = lit_picture(image).astype(np.uint8) * np.uint8(TISSUE)
        labels[cv2.resize(kept, image.shape[1::-1], interpolation=cv2.INTER_LINEAR) > 0.5] = TOOL
        return labels

    def _averaged(self, image: np.ndarray) -> np.ndarray:
        """Probability of an instrument at half of the network's size, float32 [h, w]."""
        height, width = self._network.fixed_size("NCHW")
        assert height is not None and width is not None  # noqa: PT018  the file fixes them
        small = resized(image, height, width)
        gray = cv2.cvtColor(resized(small, height // 2, width // 2), cv2.COLOR_RGB2GRAY)
        moved = None
        if self._gray is not None:
            flow = self._flow.calc(gray, self._gray, None)  # ty: ignore[no-matching-overload]  no first guess
            rows, columns = np.indices(gray.shape, np.float32)
            ahead = columns + flow[..., 0], rows + flow[..., 1]
            moved = cv2.remap(self._probability, *ahead, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        if moved is None or self._since % self._every == 0:
            found = self._network.run(network_input(small, 1 / 255, (0, 0, 0), (1, 1, 1), "NCHW"))[0]
            probability = expit(found[0, 0])
            moved = probability if moved is None else NEW_SHARE * probability + (1 - NEW_SHARE) * moved
        self._since += 1
        self._gray, self._probability = gray, moved
        return moved


def instrument_parts(probability: np.ndarray) -> np.ndarray:
    """Connected parts of an instrument that are large and sure enough, bool [h, w].

    Args:
        probability: of an instrument, [h, w].
    """
    mask = (probability > 0.5).astype(np.uint8)
    count, parts = cv2.connectedComponents(mask)
    sizes = np.bincount(parts.ravel(), minlength=count)
    sums = np.bincount(parts.ravel(), probability.ravel(), minlength=count)
    kept = (sizes >= LEAST_SHARE * mask.size) & (sums >= LEAST_SURE * sizes)
    kept[0] = False
    return kept[parts]
