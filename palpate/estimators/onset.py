"""Beginning of a press: at the time stamp of the first frame in contact, or up to a frame interval before or after it.

An estimate that takes the stamp for the onset has too small an uncertainty: a delay of a few milliseconds looks like
other tissue. `direct` fits the delay (`estimators.direct.motion`), and networks were trained with unknown delays.
"""

from dataclasses import dataclass
from typing import Literal

from palpate.common.options import option
from palpate.common.settings import Checked
from palpate.data.contact.interaction import Horizon

BETWEEN, STAMP = "between", "stamp"
"""A press begins anywhere within a frame interval of the first frame in contact, or at that frame's time stamp."""


@dataclass(frozen=True)
class PressSettings(Checked):
    """Beginning and end of a press; part of the settings of estimators that fit whole presses."""

    onset: Literal["between", "stamp"] = BETWEEN
    """beginning of a press: between frames, up to a frame's time from the first frame in contact (default; real
    videos), or stamp, at that frame's time stamp (synthetic clips)"""
    horizon: Horizon = option(None, hidden=True)
    """part of a whole contact that is looked at"""


def onset_error(onset: str, fps: float) -> float:
    """Return the largest distance of the onset from the first frame in contact, at `fps` frames a second [s]."""
    return 1 / fps if onset == BETWEEN else 0.0
