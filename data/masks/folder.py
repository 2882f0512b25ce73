"""Masks in a folder of their own, a picture a frame: those of a video, say, that another program has made."""

import re

import numpy as np

from palpate.data.labels import TISSUE, TOOL, MaskError
from palpate.data.masks.annotation import read_annotation, read_mask
from palpate.data.masks.lit import lit_picture
from palpate.data.masks.request import MaskRequest
from palpate.data.source.frames import Frame
from palpate.data.source.layout import IMAGE_SUFFIXES, InputError, list_folder, matches


class FolderMasks:
    """Mask source (see `masks.MaskSource`) of pictures that are numbered as the frames are.

    Pictures by a mask pattern of the layout are read as annotation. In others an instrument is what is not black, and
    tissue the lit rest. A video's frames count from 0; from 1 where there is a picture 1 and no picture 0.

    Raises:
        InputError: the folder holds no masks.
    """

    def __init__(self, asked: MaskRequest) -> None:
        self._folder, self._layout, self._classes = asked.file, asked.layout, asked.classes
        found = ((pattern, matches(asked.file, pattern)) for pattern in asked.layout.mask_patterns)
        self._pattern, files = next((each for each in found if each[1]), ("", []))
        if not files:
            pictures = [path for path in list_folder(asked.file) if path.suffix.lower() in IMAGE_SUFFIXES]
            files = [(number[-1], path) for path in pictures if (number := re.findall(r"\d+", path.stem))]
        self._files = {int(digits): path for digits, path in files}
        if not self._files:
            raise InputError(f"{asked.file} holds no masks; give pictures whose names end in the numbers of frames.")
        self._first = int(not asked.clip.is_dir() and 0 not in self._files and 1 in self._files)
        self.identity = f"folder:1:{asked.file}:{self._pattern}:{self._classes}"

    def reset(self) -> None:
        """Nothing is remembered from frame to frame."""

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map of a frame, uint8 [H, W].

        Raises:
            MaskError: it has no mask, or none that can be read.
        """
        file, size = self._files.get(frame.number + self._first), frame.picture.shape[:2]
        if file is None:
            raise MaskError(f"{self._folder} holds no mask {frame.number + self._first}; add it for this frame.")
        if self._pattern:
            return read_annotation(file, self._pattern, size, self._layout, self._classes)
        mask = read_mask(file, size)
        labels = lit_picture(frame.picture).astype(np.uint8) * np.uint8(TISSUE)
        labels[mask.reshape(*size, -1).any(axis=2)] = TOOL
        return labels
