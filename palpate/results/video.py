"""A video in a batch: what its results depend on, and its estimates given to whatever is written."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.common.files import file_sha256
from palpate.data.clip import ClipStream
from palpate.data.contact.shaft import NOT_SEEN, ShaftRuler
from palpate.data.source.frames import open_source
from palpate.estimators.contract import ClipInfo
from palpate.estimators.force_scale import ClipLength
from palpate.estimators.records import InteractionEstimate
from palpate.estimators.result import UNITS
from palpate.estimators.session import estimates_with_frames
from palpate.results.alarm import ForceAlarm
from palpate.results.artefacts.base import artefacts
from palpate.results.calibrated import NEWTONS, ClipCalibration
from palpate.results.options import in_options
from palpate.results.outcome import plural
from palpate.results.record import build_record, depends_on, model_of
from palpate.results.store import RECORD
from palpate.results.writer import ClipResults

if TYPE_CHECKING:
    from palpate.results.run import Batch


class VideoClip:
    """A video that is to be estimated.

    Args:
        path: of the clip.
        batch: with the options, the estimator, the preparation, and what is known in newtons.

    Raises:
        ValueError: the clip, or what is known of its forces, can't be read.
    """

    def __init__(self, path: Path, batch: Batch) -> None:
        options, estimator, settings = batch.options, batch.estimator, batch.settings
        self._options, self._estimator, self._settings = options, estimator, settings
        self._source = open_source(path, settings.layout)
        self.name, self.length = self._source.name, self._source.length
        self.causes = depends_on(path, settings, estimator)
        """Everything that the results depend on."""
        chosen = {name: getattr(options, name) for name in ("force_limit", "alarm_at", "shaft_diameter", "export")}
        self.causes |= {name: value for name, value in chosen.items() if value is not None}
        self._calibration = None
        if batch.calibration is not None:
            given = batch.calibration.of_clip(path, settings.layout.topic)
            self.causes["force_scale"] = [file_sha256(file) for file in given.files] or str(given.path)
            self._calibration = ClipCalibration(given)
        self._kinds = artefacts(options, estimator)
        self.files = [kind.name for kind in self._kinds if kind.name] + [RECORD]
        """Names of the files that are written."""
        self.remarks: list[str] = []
        """Reasons why contacts have no estimate, the most frequent reasons."""

    def write(self, folder: Path, done: Callable[[], None]) -> dict[str, Any]:
        """Estimate all frames and contacts and write the results; returns run.json's content.

        Args:
            folder: of the results.
            done: called after every frame.
        """
        options, newtons, seconds = self._options, self._calibration, self._estimator.force_seconds or math.inf
        limit, unit = options.force_limit, UNITS["force"] if newtons is None else NEWTONS
        alarm = None if limit is None else ForceAlarm(limit, unit, seconds, options.alarm_at or ForceAlarm.raised)
        with ClipResults(folder, self._source, self._kinds, newtons, alarm, seconds) as results:
            clip, started = ClipStream(self._source, self._settings), time.perf_counter()
            length = ClipLength.of(clip)
            if newtons is not None:
                newtons.length = length
            diameter = options.shaft_diameter
            if diameter is not None and length.metres is not None:
                raise ValueError(f"--shaft-diameter has no effect where {length.by} tells metres; leave it out.")
            ruler = None if diameter is None else ShaftRuler(diameter / 1000, clip)
            length_now = ruler.metres if ruler else lambda: length.metres and (length.metres, length.log_sd)
            force = None if newtons is None else newtons.calibration.measured
            session = self._estimator.start(replace(ClipInfo.of(clip), force=force, metres=length_now))
            stream = iter(clip) if options.threads == 1 else clip.overlapped()
            stream = ruler.watched(stream) if ruler else stream
            for item, frame in estimates_with_frames(session, stream):
                if isinstance(item, InteractionEstimate):
                    results.add(replace(item, detail=in_options(item.detail)))
                elif frame is not None:
                    results.write(frame, item)
                    done()
            if ruler is not None:
                metres, log_sd = ruler.metres() or (None, 0.0)
                by = NOT_SEEN if metres is None else f"a shaft of {diameter:g} mm"
                length = replace(length, metres=metres, log_sd=log_sd, by=by)
            results.calibrate(length)
            timings = {**clip.seconds, **session.seconds, **results.seconds}
            timings["total"] = time.perf_counter() - started + clip.seconds["scale"]
            record = build_record(clip, self.causes, model_of(self._estimator), results, timings)
            results.finish(record)
        total = results.counts.total()
        for reason, count in results.unexplained.most_common(3):
            self.remarks.append(f"no estimate of {count} of {total} {plural(total, 'contact')}: {reason}")
        return record
