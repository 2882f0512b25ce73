"""Tissue stiffness, damping and tool force from laparoscopic video: of every frame, and of every run of contact.

    palpate infer INPUT... --output DIR [--estimator network|gan|direct|online] [--model parameters.onnx]

Exit status: 0 all clips done, 1 some failed (named; the others are complete), 2 wrong usage, 130 interrupted (finished
clips stay, and the same command continues).
"""

import argparse
from typing import Any

from palpate.common.command_line import Parser, add_listed, path_option, real_number, whole_number
from palpate.common.files import read_beside
from palpate.common.onnx_devices import DEVICES
from palpate.common.provenance import __version__
from palpate.data.contact.interaction import OBSERVATIONS
from palpate.data.depth.normalise import MOST_THREADS
from palpate.data.depth.preset import preset_names
from palpate.estimators.contract import SMOOTHING
from palpate.estimators.direct.estimator import LEAST_SIGMA
from palpate.estimators.network.estimator import RATES
from palpate.estimators.onset import ONSETS
from palpate.estimators.open import NAMES
from palpate.results.run import run
from palpate.results.store import BAGS

TYPES = {
    "jobs": whole_number(1, MOST_THREADS),
    "path": path_option,
    "threads": whole_number(0, MOST_THREADS),
    "diameter": real_number("a shaft's diameter; give 1 to 30 mm, such as 5 or 8", 1.0, 30.0),
    "limit": real_number("a limit of force; give a positive number", 1e-9),
    "pixels": real_number("a width in pixels; give 0 or more", 0.0),
    "noise": real_number(f"a noise above the simulator's own error; give {LEAST_SIGMA:g} or more", LEAST_SIGMA),
}
CHOICES = {
    "names": NAMES,
    "onsets": ONSETS,
    "observations": OBSERVATIONS,
    "rates": RATES,
    "devices": DEVICES,
    "bags": tuple(BAGS),
}
"""What infer.yaml calls types and choices."""


WORDS = {"presets": ", ".join(preset_names()), "smoothing": SMOOTHING}
"""Words that stand for their braces in infer.yaml."""


def declared() -> dict[str, dict[str, Any]]:
    """Return the options of infer.yaml by name."""
    return read_beside(__file__)["options"]


def main(arguments: list[str] | None = None) -> int:
    """Run the program and return its exit status."""
    return run(_parser().parse_args(arguments))


def _parser() -> argparse.ArgumentParser:
    texts = read_beside(__file__)
    parser = Parser(description=texts["description"], epilog=texts["epilog"])
    add_listed(parser, declared(), TYPES, CHOICES, **WORDS)
    parser.add_argument("--version", action="version", version=f"palpate {__version__}")
    return parser
