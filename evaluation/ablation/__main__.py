"""What the parts of the trained system are worth.

    python -m evaluation.ablation terms --clips CLIPS --output DIR [--rows full no-gan …] [--seeds 3]
    python -m evaluation.ablation next-depth --output DIR [--suite noisy] [--clips 30] [--horizon 4] [--checkpoint FILE]

Writes table.csv, and prints it; what is finished is kept in DIR, and the same command continues.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import sys
from collections.abc import Sequence

from palpate.evaluation.ablation import next_depth, terms
from palpate.evaluation.harness import run

STUDIES = {"terms": (terms.Terms, terms.DOCUMENTATION), "next-depth": (next_depth.NextDepth, next_depth.__doc__)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study that the command line asks for; returns the exit status."""
    name, *rest = (sys.argv[1:] if arguments is None else arguments) or [""]
    if name not in STUDIES:
        print(__doc__ if name == "--help" else f"Give one of {', '.join(STUDIES)}, or --help.", file=sys.stderr)
        return 0 if name == "--help" else 2
    kind, documentation = STUDIES[name]
    return run(kind, rest, f"evaluation.ablation {name}", documentation)


if __name__ == "__main__":
    run_door(main)
