"""What the parts of the trained system are worth.

    python -m evaluation.ablation terms --clips CLIPS --output DIR [--rows full no-gan …] [--seeds 3]
    python -m evaluation.ablation next-depth --output DIR [--suite noisy] [--clips 30] [--horizon 4] [--checkpoint FILE]

Writes table.csv, and prints it; what is finished is kept in DIR, and the same command continues.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

from collections.abc import Sequence

from palpate.evaluation.ablation import next_depth, terms
from palpate.evaluation.harness import run_named

STUDIES = {"terms": (terms.Terms, terms.DOCUMENTATION), "next-depth": (next_depth.NextDepth, next_depth.__doc__)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study that the command line asks for; returns the exit status."""
    return run_named(STUDIES, arguments, "evaluation.ablation", __doc__)


if __name__ == "__main__":
    run_door(main)
