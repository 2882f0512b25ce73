"""Tissue stiffness, damping and tool force while a camera, a stream or a pipe runs, as a line of JSON a frame.

    palpate live 0                      # the first camera
    palpate live rtsp://… | my_display  # a stream
    ffmpeg … -f rawvideo -pix_fmt rgb24 - | palpate live - --size 854x480

A line holds what `parameters.csv` of `palpate infer` holds of a frame, how late it is, and how many frames were dropped
so far; where a run of contact has ended, another one holds what `interactions.csv` does. Whether an instrument touches
is decided by later frames, too; so every frame has a line before, at once, whose `decided` is false, with the
probability of contact until then. Where depth is measured the network estimates every frame; in RGB video a press is
fitted after its end, while frames go on. The estimator online estimates stiffness place by place. Research software,
not a medical device.
"""

import dataclasses
import math
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from palpate.cli import infer
from palpate.common.command_line import size_of
from palpate.common.doors import INTERRUPTED
from palpate.common.files import as_json
from palpate.common.options import filled, option, parse
from palpate.common.registry import Registry
from palpate.common.settings import LARGEST, Positive
from palpate.common.workers import background_process
from palpate.data.clip import ClipStream
from palpate.data.prepared import PreparedFrame
from palpate.data.source.frames import halves
from palpate.data.source.layout import ClipLayout
from palpate.data.source.live import LiveSource, open_live
from palpate.estimators.contract import ClipInfo, Output, Preparation
from palpate.estimators.open import ESTIMATORS, preparation
from palpate.estimators.records import CONTACTS, FRAMES, FrameEstimate
from palpate.estimators.result import UNITS
from palpate.estimators.session import estimates_of
from palpate.results.alarm import ForceAlarm
from palpate.results.options import FRAME_FORCE, require_able

LIVE = Registry("live estimator", ESTIMATORS.group, {x: ESTIMATORS.entries[x].value for x in ("network", "online")})
"""Estimators that estimate while frames come."""


def igtl_server(port: int) -> Any:
    """Return a `pyigtl.OpenIGTLinkServer` on this machine.

    Raises:
        ValueError: pyigtl is not installed, or the port can't be opened.
    """
    try:
        import pyigtl
    except ModuleNotFoundError as error:
        raise ValueError("--igtl needs pyigtl; install 'palpate[live]'.") from error
    try:
        return pyigtl.OpenIGTLinkServer(port=port, local_server=True)
    except OSError as error:
        raise ValueError(f"--igtl {port} can't be opened ({error.strerror}); give another port.") from error


@contextmanager
def stopped_by_interrupt(source: LiveSource) -> Generator[None]:
    """Let the first Ctrl-C stop the source, so that what has been seen is still estimated."""

    def stop(*_: object) -> None:
        source.stop()
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@dataclass(frozen=True)
class Live:
    """The source, and lines of JSON."""

    source: str = option(positional=True, metavar="SOURCE")
    """camera's number, address of a stream, video file (played at its own rate), or - for RGB pictures from a pipe"""
    estimator: str | None = option(None, choices=lambda: [*LIVE.entries], needs=("live", "estimates while frames come"))
    """estimator that estimates while frames come (default: what --model is for, else network)"""
    max_latency: Annotated[float, 1e-3, LARGEST] = option(1.0, metavar="SECONDS")
    """frames that have waited longer are dropped and counted [s]"""
    size: str | None = option(None, metavar="WxH")
    """size of a pipe's pictures [px]"""
    fps: Annotated[float, 1, LARGEST] | None = None
    """frames a second (default: as the source says; of a pipe 25)"""
    every: Annotated[int, 1, 100] = option(1, metavar="N")
    """take one of so many frames, so that this machine keeps up: frames that are dropped break a press off"""
    igtl: Annotated[int, 1, 65535] | None = option(None, metavar="N")
    """serve every line to an OpenIGTLink client, such as 3D Slicer, on this port of this machine (palpate[live])"""
    right: Literal["side-by-side", "top-bottom"] | None = None
    """pictures hold both of a stereo pair, the left one first: with --depth stereo and a camera file with a baseline"""
    force_limit: Positive | None = option(None, metavar="X", needs=FRAME_FORCE)
    """limit of the force in the unit of the column force (docs/forces.md). Research software, not a medical device"""
    alarm_at: Annotated[float, 0.5, 0.999] | None = option(None, metavar="P", needs=FRAME_FORCE)
    """probability that the force is above --force-limit from which on there is an alarm (default: 0.9); it ends below
    0.5"""

    @property
    def pixels(self) -> tuple[int, int] | None:
        """Width and height of a pipe's pictures.

        Raises:
            ValueError: the size is none.
        """
        found = None if self.size is None else size_of(self.size)
        if self.size is not None and (found is None or max(found) >= 100_000):
            raise ValueError(f"--size {self.size} is no size; give width and height, such as 854x480.")
        return found


def main(arguments: list[str] | None = None) -> int:
    """Estimate until the source ends; returns the exit status."""
    component = dataclasses.replace(infer.ESTIMATOR, registry=LIVE)
    more: dict[str, Any] = {"without": ("layout", "topic"), "component": component, "defaults": {"rate": "fast"}}
    values = vars(parse((Live, Preparation), arguments, "", __doc__, **more))
    options: Live = filled(Live, values)
    try:
        estimator = filled(ESTIMATORS[values["estimator"]], values).build()
        require_able(estimator, values, (Live,))
        settings = preparation(estimator, filled(Preparation, values | {"layout": ClipLayout(right=options.right)}))
        # The depth's scale is found in so much of the beginning [s]; a source won't begin again.
        depth = dataclasses.replace(settings.depth, scale_seconds=0.5)
        given = options.max_latency, options.pixels, options.fps, sys.stdin.buffer, options.every
        source = open_live(options.source, *given)
        clip = ClipStream(halves(source, settings.layout), dataclasses.replace(settings, depth=depth))
        session = estimator.start(ClipInfo.of(clip))
        server = None if options.igtl is None else igtl_server(options.igtl)
    except (ValueError, OSError) as error:
        print(f"palpate live: {error}", file=sys.stderr)
        return 2
    limit, raised = options.force_limit, options.alarm_at or ForceAlarm.raised
    alarm = None if limit is None else ForceAlarm(limit, UNITS["force"], estimator.force_seconds, raised)
    lines = JsonLines(source, server, alarm)
    try:
        with stopped_by_interrupt(source), background_process() as session.fitter:
            # Frames that wait for their decision, as a press takes longer than a frame, and one for its estimate.
            for output in estimates_of(session, clip.overlapped(16, 1, lines.notice)):
                lines.add(output)
        status = INTERRUPTED if source.stopped else 0
    except (ValueError, OSError) as error:
        print(f"palpate live: {error}", file=sys.stderr)
        status = 1
    print(lines.summary(), file=sys.stderr)
    if alarm is not None:
        print(alarm.sentence(), file=sys.stderr)
    return status


class JsonLines:
    """Printer of a source's estimates as lines of JSON, with their latency.

    Args:
        source: whose estimates are printed.
        server: as in `igtl_server`; its client gets lines as texts called palpate. None = there is none.
        alarm: of a limit of force, where there is one.
    """

    def __init__(self, source: LiveSource, server: Any, alarm: ForceAlarm | None) -> None:
        self.source, self.server, self.alarm = source, server, alarm
        self._late: dict[bool, deque[float]] = {decided: deque(maxlen=1 << 16) for decided in (False, True)}
        """Latencies of the last frames, when they were prepared and when they were decided [s]."""
        self._frames, self._begun = 0, time.monotonic()
        self._one = threading.Lock()

    def notice(self, prepared: PreparedFrame) -> None:
        """Print what is known of a frame before later ones decide; called from another thread than `add`."""
        frame = prepared.frame
        found: dict[str, Any] = {"frame": frame.number, "time_s": round(frame.time_s, 6), "decided": False}
        if math.isfinite(prepared.contact_probability):
            found["contact_probability"] = round(prepared.contact_probability, 4)
        if prepared.status in ("no_tool", "no_tissue", "bad_depth", "unreadable", "no_mask", "repeated"):
            found["status"] = prepared.status  # later frames don't change it
        self._send(found | self._lateness(frame.number, decided=False))

    def add(self, output: Output) -> None:
        """Print an estimate of a frame or of a run of contact."""
        if isinstance(output, FrameEstimate):
            self._frames += 1
            output = output if self.alarm is None else self.alarm.watch(output)
            found = FRAMES.known(output) | {"decided": True} | self._lateness(output.frame, decided=True)
            found |= {} if self.alarm is None else {"alarm": output.alarm}
        else:
            if self.alarm is not None:
                self.alarm.end_run()
            found = {"interaction": CONTACTS.known(*output.rows)}
        self._send(found)

    def _lateness(self, number: int, *, decided: bool) -> dict[str, Any]:
        came = self.source.came.pop(number, math.nan) if decided else self.source.came.get(number, math.nan)
        self._late[decided].append(time.monotonic() - came)
        return {"latency_s": round(self._late[decided][-1], 4), "dropped": self.source.dropped}

    def _send(self, found: dict[str, Any]) -> None:
        line, server = as_json(found), self.server
        with self._one:
            print(line, flush=True)
            # A client that is too slow misses lines.
            if server is not None and server.is_connected() and len(server.outgoing_messages) < 100:
                from pyigtl import StringMessage

                server.send_message(StringMessage(line, device_name="palpate"), wait=False)

    def summary(self) -> str:
        """Return a sentence on frames, latency, and what was lost."""
        if not self._frames:
            return "No frame was estimated."
        seconds = time.monotonic() - self._begun
        first, last = (1000 * np.nanquantile(self._late[decided], [0.5, 0.95]) for decided in (False, True))
        return (
            f"{self._frames} frames, {self._frames / seconds:.1f} a second; their first lines were {first[0]:.0f} ms "
            f"late in the median and {first[1]:.0f} at the 95th percentile, decided ones {last[0]:.0f} and "
            f"{last[1]:.0f}; {self.source.dropped} were dropped."
        )
