"""Tables of pulled skin that stiffens, drawn by laws that the fit does not have: are forces beyond them foretold?

    python -m tests.estimators.palpation.drawn_tables --tables 700 --seed 774001

Every seed draws a table of pull and force to 2.5 N: one of LAWS, in the end 8 to 25 times as stiff as at first; one
way, a cycle, or three that creep; 30 to 300 rows a way; 3 to 25 mN of noise; rounded in part. `palpate calibrate
curves` gets the smaller half, by force and by pull, and foretells ten forces that were measured over the larger. A
force whose value comes out empty is refused.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import tempfile
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammainc

from palpate.command.calibrate import main as calibrate
from palpate.common.options import options, require_within
from palpate.common.tables import to_markdown
from tests.tables import read_rows

Law = Callable[[np.ndarray, float], np.ndarray]
LARGEST = 2.5
"""Force at the end [N]."""
BEYOND = 10
"""Forces that are foretold of a table."""
NEAR = 0.25
STRETCH = 0.4
"""Of the skin at the end, over its length."""
FINE = np.linspace(0, 1, 2001)
STEP = FINE[1]


def _sum(stiffness: np.ndarray) -> np.ndarray:
    """Force at FINE of a stiffness there."""
    return np.concatenate([[0], np.cumsum(stiffness[1:] + stiffness[:-1]) * STEP / 2])


def _in_stretch(law: Law) -> Law:
    """A law of the stretch, as one of the share of the pull."""
    return lambda share, power: law(1 + STRETCH * share, power)


LAWS: dict[str, tuple[Law, tuple[float, float]]] = {
    "Ogden": (_in_stretch(lambda s, power: s ** (power - 1) - s ** (-power / 2 - 1)), (2, 60)),
    "Demiray": (_in_stretch(lambda s, b: (s - s**-2) * np.exp(b * (s**2 + 2 / s - 3))), (0.1, 30)),
    "Holzapfel's fibres": (
        _in_stretch(lambda s, b: s - s**-2 + 0.3 * s * (s**2 - 1) * np.exp(b * (s**2 - 1) ** 2)),
        (0, 30),
    ),
    "fibres taut by a gamma distribution": (lambda x, more: _sum(1 + more * gammainc(4, 7 * x)), (1, 200)),
    "toe, then straight": (lambda x, more: _sum(1 + more / (1 + np.exp((0.55 - x) / 0.07))), (1, 200)),
    "toe that ends at a corner": (lambda x, more: x + more * np.maximum(x - 0.55, 0), (1, 200)),
    "power 3.5 of the pull": (lambda x, more: x + more * x**3.5, (0.1, 200)),
    "chains that lock (Langevin)": (lambda x, end: (s := end * x) * (3 - s**2) / (1 - s**2), (0.1, 0.99)),
    "tangent": (lambda x, end: np.tan(end * x), (0.3, 1.55)),
    "two exponentials": (lambda x, b: x + 0.1 * np.expm1(b * x) + 0.1 * np.expm1(b * x / 3), (0.1, 20)),
}
"""Force over the share of the pull, up to a factor, and the range of the number by which it stiffens."""


@dataclass(frozen=True)
class Options:
    """Of the command."""

    tables: int = 100
    """How many are drawn; each is cut twice."""
    seed: int = 774001
    """Of the first table; each further one takes the next seed and the next law."""

    def __post_init__(self) -> None:
        require_within(self, tables=(1, 100_000), seed=(0, 2**31))


@dataclass(frozen=True, eq=False)
class Table:
    """Rows in order of time; the first `way` are the first loading, which rises."""

    pull: np.ndarray
    """Shape [R] [mm]."""
    force: np.ndarray
    """As measured, shape [R] [N]."""
    way: int


def stiffening(law: Law, span: tuple[float, float], growth: float) -> np.ndarray:
    """Force at FINE, 1 in the end, of a law that is `growth` times as stiff in the end as at first."""

    def off(number: float) -> float:
        force = law(FINE, number)
        return np.log((force[-1] - force[-2]) / (force[1] - force[0]) / growth)

    force = law(FINE, float(brentq(off, *span)))
    return (force - force[0]) / (force[-1] - force[0])


def draw_table(seed: int, law: Law, span: tuple[float, float]) -> Table:
    """The table of a seed."""
    draw = np.random.default_rng(seed)
    up = LARGEST * stiffening(law, span, float(np.exp(draw.uniform(np.log(8), np.log(25)))))
    way, longest = int(draw.integers(30, 301)), draw.uniform(6, 20)
    share, lost = np.linspace(0, 1, way), draw.uniform(0.1, 0.4)
    cycles, creep = int(draw.choice([0, 1, 3])), draw.uniform(0, 0.05)
    loading = np.interp(share, FINE, up)
    parts = [(share, loading)]
    for cycle in range(cycles):
        further = share * (1 + cycle * creep)  # later cycles go further, and are softer
        parts += [(further, (1 - lost / 2) * loading)] * (cycle > 0) + [(further[::-1], (1 - lost) * loading[::-1])]
    pull, force = longest * np.concatenate([each[0] for each in parts]), np.concatenate([each[1] for each in parts])
    force = force + draw.normal(0, np.exp(draw.uniform(np.log(0.003), np.log(0.025))), len(force))
    return Table(pull, np.round(force, 2) if draw.uniform() < 0.3 else force, way)


def foretold(table: Table, kept: np.ndarray, folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """What `palpate calibrate curves` says of forces beyond the rows that are kept, by these alone.

    Returns:
        forces as measured, shape [10] [N]; the values, not a number where refused; ends of 90 % intervals, [2, 10].
        None = it refused the whole table.
    """
    rows = np.column_stack([table.pull, table.force])[kept]
    np.savetxt(folder / "pull.csv", rows, "%.4f", ",", header="pull_mm,force_N", comments="")
    beyond = np.flatnonzero(~kept[: table.way])
    beyond = beyond[np.linspace(0, len(beyond) - 1, BEYOND).round().astype(int)]
    asked = [f"{at:.4f}" for at in table.pull[beyond]]
    output = folder / "out"
    with redirect_stderr(StringIO()):
        if calibrate(["curves", str(folder / "pull.csv"), "--output", str(output), "--predict", *asked]) != 0:
            return None
    said = [row for row in read_rows(output / "curves.csv") if row["quantity"].startswith("force at")]
    numbers = [[float(row[name] or "nan") for row in said] for name in ("value", "low", "high")]
    return table.force[beyond], np.array(numbers[0]), np.array(numbers[1:])


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge; returns the exit status."""
    chosen = options(Options, arguments, "tests.estimators.palpation.drawn_tables", __doc__)
    found: dict[tuple[str, str], list[np.ndarray]] = {}
    refused = 0
    with tempfile.TemporaryDirectory() as name:
        for index in range(chosen.tables):
            law = list(LAWS)[index % len(LAWS)]
            table = draw_table(chosen.seed + index, *LAWS[law])
            for cut, kept in (
                ("half of the force", table.force <= LARGEST / 2),
                ("half of the pull", table.pull <= table.pull[: table.way].max() / 2),
            ):
                answer = foretold(table, kept, Path(name))
                if answer is None:
                    refused += 1
                    continue
                force, value, (low, high) = answer
                given, held = np.isfinite(value), (low <= force) & (force <= high)
                near = np.abs(value - force) <= NEAR * np.abs(force)
                for where in (law, "all"):
                    found.setdefault((where, cut), []).append(np.stack([given, near, held, force > high]))
    rows = []
    for (law, cut), parts in sorted(found.items(), key=lambda each: (each[0][1], each[0][0] == "all")):
        given, near, held, above = np.concatenate(parts, axis=1)
        tables = np.array([part[2].mean() >= 0.8 for part in parts])
        shares = given, near[given], held[given], held, above, tables
        rows.append((cut, law, f"{len(parts)}", *(f"{each.mean():.1%}" if len(each) else "" for each in shares)))
    of_given = "of these within 25 %", "of these inside their interval"
    heads = "cut at", "law", "tables", "given", *of_given, "all inside", "above it", "tables with 80 % inside"
    print(to_markdown(heads, rows))
    print(f"\nRefused as a whole: {refused} of {2 * chosen.tables} tables")
    return 0


if __name__ == "__main__":
    run_door(main)
