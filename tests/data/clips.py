"""Tiny clips in CholecSeg8k's layout whose contact and motion are known."""

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from palpate.data.cache import CacheEntry, PreparedClip
from palpate.data.clip import ClipStream
from palpate.data.contact.geometry import GeometrySettings
from palpate.data.masks.class_table import CLASSES
from palpate.data.settings import PrepareSettings
from palpate.data.source.frames import Frame, FrameSource
from palpate.data.synthetic.clip import SyntheticClip, draw_truth, synthetic_clip
from palpate.data.synthetic.settings import SceneSettings

WIDTH, HEIGHT = 128, 96
FOCAL = 100.0
EDGE = 88
"""First column right of the tissue; the tool touches here."""
GRID = GeometrySettings(height=48, width=64)
SETTINGS = PrepareSettings(geometry=GRID, masks="annotation")
DEPTH_STEP = 0.002
"""Depth added in a frame [scene units]."""

SLOPE = 1e-4
"""Rise of the depth from row to row [scene units]."""


def picture(frame: int, shift: float, generator_seed: int = 0) -> np.ndarray:
    """Textured tissue, moved `shift` pixels to the left a frame, BGR."""
    noise = np.random.default_rng(generator_seed).uniform(40, 220, (HEIGHT // 4, WIDTH // 4 + 30)).astype(np.float32)
    texture = cv2.resize(noise, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    move = np.array([[1, 0, -shift * frame], [0, 1, 0]], np.float32)
    moved = cv2.warpAffine(texture, move, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    return np.repeat(np.clip(moved, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def write_clip(
    folder: Path,
    contact: tuple[int, ...] = (3, 4, 5, 6, 7),
    frames: int = 12,
    *,
    shift: float = 0.0,
    recede: float = DEPTH_STEP,
    first: int = 0,
) -> Path:
    """Write a clip: tissue on the left, a tool on the right that touches it in the `contact` frames and is out of view
    in the others.

    Args:
        folder: videoNN/videoNN_SSSSS.
        contact: indices of the frames in contact.
        frames: number of frames.
        shift: pixels that the picture moves left in each frame.
        recede: depth added in each frame [scene units]; the picture stays, so the scene grows as it recedes.
        first: number of the first frame.
    """
    folder.mkdir(parents=True)
    for index in range(frames):
        image = picture(index, shift)
        image[:16, -24:] = np.random.default_rng(index).integers(0, 256, (16, 24, 1))  # else pictures repeat
        mask = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        mask[:, :EDGE] = CLASSES["gallbladder"].color[::-1]
        depth = np.full((HEIGHT, WIDTH), 0.5 + recede * index) + SLOPE * np.arange(HEIGHT)[:, None]
        if index in contact:
            image[40:56, EDGE:] = 200
            mask[40:56, EDGE:] = CLASSES["grasper"].color[::-1]
        stem = folder / f"frame_{first + index}_endo"
        cv2.imwrite(f"{stem}.png", image)
        cv2.imwrite(f"{stem}_color_mask.png", mask)
        cv2.imwrite(f"{stem}_depth.png", np.rint(depth * 65535).astype(np.uint16))
    camera = {"fx": FOCAL, "fy": FOCAL, "cx": 63.5, "cy": 47.5, "width": WIDTH, "height": HEIGHT}
    (folder / "clip.json").write_text(json.dumps({"fps": 25.0, "camera": camera, "depth_scale": 1.0}))
    return folder


class Pictures(FrameSource):
    """A clip of given pictures, shape [N, H, W, 3]; `read` counts those that were read last."""

    def __init__(self, pictures: Sequence[np.ndarray] | np.ndarray, *, live: bool = False) -> None:
        self.name, self.path, self.fps, self.warnings = "clip", Path("clip.mp4"), 10.0, []
        self.pictures, self.length, self.read = pictures, 0 if live else len(pictures), 0
        self.size = np.shape(pictures)[2:0:-1]

    def __iter__(self) -> Iterator[Frame]:
        for index, picture in enumerate(self.pictures):
            self.read = index + 1
            yield Frame(index, index, index / self.fps, picture)


def remove_frame(folder: Path, number: int) -> None:
    """Take a frame out of a clip, which leaves a gap in its numbers."""
    for path in folder.glob(f"frame_{number}_endo*"):
        path.unlink()


def remove_depth(folder: Path, *numbers: int) -> None:
    """Let frames have depth zero everywhere."""
    for number in numbers:
        cv2.imwrite(str(folder / f"frame_{number}_endo_depth.png"), np.zeros((HEIGHT, WIDTH), np.uint16))


def describe(folder: Path, **changes: Any) -> None:
    """Let a clip's file say something else; what is None it says no more."""
    path = folder / "clip.json"
    entries = json.loads(path.read_text()) | changes
    path.write_text(json.dumps({name: value for name, value in entries.items() if value is not None}))


def stored(clip: ClipStream, cache: Path) -> PreparedClip:
    """A stream's frames, written to a cache and read back."""
    entry = CacheEntry(cache, clip.source.name, "0")
    entry.write(clip, clip.sources, clip.source.size)
    return entry.load(clip.source.path)


def real_frames(real_data: Path, folder: Path, numbers: Iterable[int]) -> Path:
    """A clip of some frames of the real clip of CholecSeg8k."""
    folder.mkdir(parents=True)
    for number in numbers:
        for file in (real_data / "cholecseg8k" / "video01" / "video01_00080").glob(f"frame_{number}_endo*"):
            (folder / file.name).symlink_to(file)
    return folder


def make_clip(settings: SceneSettings, seed: int) -> SyntheticClip:
    """A drawn clip in memory; the same settings and seed give the same arrays."""
    return synthetic_clip(*draw_truth(settings, seed), seed)
