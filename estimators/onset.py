"""The onset of a press is known to a frame only: how that adds to an estimate's uncertainty.

Every simulated press begins at the time stamp of the first frame in contact. A real one begins up to a frame interval
before or after it, and an estimate that takes the stamp for the onset has too small an uncertainty: a delay of a few
milliseconds looks like other tissue. `direct` fits the delay (`estimators.direct.motion`), and a network with
depth-change sequences was trained with unknown delays. Other networks were trained on presses that begin at their time
stamp; with them the contact is estimated as if it had begun at several instants, evenly spread, and the moment-matched
mixture is the estimate. All instants have the same weight: so far apart, the misfit is no guide.
`python -m benchmarks.recovery --suite late-onset --onset between`, or without that option, shows what it is worth.
"""

import dataclasses
import math

import numpy as np

from palpate.data.contact.interaction import Interaction

BETWEEN, STAMP = "between", "stamp"
ONSETS = (BETWEEN, STAMP)
"""A press begins anywhere within a frame interval of the first frame in contact, or at that frame's time stamp."""
PERTURBATIONS = 5
"""Number of onsets that are tried."""


def onset_error(onset: str, fps: float) -> float:
    """Largest distance of the onset from the first frame in contact, at `fps` frames a second [s]."""
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
    # The last observation under load may then lie behind the load's last step.
    factor = np.pad(contact.load.factor, (0, math.ceil(within / step)))
    contact = dataclasses.replace(contact, load=dataclasses.replace(contact.load, factor=factor))
    for delay in np.rint(np.linspace(-within, within, PERTURBATIONS) / step) * step:
        # Before the onset the tissue is at rest and holds no information.
        later = dataclasses.replace(observation, times=observation.times - delay).chosen(
            observation.times - delay >= step / 2
        )
        if len(later) >= least:
            found.append(dataclasses.replace(contact, observation=later))
    return found or [contact]
