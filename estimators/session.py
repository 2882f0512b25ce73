"""Runs an estimator's session over a clip: the one way in which frames become estimates."""

from collections.abc import Iterable, Iterator

from palpate.data.prepared import PreparedFrame
from palpate.estimators.contract import Output, Session


def estimates_of(session: Session, frames: Iterable[PreparedFrame]) -> Iterator[Output]:
    """Estimates of a clip's frames and runs of contact, as they are ready.

    Args:
        session: started for this clip.
        frames: all of the clip's, prepared as the session's estimator wants them.
    """
    for frame in frames:
        yield from session.push(frame)
    yield from session.finish()
