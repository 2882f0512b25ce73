"""Measured forces on tissue, each study judged on known truth or on what was kept back.

    python -m evaluation.palpation curves --data DIR --output OUT
    python -m evaluation.palpation frank --output OUT [--body ball|slab]

Writes table.csv (file, measure, value), and prints it; what is finished is kept, and the same command continues.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from collections.abc import Sequence

from palpate.evaluation.harness import run_named
from palpate.evaluation.palpation import curves, surfaces

STUDIES = {"curves": (curves.Curves, curves.__doc__), "frank": (surfaces.Frank, surfaces.__doc__)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study that the command line asks for; returns the exit status."""
    return run_named(STUDIES, arguments, "evaluation.palpation", __doc__)


if __name__ == "__main__":
    run_door(main)
