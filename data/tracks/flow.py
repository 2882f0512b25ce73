"""Maps of one frame carried to the next one along dense inverse search flow (Kroeger 2016, OpenCV's DIS)."""

import cv2
import numpy as np


class FlowCarrier:
    """Carries maps from frame to frame."""

    def __init__(self) -> None:
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)

    def carried(self, values: np.ndarray, before: np.ndarray, now: np.ndarray, way: int) -> np.ndarray:
        """A map [h, w] of the frame before as it lies in the frame now.

        Args:
            values: the map.
            before, now: both frames in grey, uint8 [h, w].
            way: OpenCV's interpolation.
        """
        flow = self._flow.calc(now, before, None)  # ty: ignore[no-matching-overload]  no first guess
        rows, columns = np.indices(now.shape, np.float32)
        return cv2.remap(values, columns + flow[..., 0], rows + flow[..., 1], way, borderMode=cv2.BORDER_REPLICATE)
