"""What each kind of observation can tell about stiffness, damping and force, whatever estimator reads it.

    python -m benchmarks.observation_bounds [--contacts 90]

Medians over simulated contacts of the Cramér–Rao bounds (`physics.identifiability`) at a depth noise of 0.001 scene
units: the end point of the rollout (Bini 2026), the end of the load, the contact's trajectory over the first K frames
of 25 a second, and the trajectory of every vertex in view. No training: what has no information has no estimate.
"""

from __future__ import annotations

import argparse

import numpy as np
from rich.console import Console
from rich.table import Table

from data.synthetic.contacts import FINE, SimulatedContact, draw_contacts
from data.synthetic.settings import SceneSettings
from data.synthetic.truth import damping_ratio, regime_of
from physics.identifiability import LIMIT, bounds, ratio_bounds
from physics.likelihood import Likelihood
from physics.load import Press, held
from physics.observation import Observation

NOISE = 0.001
REGIMES = ("under-damped", "critical", "over-damped")
A_SCENE = 3
FRAME = round(1 / 25 / FINE.time_step)
"""Steps a frame."""


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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--contacts", type=int, default=90, help="contacts, a third in each regime (default 90)")
    options = parser.parse_args()
    found: dict[tuple[str, str], list[np.ndarray]] = {}
    for scene in range(-(-options.contacts // A_SCENE)):
        settings = SceneSettings(width=214, height=120, regime=REGIMES[scene % 3])
        for contact in draw_contacts(settings, 90_000 + scene, A_SCENE, 0.005):
            regime = regime_of(damping_ratio(contact.theta[0], contact.theta[1], settings.mass))
            for name, (steps, whole) in observations(contact).items():
                found.setdefault((regime, name), []).append(limits(contact, steps, whole))
    title = f"Cramér–Rao bounds, medians, σ = {NOISE} scene units; share: all three parameters below {LIMIT}"
    table = Table("regime", "observation", "contacts", "k_s", "k_d", "F", "k_s/k_d", "F/k_d", "determined", title=title)
    for regime in REGIMES:
        for (one, name), rows in found.items():
            if one == regime:
                values = np.array(rows)
                cells = [f"{value:.2g}" if value < 100 else "none" for value in np.median(values, axis=0)]
                share = (values[:, :3] < LIMIT).all(axis=1).mean()
                table.add_row(regime, name, str(len(rows)), *cells, f"{share:.0%}")
    Console(width=130).print(table)


if __name__ == "__main__":
    main()
