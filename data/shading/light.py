"""From a picture to light: the camera's response undone, instruments, highlights and what is too dark left out."""

import cv2
import numpy as np

from palpate.data.labels import TISSUE

FINE = 2
"""Places of the lattice a grid pixel, along an axis."""
DARKEST, BRIGHTEST = 0.01, 0.98
"""Light beyond these tells nothing, in shares of white: noise decides it, or the sensor is full."""
_LEVELS = np.arange(256) / 255
SRGB = np.where(_LEVELS <= 0.04045, _LEVELS / 12.92, ((_LEVELS + 0.055) / 1.055) ** 2.4).astype(np.float32)
"""Light that every level of an sRGB picture stands for (IEC 61966-2-1), in shares of white."""


def not_tissue(labels: np.ndarray, width: int) -> np.ndarray:
    """1 where pixels lie on or next to what is no tissue, else 0, uint8 [h, w].

    Args:
        labels: label map [h, w] of a picture or of a part of it.
        width: of the whole picture [px].
    """
    reach = 2 * max(1, round(5 * width / 854)) + 1
    return cv2.dilate((labels != TISSUE).astype(np.uint8), np.ones((reach, reach), np.uint8))


def log_light(picture: np.ndarray, labels: np.ndarray, grid_shape: tuple[int, int]) -> np.ndarray:
    """Logarithms of red, green and blue light on a lattice, means over areas of the picture, float32.

    Args:
        picture: RGB, uint8 [H, W, 3], free of distortion.
        labels: label map of the same size; an instrument that is not in it counts as tissue.
        grid_shape: rows and columns of the grid that the lattice divides.

    Returns:
        Shape [3, FINE·h, FINE·w] for a grid [h, w]; not a number where no tissue is seen, or only a highlight.
    """
    size = FINE * grid_shape[1], FINE * grid_shape[0]
    red, green, blue = cv2.split(cv2.resize(cv2.LUT(picture, SRGB), size, interpolation=cv2.INTER_AREA))
    light = 0.5 * (red + green)
    unknown = cv2.resize(255 * not_tissue(labels, picture.shape[1]), size, interpolation=cv2.INTER_AREA) > 0
    unknown |= (light < DARKEST) | (red > BRIGHTEST)
    hue = np.log(blue + 0.003) - np.log(red + 0.003)
    levels = np.clip((hue + 4) * (255 / 5), 0, 255).astype(np.uint8)
    # Every second place tells what is around as well as all, in a third of the time.
    small = cv2.medianBlur(np.ascontiguousarray(levels[::2, ::2]), 15)
    around = cv2.resize(small, size, interpolation=cv2.INTER_NEAREST).astype(np.float32) * (5 / 255) - 4
    # Highlights are whiter than what is around.
    highlight = ((hue - around > 0.12) & ~unknown).astype(np.uint8)
    unknown |= cv2.dilate(highlight, np.ones((3, 3), np.uint8)) > 0
    found = np.log(np.maximum(np.stack([red, green, blue]), 0.3 * DARKEST))
    found[:, unknown] = np.nan
    return found


def brightness(light: np.ndarray) -> np.ndarray:
    """Logarithm of the mean of red and green, from those of the colours [3, h, w], shape [h, w]."""
    return np.log(np.exp(light[:2]).mean(axis=0))


def redness(light: np.ndarray) -> np.ndarray:
    """Logarithm of red over the mean of green and blue, from those of the colours [3, h, w], shape [h, w]."""
    return light[0] - (light[1] + light[2]) / 2
