"""What each kind of observation can tell about stiffness, damping and force, whatever estimator reads it.

    python -m benchmarks.observation_bounds

Medians over simulated contacts of the Cramér–Rao bounds (`physics.identifiability`) at a depth noise of 0.001 scene
units: the end point of the rollout (Bini 2026), the end of the load, the contact's trajectory over the first K frames
of 25 a second, and the trajectory of every vertex in view. No training: what has no information has no estimate.
"""

from __future__ import annotations

from physics.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from collections import defaultdict

import numpy as np

from benchmarks.shared import command_line, machine, print_table
from data.synthetic.contacts import FINE, SimulatedContact, draw_contacts
from data.synthetic.settings import SceneSettings
from data.synthetic.truth import REGIMES, Regime
from physics.identifiability import LIMIT, bounds, ratio_bounds
from physics.likelihood import Likelihood
from physics.load import Press, held
from physics.observation import Observation

NOISE = 0.001
SCENES, A_SCENE = 4, 3
"""Scenes of each regime, and contacts of each scene."""
FRAME = round(1 / 25 / FINE.time_step)
"""Steps a frame."""
COLUMNS = ("regime", "observation", "k_s", "k_d", "F", "k_s/k_d", "F/k_d", "determined")


def observations(contact: SimulatedContact) -> dict[str, tuple[np.ndarray, bool]]:
    """Steps at which each kind of observation looks, and whether it sees every vertex."""
    load = round(contact.interaction.load_seconds / FINE.time_step)
    kinds = {"final": (np.array([FINE.steps - 1]), False), "release": (np.array([load - 1]), False)}
    for frames in (2, 4, 8, 16, 25):
        kinds[f"trajectory, K = {frames}"] = (FRAME * np.arange(1, frames + 1) - 1, False)
    kinds["field, K = 25"] = (FRAME * np.arange(1, 26) - 1, True)
    return kinds


def limits(contact: SimulatedContact, steps: np.ndarray, whole: bool) -> np.ndarray:
    """Bounds on log k_s, log k_d, log |F|, log k_s/k_d and log F/k_d, shape [5]."""
    seen = contact.interaction
    vertices = np.arange(len(seen.mesh.vertices)) if whole else np.array([seen.vertex])
    times, nothing = (steps + 1) * FINE.time_step, np.zeros((len(vertices), len(steps), 3), np.float32)
    press = Press.at(seen.vertex, seen.direction.astype(float), held(seen.load_seconds / FINE.time_step, FINE.steps))
    likelihood = Likelihood(seen.mesh, press, Observation(vertices, times, nothing, np.full(3, NOISE)), FINE)
    information = likelihood.information(np.log(np.abs(contact.theta)))
    return np.concatenate([bounds(information), ratio_bounds(information)])


def rows_of(regime: Regime, scenes: range) -> list[list[str]]:
    """Rows of the contacts of one regime; `scenes` are seeds."""
    found = defaultdict(list)
    for scene in scenes:
        for contact in draw_contacts(SceneSettings(width=214, height=120, regime=regime), scene, A_SCENE, 0.005):
            for name, (steps, whole) in observations(contact).items():
                found[name].append(limits(contact, steps, whole))
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
