"""Young's modulus and Poisson's ratio from palpations of bodies with known truth, as Frank 2010 does (section VIII-A).

    python -m evaluation.palpation --output OUT [--body ball|slab]

A ball and a slab of neo-Hookean tissue on a finer mesh are pressed and observed from one side by two sensors; E and ν
are fitted by the co-rotational law, from starts a factor of thirty off; then E from each of the paper's six forces.
Writes table.csv (file, measure, value), and prints it; what is finished is kept, and the same command continues.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from collections.abc import Sequence

from palpate.evaluation.harness import run
from palpate.evaluation.palpation.surfaces import Frank


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line asks for; returns the exit status."""
    return run(Frank, arguments, "evaluation.palpation", __doc__)


if __name__ == "__main__":
    run_door(main)
