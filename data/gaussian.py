"""Gaussian sums of images, wide ones on fewer pixels."""

import cv2
import numpy as np


def gaussian_sum(values: np.ndarray, scale: float) -> np.ndarray:
    """Sum weighted by a Gaussian of an image that is 0 around, shape [h, w] float32.

    Args:
        values: shape [h, w] float32.
        scale: standard deviation of the weights [grid pixels].
    """
    # A sum that is so wide has no detail: a quarter of the pixels along each axis tell it.
    if scale < 12.0:
        return cv2.GaussianBlur(values, (0, 0), scale, borderType=cv2.BORDER_CONSTANT)
    height, width = values.shape
    small = cv2.resize(values, (-(-width // 4), -(-height // 4)), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), scale / 4, borderType=cv2.BORDER_CONSTANT)
    return cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
