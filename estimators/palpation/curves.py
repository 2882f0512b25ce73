"""Tables of measured forces: probes, pulls, and indentations that are held. Their units are mm and N."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.common.files import read_file
from palpate.data.source.images import printable
from palpate.data.source.layout import InputError
from palpate.data.source.table import MOST_BYTES, read_columns

PROBES = ("probe", "contact_x", "contact_y", "contact_z", "depth_mm", "fn_N")
HOLD = ("t_s", "force_N", "displacement_mm")
PULL, PRESS = ("pull_mm", "force_N"), ("depth_mm", "force_N")
KINDS = (PROBES, HOLD, PULL, PRESS)
"""Columns by which a table is known."""
LEAST = 4
"""Rows of a curve, below which nothing is fitted to it."""
TURN = 0.02
"""Share of a curve's range by which it goes back where it turns."""
STIFFEST = 100.0
"""Of tissue [N/mm]: metres that are given as millimetres make it a thousand times as stiff."""
FAR = 0.9
"""Share of the largest depth from which on a curve that turns has gone as far as it is read."""
DEEPEST, SHALLOWEST, SHORTEST, LONGEST = 100.0, -1.0, 0.1, 1000.0
"""Depths beyond the first two are slips of the pen of whoever recorded them, and are left out; a pull or press that
goes less or further than the others is in another unit [mm]."""


@dataclass(frozen=True, eq=False)
class Probe:
    """Force at growing depths under one place; D of them."""

    name: str
    """Its number in the table."""
    place: np.ndarray
    """Where the surface was touched, not a number where the table doesn't tell, shape [3] [mm]."""
    depth: np.ndarray
    """Along the surface's normal, rising, shape [D] [mm]."""
    force: np.ndarray
    """Along the surface's normal, positive where tissue pushes back, shape [D] [N]."""


@dataclass(frozen=True, eq=False)
class Hold:
    """An indentation that is driven to a depth and held there; T samples."""

    times: np.ndarray
    """Rising, shape [T] [s]."""
    force: np.ndarray
    """Less that before the motion begins, shape [T] [N]."""
    depth: np.ndarray
    """Shape [T] [mm]."""

    @property
    def held(self) -> np.ndarray:
        """Which samples belong to the hold: from the first to the last within 2 % of the largest depth, shape [T]."""
        near = np.flatnonzero(self.depth >= 0.98 * self.depth.max())
        within = np.zeros(len(self.depth), bool)
        within[near[0] : near[-1] + 1] = True
        return within


def kind_of(path: Path) -> tuple[str, ...] | None:
    """Which of KINDS a table is, by its head; None = none of them, or no file that can be read."""
    try:
        head = read_file(path, MOST_BYTES).partition(b"\n")[0]
    except OSError:
        return None
    columns = {name.strip().strip('"') for name in head.decode("utf-8-sig", "replace").split(",")}
    return next((kind for kind in KINDS if columns >= set(kind)), None)


def read_probes(path: Path) -> list[Probe]:
    """Read a table of probes with the columns PROBES; probes of fewer than LEAST usable rows are left out.

    Raises:
        InputError: it can't be read, or holds no probe.
    """
    table = read_columns(path, PROBES, "table of probes")
    depth = table[:, 4]
    table = table[np.isfinite(table).all(axis=1) & (depth > SHALLOWEST) & (depth < DEEPEST)]
    found = []
    for number in np.unique(table[:, 0]):
        rows = table[table[:, 0] == number]
        rows = rows[np.argsort(rows[:, 4], kind="stable")]
        if len(rows) >= LEAST and np.ptp(rows[:, 4]) > 0:
            found.append(Probe(f"{number:g}", rows[0, 1:4], rows[:, 4], rows[:, 5]))
    if not found:
        raise InputError(f"{printable(path)} holds no probe of {LEAST} depths; give a table that does.")
    return found


def read_pull(path: Path) -> Probe:
    """Read one curve with the columns PULL or PRESS, rows in order of time, and keep its loading: what goes further.

    Raises:
        InputError: it can't be read, has too few rows that go further, or its force falls all the way.
    """
    columns = PRESS if kind_of(path) == PRESS else PULL
    table = read_columns(path, columns, "table of a pull, nor of a press (depth_mm), of probes or of a hold")
    table = table[np.isfinite(table).all(axis=1)]
    depth = table[:, 0]
    if len(depth):
        furthest, back = np.maximum.accumulate(depth), TURN * np.ptp(depth)
        # Cycles creep, so that later ones reach further at the same force: only the first that goes far counts.
        far = np.argmax(depth >= FAR * depth.max() + (1 - FAR) * depth.min())
        turned = np.flatnonzero((furthest - depth > back) & (np.arange(len(depth)) > far))
        first, rising = turned[0] if len(turned) else len(depth), np.diff(furthest, prepend=-np.inf) > 0
        # At a turn the force falls at once, and readings that err make samples after it look as if they went further.
        rising &= (depth < depth[:first].max() - back) if len(turned) else True
        table = table[:first][rising[:first]]
    depth, force = table.T
    if len(depth) < LEAST:
        give = f"give {LEAST} different ones in order of time, loading first"
        raise InputError(f"{printable(path)} has {len(depth)} values of {columns[0]} that grow; {give}.")
    if (stiffness := float(np.polyfit(depth, force, 1)[0])) > STIFFEST or not SHORTEST < np.ptp(depth) < LONGEST:
        said = f"resists by {stiffness:.3g} N/mm over {np.ptp(depth):.3g} mm, as no tissue does"
        raise InputError(f"{printable(path)} {said}; give {columns[0]} in millimetres and force_N in newtons.")
    if stiffness < 0:
        raise InputError(f"{printable(path)}: force_N falls as {columns[0]} grows; give what resists it as positive.")
    return Probe("1", np.full(3, np.nan), depth, force)


def read_hold(path: Path) -> Hold:
    """Read an indentation with the columns HOLD.

    Raises:
        InputError: it can't be read, times don't rise, nothing moves, or nothing is held.
    """
    table = read_columns(path, HOLD, "table of an indentation")
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < 4 * LEAST or not (np.diff(table[:, 0]) > 0).all():
        raise InputError(f"{printable(path)} has too few rows, or times that don't rise; give {4 * LEAST} in order.")
    times, force, depth = table.T
    moving = np.flatnonzero(depth - depth[0] > 0.01 * np.ptp(depth))
    if not len(moving):
        raise InputError(f"{printable(path)} shows no indentation: displacement_mm never grows; give one that does.")
    found = Hold(times, force - np.median(force[: max(moving[0], 1)]), depth - depth[0])
    if found.held.sum() < 2 * LEAST:
        raise InputError(f"{printable(path)} holds its depth for {int(found.held.sum())} samples; give a longer hold.")
    return found
