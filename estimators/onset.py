"""When a press begins: at the time stamp of the first frame in contact, or up to a frame interval before or after it.

An estimate that takes the stamp for the onset has too small an uncertainty: a delay of a few milliseconds looks like
other tissue. `direct` fits the delay (`estimators.direct.motion`), and networks were trained with unknown delays.
"""

ONSETS = BETWEEN, STAMP = "between", "stamp"
"""A press begins anywhere within a frame interval of the first frame in contact, or at that frame's time stamp."""


def onset_error(onset: str, fps: float) -> float:
    """Largest distance of the onset from the first frame in contact, at `fps` frames a second [s]."""
    return 1 / fps if onset == BETWEEN else 0.0
