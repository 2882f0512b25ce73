"""Tissue stiffness, damping and tool force from laparoscopic video: of every frame, and of every run of contact.

    palpate infer clip.mp4 --output results --estimator direct

Options of `--estimator` depend on the estimator. Finished clips stay, and the same command continues. Research
software, not a medical device.
"""

from palpate.common.options import Component, parse
from palpate.estimators.open import ESTIMATORS, default_estimator
from palpate.results.options import KINDS
from palpate.results.run import run

ESTIMATOR = Component("estimator", ESTIMATORS, lambda peek: default_estimator(peek("model")))


def main(arguments: list[str] | None = None) -> int:
    """Run the program and return its exit status."""
    return run(parse(KINDS, arguments, "", __doc__, component=ESTIMATOR))
