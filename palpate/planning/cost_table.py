"""Presses on a block of tissue, simulated once, cached for that block, and generalised by a Gaussian kernel.

Segments lead through an object at evenly spread places and directions (Frank 2010, section VII). Between them costs
follow from the kernel smoother of equation 4 over place and direction, and along the length they are linear. A block is
the same seen from behind, and mirrored if held alike left and right, so half or a quarter of the presses suffice. The
file's name is a digest of all that the costs depend on: another scene with the same block finds it.
"""

import functools
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from palpate.common.files import digest_of
from palpate.common.output import replacing_own, require_own
from palpate.common.provenance import code_digest
from palpate.planning.press import MOST_FORCE, STEPS, simulate_press
from palpate.planning.scene import PlanScene, SoftObject

PLACES = 9
"""Number of places along the width, ends included."""
ANGLES = np.radians(np.arange(-60.0, 61.0, 15.0))
"""Angles from a face's inward normal."""
LENGTHS = 41
WIDTH = 0.5
"""Kernel width h of equation 4, over the spacing of places and of angles."""


@dataclass(frozen=True, eq=False)
class CostTable:
    """Presses on a block, K of them of L lengths."""

    places: np.ndarray
    """Places where it is touched, in the block's frame, y ≤ 0, shape [K, 2] [m]."""
    angles: np.ndarray
    """Shape [K] [rad]."""
    lengths: np.ndarray
    """Shape [L] [m]."""
    work: np.ndarray
    """Shape [K, L] [J]."""
    spacing: float
    """Spacing of the places [m]."""

    def cost(self, places: np.ndarray, angles: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """Return the work of other presses, shape [M] [J].

        Args:
            places: in the block's frame, shape [M, 2] [m].
            angles: of the tip's way there, shape [M] [rad].
            lengths: shape [M] [m].
        """
        places, angles = mirrored(places, angles)
        apart = np.linalg.norm(places[:, None] - self.places, axis=2) / (WIDTH * self.spacing)
        turned = np.angle(np.exp(1j * (angles[:, None] - self.angles))) / (WIDTH * float(np.diff(ANGLES)[0]))
        squared = apart**2 + turned**2
        weights = np.exp(-(squared - squared.min(axis=1, keepdims=True)) / 2)  # far from all: the closest
        curves = weights @ self.work / weights.sum(axis=1, keepdims=True)
        at = lengths / self.lengths[-1] * (len(self.lengths) - 1)
        return map_coordinates(curves, [np.arange(len(at)), at], order=1, mode="nearest")


def mirrored(places: np.ndarray, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the presses seen from the side from which they come with y ≤ 0."""
    behind = places[:, 1] > 0
    return np.where(behind[:, None], places * [1, -1], places), np.where(behind, -angles, angles)


def grid_of(kind: SoftObject) -> tuple[np.ndarray, np.ndarray]:
    """Return places [K, 2] and angles [K] of a block's presses: on its front, and on its two ends."""
    width, thickness = kind.size[:2]
    front = [[x, -thickness / 2] for x in np.linspace(-width / 2, width / 2, PLACES)]
    ends = [([-width / 2, 0.0], 0.0), ([width / 2, 0.0], np.pi)]
    found = [(place, np.pi / 2 + angle) for place in front for angle in ANGLES]
    found += [(place, inward + angle) for place, inward in ends for angle in ANGLES]
    return np.array([place for place, _ in found]), np.array([angle for _, angle in found])


def representatives(kind: SoftObject, places: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return for presses [K, 2] the first one that costs the same as each, shape [K]."""
    presses = zip(places, angles, strict=True)
    keys = [min(_key(*image) for image in _images(kind, place, angle)) for place, angle in presses]
    return np.array([keys.index(key) for key in keys])


def _images(kind: SoftObject, place: np.ndarray, angle: float) -> list[tuple[np.ndarray, float]]:
    """Return a press and its equivalents on a block: seen from behind, and mirrored left to right."""
    found = [(place, angle), (place * [1, -1], -angle)]
    if ("left" in kind.held) == ("right" in kind.held):
        found += [(there * [-1, 1], np.pi - way) for there, way in found]
    return found


def _key(place: np.ndarray, angle: float) -> tuple[float, ...]:
    """Return one key for presses that differ by rounding."""
    return tuple(np.round([*place, np.cos(angle), np.sin(angle)], 9) + 0.0)


def digest(kind: SoftObject, radius: float) -> str:
    """Return a digest of all that a table depends on."""
    version = 3  # of what is in a file
    constants = [version, code_digest("kernels"), PLACES, ANGLES.tolist(), LENGTHS, STEPS, MOST_FORCE]
    return digest_of([*constants, radius, asdict(kind)])[:16]


def open_table(
    kind: SoftObject, radius: float, cache: Path, report: Callable[[int, int], None] = lambda done, of: None
) -> tuple[CostTable, int]:
    """Return a block's table from the cache, or simulated and kept there; and how many presses were simulated.

    Args:
        kind: the block.
        radius: of the tip [m].
        cache: folder.
        report: is given how many presses are done, of how many.

    Raises:
        ForeignFile: a table that is damaged or not this program's lies in the cache.
    """
    places, angles = grid_of(kind)
    lengths, alike = np.linspace(0, kind.longest, LENGTHS), representatives(kind, places, angles)
    rows, which = np.unique(alike, return_inverse=True)

    def works() -> dict[str, np.ndarray]:
        work = np.zeros((len(rows), LENGTHS))
        for done, row in enumerate(rows):
            work[done] = simulate_press(kind, radius, places[row], float(angles[row])).work_at(lengths)
            report(done + 1, len(rows))
        return {"work": work[which]}

    known, found = kept(cache / f"presses-{digest(kind, radius)}.npz", works)
    table = CostTable(places, angles, lengths, known["work"], kind.size[0] / (PLACES - 1))
    return table, 0 if found else len(rows)


def kept(path: Path, made: Callable[[], dict[str, Any]]) -> tuple[dict[str, Any], bool]:
    """Return arrays of a file and whether it was there; otherwise they are made, and kept in it.

    Raises:
        ForeignFile: a file that is damaged or not this program's lies there.
        OSError: it, or its folder, can't be read or written.
    """
    require_own(path)  # before minutes of simulation; and what is our own is whole
    found = path.exists()
    if not found:
        path.parent.mkdir(parents=True, exist_ok=True)
        content = made()
        with replacing_own(path) as partial, partial.open("wb") as file:
            np.savez(file, **content)
    with np.load(path, allow_pickle=False) as file:
        return dict(file), found


def open_tables(
    scene: PlanScene, cache: Path, report: Callable[[str, int, int], None] = lambda kind, done, of: None
) -> dict[str, CostTable]:
    """Return tables of a scene's kinds of tissue by name, from the cache or simulated and kept there.

    Args:
        scene: what is to be planned.
        cache: folder.
        report: is given a kind's name, how many of its presses have been simulated, and of how many.

    Raises:
        ForeignFile: see `open_table`.
    """
    kinds = [(name, kind, functools.partial(report, name)) for name, kind in scene.objects.items()]
    return {name: open_table(kind, scene.tip_radius, cache, made)[0] for name, kind, made in kinds}
