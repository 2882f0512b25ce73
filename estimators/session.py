"""Runs an estimator's session over a clip: the one way in which frames become estimates."""

from collections import deque
from collections.abc import Iterable, Iterator

from palpate.data.prepared import PreparedFrame
from palpate.estimators.contract import Output, Session
from palpate.estimators.records import FrameEstimate


def estimates_of(session: Session, frames: Iterable[PreparedFrame]) -> Iterator[Output]:
    """Estimates of a clip's frames, gaps included, and runs of contact, as they are ready.

    Args:
        session: started for this clip.
        frames: all of the clip's, prepared as the session's estimator wants them.
    """
    waiting: deque[PreparedFrame] = deque()

    def with_gaps(outputs: Iterable[Output]) -> Iterator[Output]:
        for output in outputs:
            if isinstance(output, FrameEstimate):
                for gap in waiting.popleft().skipped:
                    yield FrameEstimate(gap.frame.number, gap.frame.time_s, status=gap.status, detail=gap.detail)
            yield output

    for frame in frames:
        waiting.append(frame)
        yield from with_gaps(session.push(frame))
    yield from with_gaps(session.finish())
