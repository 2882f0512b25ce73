"""When a press begins is known to a frame only: what that adds to an estimate's uncertainty.

Every simulated press begins at the time stamp of the first frame in contact. A real one begins up to a frame interval
before or after it, and an estimate that takes the stamp for the beginning is surer than it may be: a few milliseconds
look like other tissue. `direct` fits the delay (`estimators.direct.motion`), and a network that sees films has learnt
what not knowing it leaves. Others have learnt presses that begin at their time stamp only; they estimate the contact as
if it had begun at several instants, evenly spread, and their moment-matched mixture is the estimate. They count alike:
so far apart, how well each explains the motion is no guide.
`python -m evaluation.benchmark --suite late-onset --onset between`, or without that option, shows what it is worth.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from data.contact.interaction import Interaction

BETWEEN, STAMP = "between", "stamp"
ONSETS = (BETWEEN, STAMP)
"""A press begins anywhere within a frame interval of the first frame in contact, or at that frame's time stamp."""
INSTANTS = 5
"""Beginnings that are tried."""


def onset_error(onset: str, fps: float) -> float:
    """How far from the first frame in contact a press may begin, at so many frames a second [s]."""
    return 1 / fps if onset == BETWEEN else 0.0


def onset_perturbations(contact: Interaction, within: float, least: int) -> list[Interaction]:
    """The contact as if it had begun at other instants; itself alone where it began at its time stamp.

    Args:
        contact: the contact.
        within: how far from the time stamp it may have begun [s].
        least: instants that leave fewer observations are left out, unless none remains.
    """
    if not within:
        return [contact]
    found, observation, step = [], contact.observation, contact.time_step
    # What was seen under load last may then lie behind the load's last step.
    factor = np.pad(contact.load.factor, (0, math.ceil(within / step)))
    contact = dataclasses.replace(contact, load=dataclasses.replace(contact.load, factor=factor))
    for delay in np.rint(np.linspace(-within, within, INSTANTS) / step) * step:
        # Before it begins the tissue is at rest and tells nothing.
        later = dataclasses.replace(observation, times=observation.times - delay).chosen(
            observation.times - delay >= step / 2
        )
        if len(later) >= least:
            found.append(dataclasses.replace(contact, observation=later))
    return found or [contact]
