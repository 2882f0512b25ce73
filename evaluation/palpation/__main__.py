"""Measured forces on tissue, each study judged on known truth or on what was kept back.

    python -m evaluation.palpation curves --data DIR --output OUT
    python -m evaluation.palpation frank --output OUT [--body ball|slab]

Writes table.csv (file, measure, value), and prints it; what is finished is kept, and the same command continues.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import sys
from collections.abc import Sequence

from palpate.evaluation.harness import run
from palpate.evaluation.palpation import curves, surfaces

STUDIES = {"curves": (curves.Curves, curves.__doc__), "frank": (surfaces.Frank, surfaces.__doc__)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study that the command line asks for; returns the exit status."""
    name, *rest = (sys.argv[1:] if arguments is None else arguments) or [""]
    if name == "--help":
        print(__doc__)
        return 0
    if name not in STUDIES:
        print(f"Give one of {', '.join(STUDIES)}, or --help.", file=sys.stderr)
        return 2
    study, text = STUDIES[name]
    return run(study, rest, f"evaluation.palpation {name}", text)


if __name__ == "__main__":
    run_door(main)
