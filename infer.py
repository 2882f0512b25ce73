"""Tissue stiffness, damping and tool force from laparoscopic video: of every frame, and of every run of contact.

    python infer.py INPUT... --output DIR [--estimator network|gan|direct] [--model parameters.onnx]

Exit status: 0 all clips done, 1 some failed (named; the others are complete), 2 wrong usage, 130 interrupted (finished
clips stay, and the same command continues).
"""

from __future__ import annotations

from physics.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse

from data.command_line import path_option, real_number
from estimators.direct.estimator import LEAST_SIGMA, SMOOTHING
from estimators.onset import ONSETS
from estimators.open import NAMES
from results.run import ONSET_HELP, add_input_options, add_version, run


def main(arguments: list[str] | None = None) -> int:
    """Run the program and return its exit status."""
    return run(_parser().parse_args(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description="Estimate tissue stiffness, damping and tool force of laparoscopic clips. Research software, not a "
        "medical device.",
        epilog="Exit status: 0 all clips done, 1 some failed, 2 wrong usage, 130 interrupted.",
    )
    add = parser.add_argument
    add_input_options(add)
    text = (
        "network: a posterior for every frame; gan: the parameter network of train.py; direct: the simulator fitted to "
        "every run of contact, without a network (default: what --model is for, else network)"
    )
    add("--estimator", choices=NAMES, help=text)
    add(
        "--model",
        type=path_option,
        metavar="FILE",
        help="file from train.py export (default: the network that comes along)",
    )
    add("--onset", choices=ONSETS, help=ONSET_HELP)
    text = (
        "of direct: smooth the tissue's resting shape over this many grid pixels, which also measures the depth's "
        f"noise (default: {SMOOTHING:g})"
    )
    pixels = real_number("a width in pixels; give 0 or more", 0.0)
    add("--smoothing", type=pixels, metavar="PIXELS", help=text)
    noise = real_number(f"a noise above the simulator's own error; give {LEAST_SIGMA:g} or more", LEAST_SIGMA)
    add("--noise", type=noise, metavar="X", help="of direct: noise of the depth [scene units] (default: as measured)")
    add("--no-overlay", dest="overlay", action="store_false", help="leave the overlay video out")
    add_version(parser)
    return parser


if __name__ == "__main__":
    run_door(main)
