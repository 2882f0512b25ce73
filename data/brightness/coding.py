"""What coding does to the light around a contact, found by coding what a fit expects once more.

A dent's slow growth and its recovery are hardly worth a coder's bits, and a place that an instrument uncovers is coded
coarsely at first: in coded video tissue seems to recover more slowly than it does, which no noise says. Pictures of the
tissue at rest, darkened as the fit expects, noisy as a sensor's and coded as the video was, are as far from what they
were before as the video is from the truth, on average.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from palpate.data.brightness.light import DARKEST, SRGB, not_tissue
from palpate.data.source.coding import Coding, recoded

AROUND, BLOCK = 48, 16
"""Pixels kept around what is compared, so that a coder finds what it predicts from, and the side of its blocks [px]."""
NOISES = (0.0, 1.0, 2.5, 6.0)
"""Standard deviations of the sensor's noise that are tried [levels of 8 bits]."""
LONG, SHORT = 32, 16
"""Frames at rest by which quality is chosen, as many as of the video (quality falls towards a sequence's end), and the
noise."""
FIRST = 4
"""The first ones, coded whole, count for nothing in the noise."""
DRAWS = 2
"""Sequences whose mean is what coding does."""
LEAST_CHANGE, WIDTH = 0.02, 1.5
"""Around smaller expected changes of light coding is taken to change less, in proportion: nothing on average where
tissue is still, so that only the noise of what was drawn would be added. And around means within how many places."""
LEAST_RATE, LARGEST_RATE = 1.0, 45.0
"""Constant rate factors that are used."""
FEWEST_REST = 3
"""Fewer pictures of the tissue at rest tell neither its light nor its noise."""


@dataclass(frozen=True, eq=False)
class CodedPictures:
    """Pictures around a contact as they came out of a video: K at rest, then T from its onset on, of H × W pixels."""

    coding: Coding
    """Of the video."""
    pictures: Sequence[np.ndarray]
    """RGB, uint8 [H, W, 3] each."""
    tissue: Sequence[np.ndarray]
    """Where nothing but tissue is near, bool [H, W] each."""
    rest: int
    """K."""
    frames: np.ndarray
    """Which of the T the frames of a brightness sequence are, shape [N]."""
    places: np.ndarray
    """Row and column in these pictures of the lattice's places along either axis, shape [2, L] [px]."""

    def chosen(self, frames: np.ndarray) -> "CodedPictures":
        """The same for some frames of the sequence: a mask [N] or indices."""
        return dataclasses.replace(self, frames=self.frames[frames])


class PictureRecorder:
    """Cuts pictures around a contact.

    Args:
        coding: of the video.
        first: row and column of the lattice's first place that is compared.
        side: places along either axis.
        shape: rows and columns of the whole lattice.
        rest: pictures of the tissue at rest with their label maps, uint8 [h, w, 3] and [h, w], at least one.
    """

    def __init__(
        self,
        coding: Coding,
        first: np.ndarray,
        side: int,
        shape: tuple[int, ...],
        rest: Sequence[tuple[np.ndarray, np.ndarray]],
    ) -> None:
        self._coding, size = coding, np.array(rest[0][0].shape[:2])
        pitch = size / shape
        low = np.floor((first * pitch - AROUND) / BLOCK).astype(int).clip(0) * BLOCK
        high = np.ceil((first + side) * pitch + AROUND).astype(int).clip(0, size)
        high -= (high - low) % 2
        self._window = tuple(map(slice, low, high))
        places = (np.add.outer(first, np.arange(side)) + 0.5) * pitch[:, None] - 0.5
        self._places = (places - low[:, None]).astype(np.float32)
        self._width = int(size[1])
        self._kept = [self._cut(*each) for each in rest]
        self._rest = len(rest)

    def _cut(self, picture: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return picture[self._window].copy(), not_tissue(labels[self._window], self._width) == 0

    def add(self, shown: tuple[np.ndarray, np.ndarray] | None) -> None:
        """The next frame from the onset on; one without a picture counts as if it showed what the last one does."""
        self._kept.append(self._kept[-1] if shown is None else self._cut(*shown))

    def pictures(self, frames: np.ndarray) -> CodedPictures:
        """What was kept, for a sequence of such frames, counted from the onset, shape [N]."""
        pictures, tissue = zip(*self._kept, strict=True)
        return CodedPictures(self._coding, pictures, tissue, self._rest, np.asarray(frames, int), self._places)


def coding_error(shown: CodedPictures, change: np.ndarray) -> np.ndarray:
    """What coding adds to the logarithm of light over that at rest, shape [N, L, L].

    Args:
        shown: the video's pictures.
        change: of the logarithm of light as a fit expects it, shape [N, L, L].
    """
    still = _at_rest(shown)
    levels = _levels(still)
    quality, noise = _matched(shown, levels)
    generator, (height, width) = np.random.default_rng(0), shown.tissue[0].shape
    # The change between the lattice's places, and none beyond them.
    rows, columns = (
        np.interp(np.arange(size), at, np.arange(len(at)), -1, len(at)).astype(np.float32)
        for size, at in zip((height, width), shown.places, strict=True)
    )
    across, down = np.meshgrid(columns, rows)
    expected = np.zeros((len(shown.pictures), height, width), np.float32)
    for frame, one in zip(shown.rest + shown.frames, np.nan_to_num(change).astype(np.float32), strict=True):
        expected[frame] = cv2.remap(one, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    total = np.zeros(change.shape)
    for _ in range(DRAWS):
        drawn = []
        for one, picture, tissue in zip(expected, shown.pictures, shown.tissue, strict=True):
            darker = _levels(still * np.exp(one)[..., None]) if one.any() else levels
            found = _noisy(darker, noise, generator)
            drawn.append(np.where(tissue[..., None], found, picture))
        came = recoded(drawn, quality, shown.coding.bidirectional)[0]
        pairs = zip(came, drawn, strict=True)
        error = np.stack([_light(one, shown.places) - _light(other, shown.places) for one, other in pairs])
        total += error[shown.rest + shown.frames] - np.median(error[: shown.rest], axis=0)
    near = gaussian_filter(np.abs(np.nan_to_num(change)), (0, WIDTH, WIDTH))
    return np.minimum(near / LEAST_CHANGE, 1) * total / DRAWS


def _at_rest(shown: CodedPictures) -> np.ndarray:
    """Light of the tissue at rest, float32 [H, W, 3]: the mean of pictures that show it."""
    counted = np.stack(shown.tissue[: shown.rest])[..., None]
    light = np.where(counted, SRGB[np.stack(shown.pictures[: shown.rest])], 0).sum(axis=0, dtype=np.float32)
    return np.where(counted.any(axis=0), light / np.maximum(counted.sum(axis=0), 1), SRGB[shown.pictures[0]])


def _matched(shown: CodedPictures, levels: np.ndarray) -> tuple[float, float]:
    """Constant rate factor that quantises as the video does, and noise [levels] that changes still tissue as much.

    Args:
        shown: the video's pictures.
        levels: of still tissue, shape [H, W, 3].
    """
    rest = np.stack(shown.pictures[: shown.rest]).astype(np.int16)
    tissue = np.all(shown.tissue[: shown.rest], axis=0)
    flicker = float(np.abs(np.diff(rest, axis=0))[:, tissue].mean()) if tissue.any() else 0.0
    quality, changes = shown.coding.quantiser, []
    for attempt, noise in enumerate((NOISES[1], *NOISES)):
        generator = np.random.default_rng(1)
        drawn = [_noisy(levels, noise, generator) for _ in range(SHORT if attempt else LONG)]
        came, coding = recoded(drawn, quality, shown.coding.bidirectional)
        if attempt:
            changes.append(float(np.abs(np.diff(came[FIRST:].astype(np.int16), axis=0))[:, tissue].mean()))
        elif coding is not None:
            quality = float(np.clip(quality + shown.coding.quantiser - coding.quantiser, LEAST_RATE, LARGEST_RATE))
    return quality, float(np.interp(flicker, np.maximum.accumulate(changes), NOISES))


def _levels(light: np.ndarray) -> np.ndarray:
    """Levels of 8 bits, not rounded, that stand for light in sRGB, shape [H, W, 3] each."""
    return np.interp(light, SRGB, np.arange(256.0))


def _noisy(levels: np.ndarray, noise: float, generator: np.random.Generator) -> np.ndarray:
    """A picture of such levels with a sensor's noise [levels], uint8 [H, W, 3]."""
    return np.clip(np.rint(levels + generator.normal(0, noise, levels.shape)), 0, 255).astype(np.uint8)


def _light(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Logarithm of the light of red and green around the lattice's places, shape [L, L]."""
    light = 0.5 * (cv2.LUT(picture[..., 0], SRGB) + cv2.LUT(picture[..., 1], SRGB))
    pitch = tuple(max(round(float(at[1] - at[0])), 1) for at in places)
    columns, rows = np.meshgrid(places[1], places[0])
    mean = cv2.remap(cv2.blur(light, pitch[::-1]), columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.log(np.maximum(mean, DARKEST))
