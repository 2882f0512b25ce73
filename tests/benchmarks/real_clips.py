"""Drawn clips of tissue that is pulled, written as a user has them."""

from pathlib import Path

import cv2
import numpy as np

from benchmarks.real.__main__ import PulledClip
from tests.inference_inputs import encode

SIZE = 240, 176
"""Width and height of a pulled clip's pictures [px]."""
TIP = 80, 88
"""Column where the tool ends and row of its middle, in the first picture [px]."""
REACH = 45.0
"""How far motion reaches from the tip [px]."""
WAY = np.array([-7.0, 3.5])
"""Motion of the grip from the first picture to the last [px]."""


def tissue_motion(places: np.ndarray, share: float) -> np.ndarray:
    """Displacement of places [N, 2] (column, row) after a share of the way [px]: it dies away smoothly."""
    away = np.maximum(np.hypot(np.maximum(places[:, 0] - TIP[0], 0), places[:, 1] - TIP[1]) - 10, 0)
    return share * WAY * np.exp(-np.square(away / REACH) / 2)[:, None]


def tool_mask(share: float) -> np.ndarray:
    """Where the tool is, bool [H, W]."""
    width, height = SIZE
    row, column = np.mgrid[:height, :width]
    right, middle = TIP + share * WAY
    return (column < right) & (np.abs(row - middle) < 12)


def pull_pictures(shares: np.ndarray, camera: tuple[float, float] = (0.0, 0.0)) -> list[np.ndarray]:
    """RGB pictures; by the last one the camera has moved all of it so far too [px]."""
    width, height = SIZE
    noise = np.random.default_rng(0).normal(size=(height, width, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 3)
    texture = np.clip(130 + 40 * smooth / smooth.std(), 50, 250).astype(np.uint8)
    here = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(np.float64)
    pictures = []
    for share in shares:
        still = here - share * np.asarray(camera)
        source = still
        for _ in range(20):
            source = still - tissue_motion(source, share)
        columns, rows = source.reshape(height, width, 2).astype(np.float32).transpose(2, 0, 1)
        picture = cv2.remap(texture, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        picture[tool_mask(share)] = 215
        pictures.append(picture)
    return pictures


def write_pull(folder: Path, shares: np.ndarray, camera: tuple[float, float] = (0.0, 0.0)) -> tuple[Path, Path]:
    """Folders of pictures and of masks, whose tool is 0."""
    frames, masks = folder / "frames", folder / "masks"
    for index, (share, picture) in enumerate(zip(shares, pull_pictures(shares, camera), strict=True)):
        write(frames / f"{index:03d}.png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
        write(masks / f"{index:03d}.png", np.where(tool_mask(share), 0, 255).astype(np.uint8))
    return frames, masks


LAYOUT = """{image: "frames/{number}.png", label_mask: "masks/{number}.png", color_mask: null, class_mask: null,
tool_values: [0], tissue_values: [255]}"""


def pull_clip(folder: Path, shares: np.ndarray, camera: tuple[float, float] = (0.0, 0.0)) -> PulledClip:
    """Clip as a user gives it: a folder, with its layout beside it."""
    write_pull(folder, shares, camera)
    layout = folder.with_name(f"{folder.name}.yaml")
    layout.write_text(LAYOUT)
    return PulledClip(folder, layout)


def write(path: Path, picture: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encode(picture))
