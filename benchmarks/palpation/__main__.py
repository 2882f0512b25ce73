"""Young's modulus and Poisson's ratio from palpations of bodies with known truth (Frank 2010, section VIII-A).

    python -m benchmarks.palpation --output OUT [--body ball|slab]

Writes table.csv (file, measure, value), and prints it; what is finished is kept, and the same command continues.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from collections.abc import Sequence

from benchmarks.harness import run
from benchmarks.palpation import surfaces


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiments; returns the exit status."""
    return run(surfaces.Frank, arguments, "benchmarks.palpation", surfaces.__doc__)


if __name__ == "__main__":
    run_door(main)
