"""Base of what is written for a clip, and the registry of its kinds."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from palpate.common.registry import Registry
from palpate.estimators.contract import Estimator
from palpate.estimators.records import FrameEstimate, InteractionEstimate

if TYPE_CHECKING:
    from palpate.results.writer import ClipResults

_built_in = ("tables:FrameTable", "tables:ContactTable", "tables:CalibratedTable", "forces:ForceFile")
_built_in += ("results:ResultFile", "overlay:Overlay", "fit:FitPicture", "fields:FieldFile", "export:Export")
_built_in += ("bag:Ros1Bag", "bag:Ros2Bag")
ARTEFACTS = Registry("file", "palpate.artefacts", {name: f"palpate.results.artefacts.{name}" for name in _built_in})
"""Files that are written for a clip, in this order."""


class Artefact:
    """File, or files, written for one clip: opened with the clip, closed with it; methods do nothing by default.

    Args:
        clip: results of the clip; `clip.partial` is the folder to write into.

    Raises:
        OSError: the file can't be written (also from the methods).
    """

    name: ClassVar[str] = ""
    """Name of the file; empty where names depend on the clip."""
    option: ClassVar[str] = ""
    """Option of the program that asks for it; empty where it is always written."""
    pictures: ClassVar[bool] = False
    """True if `frame` needs pictures and labels."""
    columns: Mapping[str, str] | None = None
    """Columns of a table, each with what it is, for run.json."""

    def __init__(self, clip: ClipResults) -> None:
        self.clip, self.path = clip, clip.partial / self.name
        self.open()

    @classmethod
    def wanted(cls, options: argparse.Namespace, estimator: Estimator) -> bool:
        """Return whether the options of the program and the estimator ask for it."""
        return not cls.option or getattr(options, cls.option) not in (None, False)

    def open(self) -> None:
        """Open the file."""

    def frame(self, estimate: FrameEstimate, image: np.ndarray | None, labels: np.ndarray | None) -> None:
        """Take the next frame, in order, once its contact has ended.

        Args:
            estimate: result of the frame, no surer than its contact.
            image: RGB uint8 [H, W, 3]; None where it could not be read.
            labels: label map uint8 [h, w]; None where there is none.
        """

    def contact(self, run: InteractionEstimate) -> None:
        """Take a contact that has ended, after its frames."""

    def warnings(self) -> Iterator[str]:
        """Yield sentences for run.json, after the last contact."""
        yield from ()

    def finish(self) -> None:
        """Write what is left, after the last frame."""

    def close(self) -> None:
        """Close the file, finished or not."""


def artefacts(options: argparse.Namespace, estimator: Estimator) -> list[type[Artefact]]:
    """Return the kinds of files that options and estimator ask for."""
    kinds = (ARTEFACTS[name] for name in ARTEFACTS.entries)
    return [kind for kind in kinds if kind.wanted(options, estimator)]
