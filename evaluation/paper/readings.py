"""Which of the choices that the paper leaves open agree with its own numbers, by simulation at its θ, without training.

    python -m evaluation.paper.readings [--contacts 16] [--seed 0]

Bini 2026 prints θ = (0.508 ± 0.0027, 0.09 ± 0.0162, 7.79 ± 0.1841), tissue that settles to 5 % within 0.9 s, a median
that rises to 63 to 65 % of the highest peak, and two mean squared errors, 0.00428 with its θ and 0.00467 with the
literature's k_s and k_d (sections 4.1 and 4.2, table 2). Foundation, rim, direction of the force, damping and the
compared instant are not all given. Every reading of them is simulated on contacts of synthetic sheets, and its numbers
are compared with the paper's. Exit status: 0 done, 2 wrong usage, 130 interrupted.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from palpate.common.command_line import whole_number
from palpate.common.tables import to_markdown
from palpate.data.synthetic.scene import Scene, draw_scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.evaluation.paper.simulated import median_share, settle
from palpate.evaluation.paper.statistics import format_number
from palpate.physics.load import Press, held
from palpate.physics.mechanics import REFERENCE_DAMPING, REFERENCE_STIFFNESS, Mechanics
from palpate.physics.mesh import contact_normal
from palpate.physics.msd import simulate

THETA, SPREAD = np.array([0.508, 0.09, -7.79]), np.array([0.0027, 0.0162, 0.1841])
"""Mean and standard deviation of the paper's estimates over its test frames (section 4.2), F signed."""
ERROR, REFERENCE_ERROR = 0.00428, 0.00467
"""The paper's mean squared errors with its θ and with the literature's k_s and k_d (table 2) [scene units²]."""
ANCHORS = (0.0, 0.1, 1.0)
DIRECTIONS = ("inward", "outward", "along")
PLACES = ("inside", "outline")
REST_TIME_S = 0.9
"""Time at which the paper's tissue is at rest [s]; its rollout ends 0.75 s after the release."""
COLUMNS = (
    "foundation",
    "rim",
    "contact",
    "force",
    "damping",
    "peak",
    "median of highest peak",
    "settled",
    "after release [s]",
    "after start [s]",
    "left at the end",
    "|u| released",
    "|u| at the end",
    "reference's",
    "most by table 2",
)
"""Lengths are root mean squares over the contacts, the peak a median [scene units]."""


@dataclass(frozen=True)
class Reading:
    """One way to fill in what the paper leaves open."""

    anchor: float = 0.0
    """Spring from every vertex to its rest, as a multiple of k_s; equation 9 read literally has 1."""
    boundary: Literal["fixed", "free"] = "fixed"
    """Whether the sheet's rim is held."""
    place: str = "inside"
    """One of PLACES: some way from the organ's outline, or on it, where the point nearest to a tool often lies."""
    direction: str = "inward"
    """One of DIRECTIONS: along the normal away from the camera, towards it, or in the sheet's plane."""
    damping: Literal["implicit", "explicit"] = "implicit"
    """How Euler's scheme takes the damping."""

    @property
    def mechanics(self) -> Mechanics:
        """The rollout's constants."""
        return Mechanics(boundary=self.boundary, anchor=self.anchor, damping=self.damping)

    def press(self, scene: Scene) -> Press:
        """The paper's load on a sheet; a negative F goes the reading's way."""
        mesh, vertex = scene.mesh, scene.vertex
        if self.place == "outline":
            rim = np.flatnonzero(mesh.rim)
            vertex = int(rim[np.linalg.norm(mesh.pixels[rim] - mesh.pixels[vertex], axis=1).argmin()])
        axis = contact_normal(mesh, vertex).astype(np.float64)
        if self.direction == "along":
            axis = np.cross(axis, [0.0, 1.0, 0.0])
            axis /= np.linalg.norm(axis)
        elif self.direction == "outward":
            axis = -axis
        return Press.at(vertex, axis, held(self.mechanics.load_steps, self.mechanics.steps))


def readings() -> list[Reading]:
    """All compared readings: foundation, rim and place in every combination; direction and damping by themselves."""
    combined = itertools.starmap(Reading, itertools.product(ANCHORS, ("fixed", "free"), PLACES))
    return [*combined, *(Reading(direction=each) for each in DIRECTIONS[1:]), Reading(damping="explicit")]


def motions(reading: Reading, scenes: Sequence[Scene], theta: np.ndarray) -> np.ndarray:
    """Displacement of each contact under its own θ [n, 3], shape [n, T, 3], float64 [scene units]."""
    pairs = zip(scenes, theta, strict=True)
    paths = [simulate(own, scene.mesh, reading.press(scene), reading.mechanics) for scene, own in pairs]
    return np.stack(paths).astype(np.float64)


def farthest(reference: float) -> float:
    """How far the contact can move in the root mean square [scene units], if the paper's errors are to come out.

    By the triangle inequality |u| ≤ |u − d| + |d − u_r| + |u_r|, whatever motion d was observed.

    Args:
        reference: how far it moves with the literature's k_s and k_d, u_r.
    """
    return math.sqrt(ERROR) + math.sqrt(REFERENCE_ERROR) + reference


def measure(reading: Reading, scenes: Sequence[Scene], theta: np.ndarray) -> dict[str, float | str]:
    """A reading's numbers, by COLUMNS.

    Args:
        reading: the reading to simulate.
        scenes: sheets with their contacts.
        theta: θ of each contact, shape [n, 3].
    """
    mechanics = reading.mechanics
    tissue = np.broadcast_to([REFERENCE_STIFFNESS, REFERENCE_DAMPING], (len(theta), 2))
    paths, others = (motions(reading, scenes, each) for each in (theta, np.column_stack([tissue, theta[:, 2]])))
    found = settle(paths, np.full(len(paths), mechanics.load_steps), mechanics)
    after = float(found["settling_time_s"].median())
    reference = _root_mean_square(others[:, -1])
    values = (
        f"{reading.anchor:g} k_s",
        reading.boundary,
        reading.place,
        reading.direction,
        reading.damping,
        float(found["peak"].median()),
        median_share(paths),
        f"{(found['state'] == 'settled').sum()} of {len(paths)}",
        after,
        after + mechanics.load_steps * mechanics.time_step,
        float(found["end_fraction_of_peak"].median()),
        _root_mean_square(paths[:, mechanics.load_steps - 1]),
        _root_mean_square(paths[:, -1]),
        reference,
        farthest(reference),
    )
    return dict(zip(COLUMNS, values, strict=True))


def _root_mean_square(vectors: np.ndarray) -> float:
    return math.sqrt(np.square(vectors).sum(axis=1).mean())


def foundation_for(seconds: float, scenes: Sequence[Scene], theta: np.ndarray) -> float:
    """The foundation, as a multiple of k_s, with which half of the contacts are at rest that long after the start.

    Found by bisection between the least and the largest of ANCHORS, to a thousandth.
    """
    low, high = min(ANCHORS), max(ANCHORS)
    while high - low > 1e-3:
        middle = (low + high) / 2
        # A contact that isn't at rest within the horizon takes longer.
        late = not measure_settling(Reading(anchor=middle), scenes, theta) <= seconds
        low, high = (middle, high) if late else (low, middle)
    return (low + high) / 2


def measure_settling(reading: Reading, scenes: Sequence[Scene], theta: np.ndarray) -> float:
    """Median time from the force's start until a contact is at rest [s]; infinite where half of them never are."""
    mechanics = reading.mechanics
    found = settle(motions(reading, scenes, theta), np.full(len(theta), mechanics.load_steps), mechanics)
    return float(found["settling_time_s"].fillna(math.inf).median() + mechanics.load_steps * mechanics.time_step)


def draw_contacts(count: int, seed: int) -> tuple[list[Scene], np.ndarray]:
    """Sheets with a contact each, and θ spread over them as the paper's estimates are, shape [n, 3]."""
    generator = np.random.default_rng(seed)
    settings = SceneSettings(width=214, height=120)
    scenes = [draw_scene(settings, generator) for _ in range(count)]
    return scenes, THETA + SPREAD * generator.standard_normal((count, 3))


def main(arguments: list[str] | None = None) -> int:
    """Simulate and print the table; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.paper.readings", description=__doc__.split("\n")[0])
    add = parser.add_argument
    add("--contacts", type=whole_number(1), default=16, metavar="N", help="contacts (default %(default)s)")
    add("--seed", type=whole_number(0), default=0, metavar="N", help="of sheets and θ (default %(default)s)")
    options = parser.parse_args(arguments)
    scenes, theta = draw_contacts(options.contacts, options.seed)
    sizes = sorted(len(scene.mesh.vertices) for scene in scenes)
    rows = [list(map(format_number, measure(reading, scenes, theta).values())) for reading in readings()]
    amount = f"{len(scenes)} contacts on sheets of {sizes[0]} to {sizes[-1]} vertices"
    print(f"{amount}, θ as the paper's, seed {options.seed}; lengths in scene units")
    print(to_markdown(list(COLUMNS), rows))
    foundation = foundation_for(REST_TIME_S, scenes, theta)
    print(f"At rest {REST_TIME_S} s after the start: foundation {foundation:.3f} k_s, inside.")
    return 0


if __name__ == "__main__":
    run_door(main)
