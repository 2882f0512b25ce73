"""Iteration of an estimator's session over a clip: the one way in which frames become estimates."""

from collections import deque
from collections.abc import Iterable, Iterator

from palpate.data.prepared import PreparedFrame
from palpate.estimators.contract import Output, Session
from palpate.estimators.records import FrameEstimate

Framed = tuple[Output, PreparedFrame | None]
"""Estimate with its frame; None for runs of contact."""


def estimates_of(session: Session, frames: Iterable[PreparedFrame]) -> Iterator[Output]:
    """Return estimates of a clip's frames, gaps included, and runs of contact, as they are ready.

    Args:
        session: started for this clip.
        frames: all of the clip's, prepared as the session's estimator wants them.
    """
    return (output for output, _ in estimates_with_frames(session, frames))


def estimates_with_frames(session: Session, frames: Iterable[PreparedFrame]) -> Iterator[Framed]:
    """Yield what `estimates_of` does, each estimate with its frame."""
    waiting: deque[PreparedFrame] = deque()

    def with_gaps(outputs: Iterable[Output]) -> Iterator[Framed]:
        for output in outputs:
            if not isinstance(output, FrameEstimate):
                yield output, None
                continue
            frame = waiting.popleft()
            for gap in frame.skipped:
                at = gap.frame
                yield FrameEstimate(at.number, at.time_s, status=gap.status, detail=gap.detail), gap
            yield output, frame

    for frame in frames:
        waiting.append(frame)
        yield from with_gaps(session.push(frame))
    yield from with_gaps(session.finish())
