"""Tissue stiffness, damping and tool force from laparoscopic video: of every frame, and of every run of contact.

    palpate infer INPUT... --output DIR [--estimator network|gan|direct|online] [--model parameters.onnx]

Exit status: 0 all clips done, 1 some failed (named; the others are complete), 2 wrong usage, 130 interrupted (finished
clips stay, and the same command continues).
"""

from __future__ import annotations

import argparse

from palpate.common.command_line import path_option, real_number, whole_number
from palpate.data.contact.interaction import OBSERVATIONS
from palpate.data.depth.normalise import MOST_THREADS
from palpate.data.depth.preset import preset_names
from palpate.estimators.contract import SMOOTHING
from palpate.estimators.direct.estimator import LEAST_SIGMA
from palpate.estimators.onset import ONSETS
from palpate.estimators.open import NAMES
from palpate.results.record import program_version
from palpate.results.run import run


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
    text = "video files, frame folders, or folders of those"
    add("inputs", nargs="+", type=path_option, metavar="INPUT", help=text)
    add("--output", type=path_option, required=True, metavar="DIR", help="folder of the results, one folder a clip")
    text = f"auto, stored, {', '.join(preset_names())}, or a depth model's .onnx file"
    add("--depth", metavar="SOURCE", help=f"{text} (default: as the model was trained, else auto)")
    add("--depth-model", metavar="FILE", help="the .onnx file of a preset that ships none")
    add("--depth-preset", metavar="PRESET", help="preset or .yaml file with the settings to read --depth MODEL.onnx")
    text = "annotation, automatic, or a segmentation model's .onnx file"
    add("--masks", metavar="SOURCE", help=f"{text} (default: annotation where there is one, else automatic)")
    text = "YAML file that names a folder's files (default: CholecSeg8k)"
    add("--layout", type=path_option, metavar="FILE", help=text)
    text = "camera (YAML or JSON) for clips that bring none of their own"
    add("--camera", type=path_option, metavar="FILE", help=text)
    add("--threads", type=whole_number(0, MOST_THREADS), default=0, metavar="N", help="CPU threads; 0 = all (default)")
    add("--overwrite", action="store_true", help="compute all clips again and replace earlier results")
    add("--debug", action="store_true", help="stop at the first failure with its traceback")
    text = (
        "network: a posterior for every frame; gan: the parameter network of train.py; direct: the simulator fitted to "
        "every run of contact, without a network; online: stiffness place by place, relative, of tissue that an "
        "instrument drives, frame by frame (default: what --model is for, else network)"
    )
    add("--estimator", choices=NAMES, help=text)
    text = (
        "file from train.py export (default: the network that comes along); of direct, which needs no file: fem fits a "
        "slab of finite elements instead of a sheet of springs; stiffness is then Young's modulus"
    )
    add("--model", type=path_option, metavar="FILE|fem", help=text)
    thickness = real_number("a thickness; give a positive length", 1e-6)
    text = "of --model fem: how thick the tissue is [scene units: depth over the clip's one scale]"
    add("--thickness", type=thickness, metavar="X", help=text)
    text = "YAML file of online (default: as configs/online.yaml, which explains them)"
    add("--settings", type=path_option, metavar="FILE", help=text)
    text = (
        "when a press begins: between frames, up to a frame's time from the first frame in contact (default, as in "
        "real videos), or at that frame's time stamp (as in data.synthetic's clips)"
    )
    add("--onset", choices=ONSETS, help=text)
    text = (
        "of direct and network: the depth of all visible tissue around the contact (field, default where depth is "
        "given), the motion of the one point that the tool touched first (contact), or, of direct, how the tissue's "
        "light changes (brightness, default where depth is guessed from the pictures)"
    )
    add("--observation", choices=OBSERVATIONS, help=text)
    text = (
        "of direct and network: a press is where masks show an instrument at tissue that moves with it (touching, "
        "default), or where a dent appears, with or without an instrument in view (motion)"
    )
    add("--contact", choices=("touching", "motion"), help=text)
    text = (
        "of direct and online: smooth the tissue's resting shape over this many grid pixels, which also measures the "
        f"depth's noise (default: {SMOOTHING:g})"
    )
    pixels = real_number("a width in pixels; give 0 or more", 0.0)
    add("--smoothing", type=pixels, metavar="PIXELS", help=text)
    noise = real_number(f"a noise above the simulator's own error; give {LEAST_SIGMA:g} or more", LEAST_SIGMA)
    add("--noise", type=noise, metavar="X", help="of direct: noise of the depth [scene units] (default: as measured)")
    text = (
        "table of a force that was measured in a part of the clip (columns time_s, force_N): gives it in newtons for "
        "all of a run whose relative force is determined, in forces.csv"
    )
    add("--known-force", type=path_option, metavar="CSV", help=text)
    text = (
        "YAML file of what is known in newtons: a force, a stiffness, or what calibrate.py palpation wrote, and "
        "measured forces to compare with (docs/forces.md); gives k_s, k_d and F in physical units (calibrated.csv)"
    )
    add("--calibration", type=path_option, metavar="FILE", help=text)
    add("--no-overlay", dest="overlay", action="store_false", help="leave the overlay video out")
    add("--version", action="version", version=f"palpate {program_version()}")
    return parser
