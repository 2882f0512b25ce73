"""One clip's results: tables, overlay, pictures and record, in a folder that is complete or not there at all."""

from __future__ import annotations

import csv
import time
from collections import Counter, defaultdict
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from data.prepared import PreparedFrame
from estimators.estimate import FrameEstimate, InteractionEstimate
from results import columns
from results.interactions import MOST_PANELS, contact_panel, draw_contacts, state
from results.overlay import OverlayVideo, draw_overlay
from results.plots import ContactPanel, draw_summary, write_figure
from results.store import (
    FIT,
    INTERACTIONS,
    OVERLAY,
    SUMMARY,
    TABLE,
    OutputError,
    partial_folder,
    publish,
    settle,
    write_record,
    writing,
)


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
        self.counts: Counter[str] = Counter()
        """Number of runs of contact by verdict."""
        self._panels: list[ContactPanel] = []
        self._tables: list[IO[str]] = []
        self._video: OverlayVideo | None = None
        try:
            with writing(folder.parent):
                self._partial = partial_folder(folder)
                self._rows = self._open_table(TABLE, columns.FRAMES)
                self._runs = self._open_table(INTERACTIONS, columns.INTERACTIONS)
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

    def write(self, prepared: PreparedFrame, estimate: FrameEstimate) -> None:
        """Append one frame: its row, and its picture where there is an overlay."""
        start = time.perf_counter()
        self.estimates.append(estimate)
        with writing(self.folder.parent):
            self._rows.writerow(columns.frame_row(estimate))
            if self._video is not None:
                labels, unit = prepared.picture_labels, self._units.get("stiffness", "")
                image = prepared.frame.image
                self._video.write(draw_overlay(image, self._size, labels, estimate, unit=unit))
        self.seconds["overlay"] += time.perf_counter() - start

    def add(self, run: InteractionEstimate) -> None:
        """Append a run of contact; what it was made of is not kept."""
        self.counts[state(run)] += 1
        drawn = sum(panel.motion is not None for panel in self._panels)
        if len(self._panels) < MOST_PANELS or (run.simulated is not None and drawn < MOST_PANELS):
            self._panels.append(contact_panel(run))
            self._panels.sort(key=lambda panel: panel.motion is None)
            del self._panels[MOST_PANELS:]
        with writing(self.folder.parent):
            self._runs.writerow(columns.interaction_row(run))

    def finish(self, record: Mapping[str, Any], *, title: str, subtitle: str) -> None:
        """Write the pictures and the record (as JSON), and move everything to its final place."""
        with writing(self.folder.parent):
            self._close_video()
            for table in self._tables:
                table.close()
            summary = draw_summary(self.estimates, title=title, subtitle=subtitle, units=self._units)
            write_figure(self._partial / SUMMARY, summary)
            write_figure(self._partial / FIT, draw_contacts(self._panels, self.counts, title))
            write_record(self._partial, record)
            publish(self._partial, self.folder)

    def _open_table(self, name: str, header: Mapping[str, str]) -> Any:
        self._tables.append((self._partial / name).open("w", encoding="utf-8", errors="replace", newline=""))
        rows = csv.writer(self._tables[-1])
        rows.writerow(header)
        return rows

    def _close_video(self) -> None:
        if self._video is not None:
            self._video.close()
            self._video = None

    def _discard(self) -> None:
        """Close what is open and settle the hidden folder; nothing here may hide the error that led to it."""
        with suppress(OSError):
            for table in self._tables:
                table.close()
        with suppress(Exception):
            self._close_video()
        with suppress(OSError, OutputError):
            settle(self.folder)
