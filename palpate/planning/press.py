"""Cost of pushing an instrument's tip into a block of tissue along a straight line, simulated.

The tip's force is spread over a patch of its radius and grows in steps until the patch has gone far enough, or until 20
N (Frank 2010, section V). The work is the deformation's cost. Where no equilibrium is found any more, the force goes on
along its last straight piece.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import cumulative_trapezoid

from palpate.planning.scene import SoftObject

if TYPE_CHECKING:
    from palpate.estimators.palpation.skin import Skin

MOST_FORCE = 20.0
"""[N]."""
STEPS = 5
"""Approximate number of steps of the longest press."""


@dataclass(frozen=True, eq=False)
class PressCurve:
    """A press; S steps, of which the first is rest."""

    lengths: np.ndarray
    """Distance of the patch along the line, rising, shape [S] [m]."""
    force: np.ndarray
    """Shape [S] [N]."""
    work: np.ndarray
    """Shape [S] [J]."""

    def work_at(self, lengths: np.ndarray) -> np.ndarray:
        """Return the work of presses so long [m], shape as given [J]; beyond the end no more is done."""
        return np.interp(lengths, self.lengths, self.work)


@lru_cache(maxsize=8)
def blocked_out(kind: SoftObject, radius: float) -> tuple[Skin, np.ndarray]:
    """Return a block's skin, fine enough for a patch of that radius, in its own frame, and what of it is held [N,
    3]."""
    from palpate.estimators.palpation.skin import cover  # takes a second, and cached presses need none of it
    from palpate.physics.fem import box, make_solid

    width, thickness, height = kind.size
    shift = np.array([width / 2, thickness / 2, 0.0])
    nodes, tetrahedra = box(kind.size, kind.cells)
    body = make_solid(nodes - shift, tetrahedra, order=2)
    fine = [max(1, int(np.ceil(side / (radius / 2)))) for side in kind.size]
    outer, inner = box(kind.size, (fine[0], fine[1], fine[2]))
    used, which = np.unique(make_solid(outer, inner).faces, return_inverse=True)
    skin = cover(body, outer[used] - shift, which.reshape(-1, 3))
    ends = {"bottom": (2, 0.0), "top": (2, height), "left": (0, -width / 2), "right": (0, width / 2)}
    held = np.zeros(len(body.rest), bool)
    for side in kind.held:
        axis, place = ends[side]
        held |= np.isclose(body.rest[:, axis], place, atol=1e-9 + 1e-6 * width)
    return skin, np.repeat(held[:, None], 3, axis=1)


def simulate_press(kind: SoftObject, radius: float, place: np.ndarray, angle: float) -> PressCurve:
    """Press a block.

    Args:
        kind: the block.
        radius: of the tip [m].
        place: where the tip touches, in the block's frame, shape [2] [m].
        angle: of the way it goes there [rad].
    """
    from palpate.physics.fem import Material, NoEquilibrium, find_equilibrium

    skin, held = blocked_out(kind, radius)
    way = np.array([np.cos(angle), np.sin(angle), 0.0])
    unit = skin.pressed(np.array([*place, kind.height]), radius, way)
    material = Material("corotational", kind.young, kind.poisson)
    lengths, forces = [0.0], [0.0]
    rest, share = find_equilibrium(skin.body, material, held), 1.0
    while lengths[-1] < kind.longest and forces[-1] < MOST_FORCE:
        slope = rest.moved_by(unit[..., None])[..., 0]
        compliance = float((unit * slope).sum())
        if not compliance > 0:
            break
        gained = min(share * kind.longest / STEPS / compliance, MOST_FORCE - forces[-1])
        try:
            start = rest.displacement + gained * slope
            found = find_equilibrium(skin.body, material, held, forces=(forces[-1] + gained) * unit, start=start)
        except NoEquilibrium:
            if (share := share / 2) < 1 / 2:
                break
            continue
        rest, moved = found, float((unit * found.displacement).sum())
        if moved <= lengths[-1]:
            break
        lengths.append(moved)
        forces.append(forces[-1] + gained)
    if lengths[-1] < kind.longest and len(lengths) > 1 and forces[-1] < MOST_FORCE:
        stiffness = (forces[-1] - forces[-2]) / (lengths[-1] - lengths[-2])
        left = min(kind.longest - lengths[-1], (MOST_FORCE - forces[-1]) / stiffness)
        lengths.append(lengths[-1] + left)
        forces.append(forces[-1] + stiffness * left)
    return PressCurve(np.array(lengths), np.array(forces), cumulative_trapezoid(forces, lengths, initial=0))
