"""What each kind of observation can tell about stiffness, damping and force, whatever estimator reads it.

    python -m benchmarks.observation_bounds

Medians over simulated contacts of the Cramér–Rao bounds (`physics.identifiability`) at a depth noise of 0.001 scene
units: the end point of the rollout (Bini 2026), the end of the load, the contact's trajectory over the first K frames
of 25 a second or as long as the tool presses, and the depth of the whole dent, up to so many vertices from the contact;
where it is stated, with the instants of the press unknown within a frame. No training: what has no information has no
estimate.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from collections import defaultdict
from typing import NamedTuple

import numpy as np

from palpate.benchmarks.shared import command_line, machine, print_table
from palpate.data.contact.depth_sequence import REACH
from palpate.data.synthetic.contacts import FINE_MECHANICS, SimulatedContact, draw_contacts
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.truth import REGIMES, Regime
from palpate.estimators.direct.motion import PressMotion
from palpate.estimators.onset import BETWEEN, STAMP
from palpate.evaluation.recovery.bounds import known
from palpate.physics.identifiability import LIMIT, bounds, fisher_information, ratio_bounds

NOISE = 0.001
SCENES, A_SCENE = 4, 3
"""Scenes of each regime, and contacts of each scene."""
FRAME = round(1 / 25 / FINE_MECHANICS.time_step)
"""Steps a frame."""
COLUMNS = ("regime", "observation", "k_s", "k_d", "F", "k_s/k_d", "F/k_d", "determined")


class Observed(NamedTuple):
    """What is observed of a contact."""

    steps: np.ndarray
    """Steps at which it is looked at, shape [K]."""
    reach: int = 0
    """How far from the contact every vertex's depth is observed [grid px]; 0 = the contact alone, along all axes."""
    onset: str = STAMP
    """Whether the instants of the press are known, one of `estimators.onset.ONSETS`."""


def observations(contact: SimulatedContact) -> dict[str, Observed]:
    """What each kind of observation sees."""
    load = round(contact.interaction.load_seconds / FINE_MECHANICS.time_step)
    kinds = {"final": Observed(np.array([FINE_MECHANICS.steps - 1])), "release": Observed(np.array([load - 1]))}
    for frames in (2, 4, 8, 16, 25):
        kinds[f"contact, K = {frames}"] = Observed(FRAME * np.arange(1, frames + 1) - 1)
    second = FRAME * np.arange(1, 26) - 1
    pressed = second[second < load]
    kinds["contact, under the tool"] = Observed(pressed)
    kinds |= {f"dent to {reach} px, K = 25": Observed(second, reach) for reach in (2, 4, REACH, REACH + 8)}
    kinds["dent, under the tool"] = Observed(pressed, REACH)
    for name in (f"contact, K = {len(second)}", f"dent to {REACH} px, K = 25"):
        kinds[f"{name}, instants unknown"] = kinds[name]._replace(onset=BETWEEN)
    return kinds


def limits(contact: SimulatedContact, observed: Observed) -> np.ndarray:
    """Bounds on log k_s, log k_d, log |F|, log k_s/k_d and log F/k_d, shape [5]."""
    pressed = contact.interaction
    apart = np.abs(pressed.mesh.pixels - pressed.mesh.pixels[pressed.vertex]).max(axis=1)
    vertices, times = np.flatnonzero(apart <= observed.reach), (observed.steps + 1) * FINE_MECHANICS.time_step
    motion = PressMotion(pressed, FINE_MECHANICS, vertices, times, FRAME * FINE_MECHANICS.time_step)
    slopes = motion.at(np.concatenate([np.log(np.abs(contact.theta)), np.zeros(2)]))[1]
    used = slopes[..., 2, :] if observed.reach else slopes
    information = known(fisher_information(used, NOISE), observed.onset)
    return np.concatenate([bounds(information), ratio_bounds(information)])


def rows_of(regime: Regime, scenes: range) -> list[list[str]]:
    """Rows of the contacts of one regime; `scenes` are seeds."""
    found = defaultdict(list)
    for scene in scenes:
        for contact in draw_contacts(SceneSettings(width=214, height=120, regime=regime), scene, A_SCENE, 0.005):
            for name, observed in observations(contact).items():
                found[name].append(limits(contact, observed))
    rows = []
    for name, values in found.items():
        cells = [f"{value:.2g}" if value < 100 else "none" for value in np.median(values, axis=0)]
        determined = (np.array(values)[:, :3] < LIMIT).all(axis=1).mean()
        rows.append([regime, name, *cells, f"{determined:.0%}"])
    return rows


def main() -> None:
    """Print the table."""
    command_line(__doc__).parse_args()
    print(f"{machine()}; determined: all three parameters below {LIMIT}\n")
    seeds = range(90_000, 90_000 + SCENES * len(REGIMES))
    by_regime = (rows_of(regime, seeds[place :: len(REGIMES)]) for place, regime in enumerate(REGIMES))
    print_table(COLUMNS, (row for rows in by_regime for row in rows))


if __name__ == "__main__":
    run_door(main)
