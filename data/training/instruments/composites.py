"""Instrument pictures for training: composites drawn on the fly, and augmented real pictures with masks."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch.utils.data import IterableDataset, get_worker_info

from palpate.data.source.images import read_image
from palpate.data.source.layout import IMAGE_SUFFIXES, InputError
from palpate.data.training.instruments import scenery
from palpate.data.training.instruments.drawing import Canvas, draw_instrument

IGNORED = 255
"""Label of pixels that the loss ignores."""


class Labelled(NamedTuple):
    """A real picture with the mask of its instruments."""

    picture: np.ndarray
    """RGB, uint8 [H, W, 3]."""
    tool: np.ndarray
    """1 = instrument, 0 = none, 255 = not known, uint8 [H, W]."""


@dataclass(frozen=True)
class RealPictures:
    """Real pictures of a folder tree: those with a mask `NAME_tool.png` beside them, and those without."""

    labelled: tuple[Labelled, ...]
    free: tuple[np.ndarray, ...]
    """Tool-free pictures, RGB uint8 [H, W, 3] each."""

    @classmethod
    def read(cls, folders: list[Path]) -> "RealPictures":
        """Read all pictures below some folders; a name that ends in `_tool` is a mask.

        Masks: 255 = instrument, 127 = not known, 0 = none. A mask without an instrument makes its picture tool-free.

        Raises:
            InputError: a folder holds no picture, or a mask has another size than its picture.
        """
        labelled, free = [], []
        for folder in folders:
            files = sorted(
                f for f in folder.rglob("*") if f.suffix.lower() in IMAGE_SUFFIXES and not f.stem.endswith("_tool")
            )
            if not files:
                raise InputError(f"{folder} holds no picture; give a folder of pictures with masks NAME_tool.png.")
            for file in files:
                picture, mask = read_image(file), file.with_name(f"{file.stem}_tool.png")
                if not mask.is_file():
                    free.append(picture)
                    continue
                stored = read_image(mask, cv2.IMREAD_GRAYSCALE)
                if stored.shape != picture.shape[:2]:
                    raise InputError(f"{mask} and {file.name} differ in size; export both at one size.")
                tool = np.where(stored == 255, 1, np.where(stored > 0, IGNORED, 0)).astype(np.uint8)
                sure = cv2.morphologyEx(tool & 1, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
                tool[(tool == 1) & (sure == 0)] = IGNORED  # crumbs of an outline
                labelled.append(Labelled(picture, tool))
        return cls(tuple(labelled), tuple(free))


def warp(rng: np.random.Generator, source: Labelled, size: tuple[int, int]) -> Labelled:
    """A random crop of a picture with its mask: turned, mirrored, scaled to `size`; not known beyond the edge."""
    height, width = size
    h, w = source.tool.shape
    scale = max(height / h, width / w) * rng.uniform(0.8, 2.0)
    angle = rng.choice([0.0, rng.uniform(-0.5, 0.5), rng.uniform(-np.pi, np.pi)])
    flip = rng.choice([-1.0, 1.0])
    turn = scale * np.array([[np.cos(angle) * flip, -np.sin(angle)], [np.sin(angle) * flip, np.cos(angle)]])
    spare = np.maximum(np.array([w, h]) * scale - (width, height), 0) / scale
    look = np.array([w, h]) / 2 + rng.uniform(-0.5, 0.5, 2) * spare
    matrix = np.column_stack([turn, np.array([width, height]) / 2 - turn @ look])
    way, size = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR, (width, height)
    picture = cv2.warpAffine(source.picture, matrix, size, None, way, cv2.BORDER_REFLECT)
    tool = cv2.warpAffine(source.tool, matrix, size, None, cv2.INTER_NEAREST, cv2.BORDER_CONSTANT, IGNORED)
    return Labelled(picture, tool)


class InstrumentPictures(IterableDataset):
    """Endless pictures [3, H, W] in [0, 1] with labels [H, W]: 0, 1 = instrument, 255 = not known.

    Args:
        real: real pictures; without any, all are drawn.
        seed: seed of all random numbers; each worker draws its own.
        real_share: share of labelled real pictures.
        size: height and width [px].
    """

    def __init__(
        self, real: RealPictures, seed: int = 0, real_share: float = 0.25, size: tuple[int, int] = (192, 320)
    ) -> None:
        self.real, self.seed, self.size = real, seed, size
        self.real_share = real_share if real.labelled else 0.0
        self._passes = 0

    def __iter__(self) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        worker = get_worker_info()
        self._passes += 1
        rng = np.random.default_rng([self.seed, self._passes, worker.id if worker else 0])
        while True:
            picture, tool = self.draw(rng)
            yield torch.from_numpy(picture.transpose(2, 0, 1).copy()), torch.from_numpy(tool).long()

    def draw(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw a picture float32 [H, W, 3] and its labels uint8 [H, W]."""
        picture, tool = self._scene(rng)
        view = scenery.rim(rng, self.size)
        tool[view[..., 0] < 0.2] = 0
        return filmed(rng, picture, view), tool

    def _scene(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """A picture float32 [H, W, 3] before the camera, and its labels uint8 [H, W]."""
        if rng.random() < self.real_share:
            source = warp(rng, self.real.labelled[rng.integers(len(self.real.labelled))], self.size)
            picture, tool = source.picture.astype(np.float32) / 255, source.tool.copy()
            drawn = rng.random() < 0.2
        else:
            picture, drawn, tool = self._background(rng), True, np.zeros(self.size, np.uint8)
        if drawn:
            for _ in range(rng.choice([0, 1, 2, 3], p=[0.15, 0.43, 0.3, 0.12])):
                picture, mask = self._with_instrument(rng, picture)
                tool[mask] = 1
        if rng.random() < 0.15:
            scenery.sparkle(rng, picture)
        return picture, tool

    def _background(self, rng: np.random.Generator) -> np.ndarray:
        if self.real.free and rng.random() < 0.45:
            free = self.real.free[rng.integers(len(self.real.free))]
            picture = warp(rng, Labelled(free, np.zeros(free.shape[:2], np.uint8)), self.size).picture / np.float32(255)
            picture *= rng.uniform(0.5, 1.4, 3).astype(np.float32)
        else:
            picture = scenery.tissue(rng, self.size)
        if rng.random() < 0.4:
            scenery.sparkle(rng, picture)
        if rng.random() < 0.35:
            scenery.cloth(rng, picture)
        if rng.random() < 0.15:
            scenery.thread(rng, picture)
        return picture

    def _with_instrument(self, rng: np.random.Generator, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A picture with one more instrument, drawn or pasted, and the mask of its visible part [H, W]."""
        height, width = self.size
        canvas = Canvas(picture.copy(), np.zeros(self.size, bool), rng)
        if self.real.labelled and rng.random() < 0.15:
            self._paste(rng, canvas)
        else:
            # It comes from any border.
            place, size = rng.uniform(-0.1, 1.1), np.array([width, height], np.float64)
            entry = np.array([[0, place], [1, place], [place, 0], [place, 1]][rng.integers(4)]) * size
            way = rng.uniform(0.1, 0.9, 2) * size - entry
            begin = entry - way / max(float(np.hypot(*way)), 1) * 0.12 * width
            wide = rng.uniform(-1.9, -1.1) if rng.random() < 0.14 else rng.uniform(-3.9, -1.9)  # at times an endoscope
            draw_instrument(canvas, begin, entry + way * rng.uniform(0.25, 1.0), width * np.exp(wide))
        mask = canvas.tool
        if rng.random() < 0.15:  # tissue in front of it
            mask &= scenery.smooth_noise(rng, self.size, rng.uniform(2, 6)) < rng.uniform(0.6, 1.5)
        soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), rng.uniform(0.3, 1.0))[..., None]
        if rng.random() < 0.5:  # its shadow
            shift = np.array([[1, 0, rng.normal(0, 0.02 * width)], [0, 1, rng.normal(0, 0.02 * width)]])
            moved = cv2.warpAffine(soft[..., 0], shift, (width, height))
            shadow = cv2.GaussianBlur(moved, (0, 0), rng.uniform(1, 6))[..., None]
            picture = picture * (1 - rng.uniform(0.1, 0.7) * shadow)
        return picture + soft * (canvas.picture - picture), mask

    def _paste(self, rng: np.random.Generator, canvas: Canvas) -> None:
        """Paste one instrument cut out of a real picture."""
        source = warp(rng, self.real.labelled[rng.integers(len(self.real.labelled))], self.size)
        count, parts = cv2.connectedComponents((source.tool == 1).astype(np.uint8))
        part = parts == rng.integers(1, max(count, 2))
        if part.mean() > 0.002:
            gain = np.sqrt(rng.uniform(0.7, 1.3, 3))
            canvas.picture[part], canvas.tool[part] = source.picture[part] / 255 * gain, True


def filmed(rng: np.random.Generator, picture: np.ndarray, view: np.ndarray) -> np.ndarray:
    """A picture as a camera shows it: smoke, vignette, rim, letters, blur, colour, noise, and coding; [H, W, 3].

    Args:
        rng: random numbers.
        picture: in [0, 1], shape [H, W, 3].
        view: view through the endoscope, in [0, 1], shape [H, W, 1].
    """
    size = picture.shape[:2]
    if rng.random() < 0.15:
        smoke = scenery.smooth_noise(rng, size, rng.uniform(1, 4)) * 0.3 + rng.uniform(0, 0.5)
        picture = picture + np.clip(smoke, 0, 0.8)[..., None] * (rng.uniform(0.4, 0.8) - picture)
    if rng.random() < 0.4:
        picture = picture * np.minimum(scenery.lamp(rng, size), 1)
    picture = picture * view + rng.uniform(0, 0.06) * (1 - view)
    if rng.random() < 0.25:
        scenery.lettering(rng, picture)
    if rng.random() < 0.5:
        picture = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.3, 2.0))
    if rng.random() < 0.15:  # by motion
        kernel, turn = np.zeros((15, 15), np.float32), rng.uniform(0, np.pi)
        way = np.array([np.cos(turn), np.sin(turn)]) * rng.uniform(1, 7)
        begin, end = (np.round(7 + side * way).astype(int).tolist() for side in (-1, 1))
        cv2.line(kernel, begin, end, 1.0)
        picture = cv2.filter2D(picture, -1, kernel / kernel.sum())
    picture = np.clip(picture, 0, 1) ** np.exp(rng.normal(0, 0.25))
    mean = picture.mean(axis=2, keepdims=True)
    gain = np.exp(rng.normal(0, 0.08, 3) + rng.normal(0.05, 0.25))
    picture = (mean + (picture - mean) * rng.uniform(0.5, 1.4)) * gain
    if rng.random() < 0.6:
        grain = rng.standard_normal((*size, 1 if rng.random() < 0.5 else 3), dtype=np.float32)
        picture = picture + rng.uniform(0.003, 0.05) * grain
    eight = (np.clip(picture, 0, 1) * 255).astype(np.uint8)
    if rng.random() < 0.3:  # taken at a lower resolution
        share = rng.uniform(0.4, 0.9)
        small = cv2.resize(eight, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
        eight = cv2.resize(small, size[::-1], interpolation=cv2.INTER_LINEAR)
    if rng.random() < 0.5:
        coded = cv2.imencode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(20, 95))])[1]
        eight = np.asarray(cv2.imdecode(coded, cv2.IMREAD_UNCHANGED))
    return eight.astype(np.float32) / 255
