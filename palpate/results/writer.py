"""One clip's results, in a folder that is complete or not there at all."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from palpate.common.stages import StageSeconds
from palpate.data.prepared import PreparedFrame
from palpate.data.source.frames import FrameSource
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.force_scale import ClipLength
from palpate.estimators.records import FrameEstimate, InteractionEstimate
from palpate.results import store
from palpate.results.agreement import agreed
from palpate.results.alarm import BELOW, UNKNOWN, ForceAlarm
from palpate.results.artefacts.base import Artefact
from palpate.results.artefacts.forces import ContactForce, forces_record
from palpate.results.calibrated import ClipCalibration
from palpate.results.spool import FrameSpool, Shown
from palpate.results.store import writing
from palpate.results.verdicts import state


class ClipResults:
    """Results of one clip, gathered in a hidden folder next to the final one, and moved there when all is done.

    Use as a context manager; leaving it without `finish` removes what was written and leaves earlier results alone.

    Args:
        folder: final folder of the clip.
        source: the clip.
        kinds: what is written.
        calibration: gives newtons.
        alarm: takes the frames' forces, in newtons where there is a `calibration` with the clip's length.
        seconds: time after the onset of contact up to which an estimate by depth constrains the force [s].

    Raises:
        OutputError: the output folder is full or can't be written (also from the methods).
    """

    def __init__(
        self,
        folder: Path,
        source: FrameSource,
        kinds: Sequence[type[Artefact]],
        calibration: ClipCalibration | None = None,
        alarm: ForceAlarm | None = None,
        seconds: float = math.inf,
    ) -> None:
        self.folder, self.source, self.size, self.fps = folder, source, source.size, source.fps
        self.calibration, self.alarm, self._known = calibration, alarm, seconds
        self.length = ClipLength(math.nan)
        """Length of a scene unit, once it is known."""
        self.estimates: list[FrameEstimate] = []
        """Estimates of all frames so far, without their fields: memory must not grow with the clip."""
        self.contacts: list[ContactForce] = []
        self.seconds = StageSeconds()
        self.counts: Counter[str] = Counter()
        """Number of contacts by verdict."""
        self.unexplained: Counter[str] = Counter()
        """Number of those without an estimate by why they have none."""
        self.stretched = False
        """True if tissue has stretched anywhere with an instrument."""
        self.lag = 0.0
        """The largest of the contacts' lags [levels of 8 bits]."""
        self._open = ExitStack()
        try:
            with writing(folder.parent):
                self.partial = store.partial_folder(folder)
                self._waiting = self._open.enter_context(closing(FrameSpool(self.partial)))
                self.artefacts = [self._open.enter_context(closing(kind(self))) for kind in kinds]
        except BaseException:
            self.__exit__()
            raise

    def __enter__(self) -> "ClipResults":
        return self

    def __exit__(self, *exception: object) -> None:
        """Close what is open and settle the hidden folder; nothing here may hide the error that led to it."""
        with suppress(Exception):
            self._open.close()
        with suppress(Exception):
            store.settle(self.folder)

    def write(self, prepared: PreparedFrame, estimate: FrameEstimate) -> None:
        """Take the next frame; in contact it waits until that has ended."""
        if self.alarm is not None:
            estimate = self.alarm.watch(estimate, None if self.calibration is None else self.calibration.known_force)
        pictures = any(artefact.pictures for artefact in self.artefacts)
        shown = (prepared.frame.image, prepared.picture_labels) if pictures else (None, None)
        self.estimates.append(replace(estimate, field=None))
        with writing(self.folder.parent):
            if estimate.contact or len(self._waiting):
                self._waiting.add(Shown(*shown, estimate.field))
            else:
                self._give(Shown(*shown, estimate.field), estimate)

    def _give(self, shown: Shown, estimate: FrameEstimate) -> None:
        estimate = replace(estimate, field=shown.field)
        for artefact in self.artefacts:
            artefact.frame(estimate, shown.image, shown.labels)

    def _give_waiting(self) -> None:
        begun = len(self.estimates) - len(self._waiting)
        for shown, estimate in zip(self._waiting.drain(), self.estimates[begun:], strict=True):
            self._give(shown, estimate)

    def add(self, run: InteractionEstimate) -> None:
        """Take a contact that has ended, and its force in newtons where some of it is known."""
        newtons = None
        if self.calibration is not None:
            try:
                newtons = self.calibration.add(run)
            except NoEstimate as reason:
                run = replace(run, detail=f"{run.detail} {reason}".strip())
        if self.alarm is not None:
            self.alarm.end_run()
        if run.field is not None:
            self.stretched |= run.field.stretched
        if run.estimate is not None and run.estimate.light is not None:
            self.lag = max(self.lag, run.estimate.light.lag)
        contact = ContactForce.of(run, self.estimates, newtons, self._known)
        self.contacts.append(contact)
        self._agree(run, contact)
        self.counts[state(run)] += 1
        if not run.verdict:
            self.unexplained[run.detail] += 1
        with writing(self.folder.parent):
            self._give_waiting()
            for artefact in self.artefacts:
                artefact.contact(run)

    def _agree(self, run: InteractionEstimate, contact: ContactForce) -> None:
        """Bring the frames that wait into agreement with their contact."""
        forces = dict(zip(contact.frames.tolist(), contact.relative.T.tolist(), strict=True))
        for index in range(len(self.estimates) - len(self._waiting), len(self.estimates)):
            before = self.estimates[index]
            frame = self.estimates[index] = agreed(before, run, forces.get(index, [math.nan] * 3))
            if self.alarm is not None and frame.alarm != before.alarm:
                self.alarm.frames.update({BELOW: -1, UNKNOWN: 1})

    def calibrate(self, length: ClipLength) -> None:
        """Convert what was added into millimetres and newtons, once all of it has been."""
        self.length = length
        if self.calibration is not None:
            self.calibration.conclude(length)

    def report(self) -> dict[str, Any]:
        """Return the content of forces.json."""
        rows = () if self.calibration is None else self.calibration.rows
        return forces_record(self.contacts, self.estimates, self.fps, rows, self.length)

    def finish(self, record: Mapping[str, Any]) -> None:
        """Write what is left and the record (as JSON), and move everything to its final place."""
        with writing(self.folder.parent):
            self._give_waiting()
            for artefact in self.artefacts:
                artefact.finish()
            self._open.close()
            store.write_record(self.partial, record)
            store.publish(self.partial, self.folder)
