"""One clip's results: tables, overlay, pictures and record, in a folder that is complete or not there at all."""

from __future__ import annotations

import csv
import importlib
import math
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.common.files import as_json
from palpate.data.prepared import PreparedFrame
from palpate.data.source.video import Video
from palpate.estimators.estimate import Estimate, NoEstimate
from palpate.estimators.force_scale import ClipLength
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.results import columns, store
from palpate.results.agreement import REVISED, agreed
from palpate.results.alarm import BELOW, UNKNOWN, ForceAlarm
from palpate.results.calibrated import ClipCalibration
from palpate.results.field_file import FieldFile
from palpate.results.forces import ContactForce, forces_record
from palpate.results.overlay import canvas_size, draw_overlay
from palpate.results.plots import MOST_PANELS, draw_fits, write_figure
from palpate.results.spool import FrameSpool, Waiting
from palpate.results.store import writing
from palpate.results.verdicts import state
from palpate.results.vtu import deformation_of, write_series


class ClipResults:
    """Writes one clip's results into a hidden folder next to the final one, and moves it there when all is done.

    Use as a context manager; leaving it without `finish` removes what was written and leaves earlier results alone.

    Args:
        folder: final folder of the clip.
        size: width and height of the source frames [px].
        fps: frames a second of the overlay.
        overlay: whether to write the overlay video.
        calibration: gives newtons.
        fields: whether the estimator gives fields of stiffness.
        waits: whether pictures of a contact wait for its end, so that they agree with it.
        alarm: takes the frames' forces, in newtons where there is a `calibration` with the clip's length.
        seconds: time after the onset of contact up to which an estimate by depth constrains the force [s].
        export: whether the deformation of every contact is written as .vtu files.
        bag: writes a bag into a folder from what forces.json has of the contacts.

    Raises:
        OutputError: the output folder is full or can't be written (also from the methods).
    """

    def __init__(
        self,
        folder: Path,
        size: tuple[int, int],
        fps: float,
        *,
        overlay: bool = True,
        calibration: ClipCalibration | None = None,
        fields: bool = False,
        waits: bool = False,
        alarm: ForceAlarm | None = None,
        seconds: float = math.inf,
        export: bool = False,
        bag: Callable[[Path, list[dict[str, Any]]], None] | None = None,
    ) -> None:
        self.folder, self._size, self._export, self._bag = folder, size, export, bag
        self._fps, self._seconds = fps, seconds
        self.calibration, self.alarm = calibration, alarm
        self.length = ClipLength(math.nan)
        """Of a scene unit, once it is known."""
        self.columns = columns.FRAMES | ({} if alarm is None else columns.ALARM)
        """Of parameters.csv."""
        self.estimates: list[FrameEstimate] = []
        self._cells: list[list[str]] = []
        """Rows of the latest frames, which wait for the end of their contact."""
        self.seconds: dict[str, float] = defaultdict(float)
        """Time spent so far on the `overlay` [s]."""
        self.counts: Counter[str] = Counter()
        """Number of runs of contact by verdict."""
        self.unexplained: Counter[str] = Counter()
        """Number of those without an estimate by why they have none."""
        self._contacts: list[ContactForce] = []
        self.unexported = 0
        """Number of contacts whose deformation could not be exported."""
        self.drawn: list[InteractionEstimate] = []
        """Those for the picture, with a motion first."""
        self.stretched = False
        """Whether tissue has anywhere stretched with an instrument."""
        self.lag = 0.0
        """The largest of the contacts' lags [levels of 8 bits]."""
        self._open = ExitStack()
        self._drawing: deque[Future[None]] = deque()
        """Pictures that are drawn and coded in a thread of their own, in order."""
        try:
            with writing(folder.parent):
                self._partial = store.partial_folder(folder)
                self._rows = self._open_table(store.TABLE, self.columns)
                self._runs = self._open_table(store.INTERACTIONS, columns.INTERACTIONS)
                keep = self._open.enter_context
                self._fields = keep(closing(FieldFile(self._partial / store.FIELDS))) if fields else None
                video = self._partial / store.OVERLAY
                self._video = keep(closing(Video(video, canvas_size(size), fps))) if overlay else None
                self._drawer = keep(ThreadPoolExecutor(1, "overlay"))
                # What `finish` needs is loaded meanwhile: it takes most of a second.
                self._drawer.submit(importlib.import_module, "matplotlib.figure")
                self._waiting = keep(closing(FrameSpool(self._partial))) if overlay and waits else None
        except BaseException:
            self.__exit__()
            raise

    def __enter__(self) -> ClipResults:
        return self

    def __exit__(self, *exception: object) -> None:
        """Close what is open and settle the hidden folder; nothing here may hide the error that led to it."""
        with suppress(Exception):
            self._open.close()
        with suppress(Exception):
            store.settle(self.folder)

    def write(self, prepared: PreparedFrame, estimate: FrameEstimate) -> None:
        """Append one frame: its row, and its picture where there is an overlay."""
        if self.alarm is not None:
            upper_end = None if self.calibration is None else self.calibration.upper_force
            estimate = self.alarm.watch(estimate, upper_end)
        self.estimates.append(replace(estimate, field=None))  # memory must not grow with the clip
        with writing(self.folder.parent):
            cells = columns.row(self.columns, estimate.values)
            if estimate.contact or self._cells:
                self._cells.append(cells)
            else:
                self._rows.writerow(cells)
            if self._fields is not None and estimate.field is not None:
                self._fields.write(estimate.frame, estimate.field)
            shown = Waiting(prepared.frame.image, prepared.picture_labels, estimate)
            if self._waiting is not None and (len(self._waiting) or estimate.contact):
                self._waiting.add(shown)
            else:
                self._draw(shown)

    def _draw(self, frame: Waiting) -> None:
        """Append a picture to the overlay, if there is one, once those before it are drawn."""
        if self._video is not None:
            while len(self._drawing) >= 4:
                self._drawing.popleft().result()
            self._drawing.append(self._drawer.submit(self._drawn, self._video, frame))

    def _drawn(self, video: Video, frame: Waiting) -> None:
        start = time.perf_counter()
        video.write(draw_overlay(frame.image, self._size, frame.labels, frame.estimate))
        self.seconds["overlay"] += time.perf_counter() - start

    def _agree(self, run: InteractionEstimate, contact: ContactForce) -> None:
        """Bring the frames that wait into agreement with their contact, which has ended."""
        forces = dict(zip(contact.frames.tolist(), contact.relative.T.tolist(), strict=True))
        begun = len(self.estimates) - len(self._cells)
        places = [list(self.columns).index(name) for name in REVISED if name in self.columns]
        for index, cells in enumerate(self._cells, start=begun):
            before = self.estimates[index]
            frame = self.estimates[index] = agreed(before, run, forces.get(index, [math.nan] * 3))
            if self.alarm is not None and frame.alarm != before.alarm:
                self.alarm.frames.update({BELOW: -1, UNKNOWN: 1})
            if frame is not before:
                revised = columns.row(self.columns, frame.values)
                for place in places if frame.estimate is before.estimate else range(len(cells)):
                    cells[place] = revised[place]

    def _write_waiting(self) -> None:
        """Append the rows and pictures that wait for the end of a contact."""
        self._rows.writerows(self._cells)
        frames = self.estimates[len(self.estimates) - len(self._cells) :]
        self._cells = []
        if self._waiting is not None:
            for frame, estimate in zip(self._waiting.drain(), frames, strict=True):
                self._draw(frame._replace(estimate=estimate))

    def add(self, run: InteractionEstimate) -> None:
        """Append a run of contact, and its force in newtons where some of it is known."""
        forces = None
        if self.calibration is not None:
            try:
                forces = self.calibration.add(run)
            except NoEstimate as reason:
                run = replace(run, detail=f"{run.detail} {reason}".strip())
        if self.alarm is not None:
            self.alarm.end_run()
        if run.field is not None:
            self.stretched |= run.field.stretched
        if isinstance(run.estimate, Estimate):
            self.lag = max(self.lag, run.estimate.lag)
        contact = ContactForce.of(run, self.estimates, forces, self._seconds)
        self._contacts.append(contact)
        self._agree(run, contact)
        self.counts[state(run)] += 1
        if state(run) == "no_estimate":
            self.unexplained[run.detail] += 1
        shown = [*self.drawn, run]
        self.drawn = sorted(shown, key=lambda item: item.simulated is None and not item.verdict)[:MOST_PANELS]
        with writing(self.folder.parent):
            self._write_waiting()
            self._runs.writerow(columns.row(columns.INTERACTIONS, columns.interaction_values(run)))
            if self._export:
                times = np.array([frame.time_s for frame in self.estimates[run.onset :]]) - run.onset_time_s
                try:
                    write_series(self._partial, f"scene_{run.onset_frame}", deformation_of(run, times))
                except NoEstimate:
                    self.unexported += 1

    def calibrate(self, length: ClipLength) -> None:
        """Say in millimetres and newtons what was added, once all of it has been."""
        self.length = length
        if self.calibration is not None:
            self.calibration.conclude(length)

    def finish(self, record: Mapping[str, Any], *, title: str) -> None:
        """Write the pictures and the record (as JSON), and move everything to its final place."""
        with writing(self.folder.parent):
            self._write_waiting()
            while self._drawing:
                self._drawing.popleft().result()
            rows = () if self.calibration is None else self.calibration.rows
            if self.calibration is not None:
                table = self._open_table(store.CALIBRATED, columns.CALIBRATED)
                table.writerows(columns.row(columns.CALIBRATED, values) for values in rows)
            self._open.close()
            write_figure(self._partial / store.FIT, draw_fits(self.drawn, self.counts, title))
            report = forces_record(self._contacts, self.estimates, self._fps, rows, self.length)
            (self._partial / store.REPORT).write_text(as_json(report) + "\n", encoding="utf-8")
            if self._bag is not None:
                self._bag(self._partial, report["contacts"])
            store.write_record(self._partial, record)
            store.publish(self._partial, self.folder)

    def _open_table(self, name: str, header: Mapping[str, str]) -> Any:
        """A CSV file with its head written, open as long as all of the clip's."""
        path = self._partial / name
        rows = csv.writer(self._open.enter_context(path.open("w", encoding="utf-8", errors="replace", newline="")))
        rows.writerow(header)
        return rows
