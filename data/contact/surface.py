"""The tissue's smooth surface behind noisy depth, and the noise.

A grid cell is a few thousandths of the scene, no more than a depth model's noise. Springs between raw depths would have
lengths and directions of noise. At rest tissue is smooth, so a plane fitted around every pixel removes it.
"""

import cv2
import numpy as np


def smooth_surface(
    depth: np.ndarray, tissue: np.ndarray, smoothing: float, hidden: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """Depth of the tissue by a plane fitted around every pixel with Gaussian weights (local linear regression).

    A plane cuts off curved tissue, by 0.2 of a depth noise of 0.001 on synthetic tissue. So the same fit to the
    residual is added (twicing, Tukey 1977), whose bias is of higher order.

    Args:
        depth: z, shape [h, w] [scene units].
        tissue: pixels that are tissue and have a depth, shape [h, w], bool; only they are read and changed.
        smoothing: standard deviation of the weights [grid pixels], above 0.
        hidden: pixels at which the tissue's surface is continued, bool [h, w]; 0 where too little tissue is near.

    Returns:
        Smoothed depth [h, w] float32, elsewhere unchanged; and the noise, the standard deviation of the tissue's depth
        about the planes [scene units], NaN without tissue.
    """
    if not tissue.any():
        return depth, float("nan")
    height, width = depth.shape
    columns, rows = np.meshgrid(np.arange(width) - width / 2, np.arange(height) - height / 2)
    weight = tissue.astype(np.float64)
    z = np.where(tissue, depth, 0).astype(np.float64)
    # The weights end at three standard deviations.
    size = 2 * int(np.ceil(3.0 * smoothing)) + 1
    shown = tissue if hidden is None else tissue | hidden
    own = tissue[shown]

    def around(values: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(values * weight, (size, size), smoothing, borderType=cv2.BORDER_CONSTANT)[shown]

    share = around(np.ones_like(z))
    total = np.maximum(share, 1e-9)
    mean_x, mean_y = (around(values) / total for values in (columns, rows))
    xx, xy, yy = (around(values) / total for values in (columns * columns, columns * rows, rows * rows))
    xx, xy, yy = xx - mean_x**2, xy - mean_x * mean_y, yy - mean_y**2
    determinant = xx * yy - xy * xy
    # A neighbourhood without this spread holds no plane: its mean is taken.
    flat = determinant > 1e-6 * smoothing**4
    safe = np.where(flat, determinant, 1.0)

    def fit(values: np.ndarray) -> np.ndarray:
        mean_z, xz, yz = (around(weights * values) / total for weights in (1.0, columns, rows))
        xz, yz = xz - mean_x * mean_z, yz - mean_y * mean_z
        slope_x = np.where(flat, (yy * xz - xy * yz) / safe, 0.0)
        slope_y = np.where(flat, (xx * yz - xy * xz) / safe, 0.0)
        return mean_z + slope_x * (columns[shown] - mean_x) + slope_y * (rows[shown] - mean_y)

    fitted = fit(z)
    left = np.zeros_like(z)
    left[tissue] = z[tissue] - fitted[own]
    fitted = fitted + fit(left)
    smooth = depth.astype(np.float32, copy=True)
    # Share of a fit's weights that must lie on tissue for it to be continued where tissue is hidden.
    smooth[shown] = np.where(own | (share > 0.1), fitted, 0)
    return smooth, float(np.sqrt(np.mean(np.square(left[tissue]))))
