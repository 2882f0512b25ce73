"""Time that the stages of some work take."""

import contextlib
import time
from collections import defaultdict
from collections.abc import Generator


class StageSeconds(defaultdict[str, float]):
    """Time spent so far by stage [s]."""

    def __init__(self) -> None:
        super().__init__(float)

    @contextlib.contextmanager
    def timed(self, stage: str) -> Generator[None]:
        """Add the time that is spent within to that of a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self[stage] += time.perf_counter() - start
