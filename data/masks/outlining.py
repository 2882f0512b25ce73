"""A session in which a person outlines instruments: a clip's frames, cuts by strokes, and tracked outlines."""

import itertools
import os
import threading
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from palpate.common.files import as_json, replacing
from palpate.data.labels import MaskError
from palpate.data.masks.cut import InstrumentCut, Stroke
from palpate.data.masks.outlined import OutlinedMasks, read_outlines
from palpate.data.masks.rigid import filled
from palpate.data.source.frames import Frame, open_source
from palpate.data.source.images import read_image
from palpate.data.source.layout import ClipLayout, InputError

Polygons = list[list[list[float]]]
"""Corners (column, row) [px] of instruments."""


class OutlineSession:
    """Reads a clip in the background; its results are JSON values.

    Args:
        clip: a video file or a folder of frames.
        output: YAML file that `--masks` reads; outlines that it holds are shown and go on.

    Raises:
        InputError: the clip or the file can't be used, or the file couldn't be written.
    """

    def __init__(self, clip: Path, output: Path) -> None:
        self._source, self.output = open_source(clip, ClipLayout()), output
        if not os.access(output.absolute().parent, os.W_OK):
            raise InputError(f"{output} can't be written; give a file in a folder that exists and is yours.")
        self._outlines = dict(read_outlines(output)) if output.exists() else {}
        self._cut, self._busy, self._followed = InstrumentCut(), threading.Lock(), 0
        self._frames: list[Frame] = []
        """Frames read so far, without their pictures, which lie in `_folder`."""
        self._problem, self._closed = "", False
        self._found: dict[str, Any] = {"shown": {}, "lost": {}}
        """Last result of tracking: outlines, or errors, by frame number."""
        self._folder = TemporaryDirectory(prefix="palpate-outline-")
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def close(self) -> None:
        """Remove the frames; saved outlines stay."""
        self._closed = True
        self._reader.join()
        self._folder.cleanup()

    def _read(self) -> None:
        try:
            for frame in self._source:
                if self._closed:
                    return
                if frame.image is not None:
                    bgr = cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR)
                    coded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
                    self.picture(len(self._frames)).write_bytes(coded.tobytes())
                self._frames.append(Frame(frame.index, frame.number, frame.time_s, None, error=frame.error))
        except (ValueError, OSError) as error:
            self._problem = str(error)

    def picture(self, place: int) -> Path:
        """File of a frame's picture by its place in the clip."""
        return Path(self._folder.name, f"{place}.jpg")

    def state(self) -> dict[str, Any]:
        """Content of the page: the clip's frames so far, the outlines, and the progress of tracking."""
        return {
            "name": self._source.name,
            "size": self._source.size,
            "reading": self._reader.is_alive(),
            "problem": self._problem,
            "output": str(self.output),
            "followed": self._followed,
            "numbers": [frame.number for frame in self._frames],
            "outlines": {number: [each.tolist() for each in found] for number, found in self._outlines.items()},
            **self._found,
        }

    def cut(self, place: int, strokes: list[tuple[list[list[float]], bool]], begin: Polygons) -> Polygons:
        """Polygons of the instrument under some strokes (points, on the instrument or beside), from others on."""
        drawn = [Stroke(np.array(points, np.float64).reshape(-1, 2), bool(on)) for points, on in strokes]
        polygons = [np.array(polygon, np.float64) for polygon in begin]
        found = self._cut.outlines(read_image(self.picture(place)), drawn, polygons)
        return [np.round(polygon, 1).tolist() for polygon in found]

    def follow(self, outlines: Mapping[str, Polygons]) -> dict[str, Any]:
        """Save outlines by frame number and track the instruments; return polygons, or errors, by frame."""
        with self._busy:
            with replacing(self.output) as partial:
                partial.write_text(as_json({int(number): outlines[number] for number in sorted(outlines, key=int)}))
                self._outlines = dict(read_outlines(partial))
            masks, shown, lost = OutlinedMasks(self.output), {}, {}
            for place, frame in enumerate(self._frames):
                self._followed = place
                try:
                    picture = read_image(self.picture(place))
                    masks(Frame(frame.index, frame.number, frame.time_s, picture))
                    parts = (_visible(outline, picture.shape[:2]) for outline in masks.outlines)
                    shown[frame.number] = [*itertools.chain.from_iterable(parts)]
                except (MaskError, InputError) as error:
                    lost[frame.number] = frame.error or str(error)
            self._found = {"shown": shown, "lost": lost}
            return self._found | {"output": str(self.output)}


def _visible(outline: np.ndarray, size: tuple[int, int]) -> Polygons:
    """Part of an outline [K, 2] (column, row) [px] that lies in a picture of that height and width."""
    mask = filled(np.zeros(size, np.uint8), outline, 1)
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return [polygon.tolist() for each in found if len(polygon := cv2.approxPolyDP(each, 1.0, True)[:, 0]) > 2]
