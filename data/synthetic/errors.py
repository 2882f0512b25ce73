"""Errors of observation put on a synthetic clip: noise, flicker, rounding, wrong outlines and focal length."""

import dataclasses

import cv2
import numpy as np

from palpate.data.source.camera import Camera
from palpate.data.synthetic.settings import SceneSettings


def depth_bias(settings: SceneSettings, generator: np.random.Generator) -> np.ndarray:
    """Factor on a clip's depth, the same in all frames: its smooth error, shape [H, W], float32."""
    shape = settings.grid_height, settings.grid_width
    if settings.depth_bias == 0:
        return np.ones((settings.height, settings.width), np.float32)
    field = settings.depth_bias * _noise(shape, 0.15 * settings.grid_width, generator)
    return np.exp(cv2.resize(field, (settings.width, settings.height), interpolation=cv2.INTER_CUBIC))


def observe_depth(depth: np.ndarray, settings: SceneSettings, generator: np.random.Generator) -> np.ndarray:
    """Depth as a depth model would give it, stored with a number of bits.

    Args:
        depth: true z, shape [H, W] [scene units], 0 = invalid.

    Returns:
        Stored values, shape [H, W], uint8 or uint16: z times the type's largest value. Valid pixels stay above 0.
    """
    observed = depth
    if settings.scale_flicker > 0:
        observed = observed * np.exp(settings.scale_flicker * generator.standard_normal())
    if settings.depth_noise > 0:
        observed = observed + settings.depth_noise * _noise(depth.shape, settings.depth_noise_correlation, generator)
    largest = 2**settings.depth_bits - 1
    stored = np.clip(np.rint(observed * largest), 1, largest)
    return np.where(depth > 0, stored, 0).astype(np.uint8 if settings.depth_bits == 8 else np.uint16)


def stored_to_depth(stored: np.ndarray) -> np.ndarray:
    """Stored values (uint8 or uint16) to z, float32 [scene units]."""
    return stored.astype(np.float32) / np.float32(np.iinfo(stored.dtype).max)


def observe_labels(labels: np.ndarray, settings: SceneSettings, generator: np.random.Generator) -> np.ndarray:
    """Class codes with their outlines displaced smoothly at random, shape [H, W], uint8."""
    if settings.mask_error == 0:
        return labels
    height, width = labels.shape
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    shifts = []
    for cell in settings.cell:
        # Correlation length of the outlines' displacement.
        field = _noise((settings.grid_height, settings.grid_width), 6.0, generator)
        shifts.append(settings.mask_error * cell * cv2.resize(field, (width, height), interpolation=cv2.INTER_LINEAR))
    return cv2.remap(labels, columns + shifts[0], rows + shifts[1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)


def reported_camera(camera: Camera, settings: SceneSettings) -> Camera:
    """The camera that the clip claims: the true one with its focal length off by a factor."""
    factor = settings.focal_error
    return dataclasses.replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)


def _noise(shape: tuple[int, int], correlation: float, generator: np.random.Generator) -> np.ndarray:
    """Gaussian noise of unit variance, shape [H, W], float32, blurred by a Gaussian of `correlation` px."""
    white = generator.standard_normal(shape, dtype=np.float32)
    if correlation == 0:
        return white
    # A Gaussian blur of standard deviation s leaves white noise with the sum of its squared weights as variance.
    reach = int(np.ceil(4 * correlation))
    kernel = cv2.getGaussianKernel(2 * reach + 1, correlation)
    gain = float(np.square(kernel).sum())
    blurred = cv2.sepFilter2D(white, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT)
    return blurred / np.float32(gain)
