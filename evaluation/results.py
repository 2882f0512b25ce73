"""One clip's results: table, overlay, summary and record, in a folder that is complete or not there at all."""

from __future__ import annotations

import csv
import shutil
import time
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from estimators.amortized import FrameResult
from estimators.estimate import UNCERTAINTY, FrameEstimate
from evaluation.overlay import OverlayVideo, draw_overlay
from evaluation.result_store import (
    OVERLAY,
    SUMMARY,
    TABLE,
    partial_folder,
    publish,
    remove_leftovers,
    write_record,
    writing,
)
from evaluation.summary import draw_summary, write_summary

COLUMNS: dict[str, str] = {
    "frame": "number of the frame in its source",
    "time_s": "s",
    "stiffness": "k_s",
    "stiffness_sd": "standard deviation of stiffness; empty: the model gives none",
    "damping": "k_d",
    "damping_sd": "standard deviation of damping; empty: the model gives none",
    "force": "magnitude |F|",
    "force_sd": "standard deviation of force; empty: the model gives none",
    "contact": "1 or 0; empty: undecided",
    "contact_distance": "scene units",
    "contact_u": "px of the source frame, column",
    "contact_v": "px of the source frame, row",
    "simulated_displacement": "scene units",
    "observed_displacement": "scene units",
    "status": "ok, or why the frame has no parameters",
    "verdict": "determined, ratios (only k_s/k_d and F/k_d), undetermined; onset_in_view: the model doesn't tell",
    **UNCERTAINTY,
    "detail": "sentence about the status",
}
"""Columns of the table, in order, each with what it is."""


class ClipResults:
    """Writes one clip's results into a hidden folder beside the final one, and moves it there when all is done.

    Use as a context manager; leaving it without `finish` removes what was written and leaves earlier results alone.

    Args:
        folder: final folder of the clip.
        size: width and height of the source frames [px].
        fps: frames a second of the overlay.
        units: unit of "stiffness", "damping", "force" and "displacement".
        overlay: whether to write the overlay video.

    Raises:
        OutputError: the output folder is full or can't be written (also from the methods).
    """

    def __init__(
        self, folder: Path, size: tuple[int, int], fps: float, units: Mapping[str, str], *, overlay: bool = True
    ) -> None:
        self.folder, self._size, self._units = folder, size, units
        self.estimates: list[FrameEstimate] = []
        self.encoder = ""
        """Name of the video encoder; empty without an overlay."""
        self.seconds: dict[str, float] = defaultdict(float)
        """Time spent so far on the `overlay` [s]."""
        self._partial = partial_folder(folder)
        self._table: IO[str] | None = None
        self._video: OverlayVideo | None = None
        try:
            with writing(folder.parent):
                remove_leftovers(folder)
                self._partial.mkdir()
                self._table = (self._partial / TABLE).open("w", encoding="utf-8", errors="replace", newline="")
                self._rows = csv.writer(self._table)
                self._rows.writerow(COLUMNS)
                if overlay:
                    self._video = OverlayVideo(self._partial / OVERLAY, size, fps)
                    self.encoder = self._video.encoder
        except BaseException:
            self._discard()
            raise

    def __enter__(self) -> ClipResults:
        return self

    def __exit__(self, *exception: object) -> None:
        self._discard()

    def write(self, result: FrameResult) -> None:
        """Append one frame: its row, and its picture where there is an overlay."""
        start = time.perf_counter()
        estimate, prepared = result.estimate, result.prepared
        self.estimates.append(estimate)
        with writing(self.folder.parent):
            self._rows.writerow(table_row(estimate))
            if self._video is not None:
                labels, unit = prepared.picture_labels, self._units.get("stiffness", "")
                image = prepared.frame.image
                picture = draw_overlay(image, self._size, labels, estimate, arrow=result.arrow, unit=unit)
                self._video.write(picture)
        self.seconds["overlay"] += time.perf_counter() - start

    def finish(self, record: Mapping[str, Any], *, title: str, subtitle: str) -> None:
        """Write the summary and the record (as JSON), and move everything to its final place."""
        with writing(self.folder.parent):
            self._close_video()
            self._table.close()
            picture = draw_summary(self.estimates, title=title, subtitle=subtitle, units=self._units)
            write_summary(self._partial / SUMMARY, picture)
            write_record(self._partial, record)
            publish(self._partial, self.folder)

    def _close_video(self) -> None:
        if self._video is not None:
            self._video.close()
            self._video = None

    def _discard(self) -> None:
        """Close what is open and remove the hidden folder; nothing here may hide the error that led to it."""
        with suppress(OSError):
            if self._table is not None:
                self._table.close()
        with suppress(Exception):
            self._close_video()
        shutil.rmtree(self._partial, ignore_errors=True)


def table_row(estimate: FrameEstimate) -> list[str]:
    """The cells of one frame, in the order of COLUMNS."""
    return [cell(getattr(estimate, name), decimals=6 if name == "time_s" else None) for name in COLUMNS]


def cell(value: float | int | bool | str | None, *, decimals: int | None = None) -> str:
    """A value as text: seven significant digits (float32's), or a fixed number of decimals, and text on one line."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, float):
        return f"{value:.7g}" if decimals is None else f"{value:.{decimals}f}"
    return " ".join(str(value).split())
