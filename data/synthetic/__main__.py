"""Synthetic clips with known truth, in memory or in CholecSeg8k's folder layout.

`python -m data.synthetic --output DIR --clips N` writes DIR/videoNN/videoNN_00000/ with each frame's picture, masks and
depth, with clip.json (frame rate, camera, times), truth.json and truth.npz, and next to it a video of the clip.
Every clip is a video of its own, so that a split by video works; with --presses a video has several folders, each with
its own truth. No training reads the truth.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import ast
import dataclasses
import functools
import inspect
import itertools
import typing
from typing import Any

from rich.console import Console

from palpate.common.command_line import path_option, progress_bars, say, whole_number
from palpate.common.output import ForeignFile
from palpate.data.synthetic.clip import clip_seed, write_clip
from palpate.data.synthetic.settings import SceneSettings

MOST_PRESSES = 1000
"""Largest number of presses in a video; all of them are drawn before the first frame is written."""
SIZES = {"full": (854, 480), "medium": (428, 240), "small": (214, 120)}
"""Named picture sizes [px]: CholecSeg8k's, half of it, the network's input."""


def field_help(settings: type) -> dict[str, str]:
    """Documentation string of every field of a dataclass, from its source."""
    [definition] = ast.parse(inspect.getsource(settings)).body
    pairs = itertools.pairwise(ast.iter_child_nodes(definition))
    return {
        ast.unparse(field.target): " ".join(ast.literal_eval(text.value).split())
        for field, text in pairs
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr)
    }


def build_parser() -> argparse.ArgumentParser:
    """Command line: the set, and an option for every field of SceneSettings."""
    parser = argparse.ArgumentParser(prog="python -m data.synthetic", description=__doc__.split("\n")[0])
    parser.add_argument("--output", type=path_option, required=True, help="folder that gets videoNN/videoNN_00000/")
    parser.add_argument("--clips", type=whole_number(1), default=1, help="number of clips (default %(default)s)")
    parser.add_argument(
        "--seed", type=whole_number(0), default=0, help="another seed gives other clips (default %(default)s)"
    )
    parser.add_argument(
        "--first", type=whole_number(0), default=1, help="number of the first video (default %(default)s)"
    )
    parser.add_argument(
        "--presses",
        type=whole_number(1, MOST_PRESSES),
        default=1,
        help="folders of a video, each with a scene, parameters and press of its own (default %(default)s)",
    )
    sizes = ", ".join(f"{name} ({width}x{height})" for name, (width, height) in SIZES.items())
    parser.add_argument(
        "--size", type=picture_size, default="full", help=f"picture: {sizes} or WIDTHxHEIGHT (default %(default)s)"
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace synthetic clips that were made with other settings"
    )
    knobs = parser.add_argument_group("scene")
    texts, types = field_help(SceneSettings), typing.get_type_hints(SceneSettings)
    for field in dataclasses.fields(SceneSettings):
        if field.name in ("width", "height"):
            continue
        option: dict[str, Any] = {"default": field.default}
        option["help"] = f"{texts[field.name]} (default {field.default})".replace("%", "%%")
        kind = types[field.name]
        if kind is bool:
            option["action"] = argparse.BooleanOptionalAction
        elif typing.get_origin(kind) is typing.Literal:
            option |= {"choices": typing.get_args(kind), "type": type(field.default)}
        elif typing.get_origin(kind) is tuple:
            option |= {"nargs": 2, "type": float, "metavar": ("LOW", "HIGH")}
        else:
            option |= {"type": kind, "metavar": kind.__name__.upper()}
        knobs.add_argument(f"--{field.name.replace('_', '-')}", **option)
    return parser


def picture_size(text: str) -> tuple[int, int]:
    """Width and height [px] of a named size or WIDTHxHEIGHT.

    Raises:
        ArgumentTypeError: neither.
    """
    if text in SIZES:
        return SIZES[text]
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"is '{text}'; give {', '.join(SIZES)} or WIDTHxHEIGHT such as 854x480")
    return int(width), int(height)


def main(arguments: list[str] | None = None) -> int:
    """Write the clips that the command line asks for; returns the exit status: 0 done, 1 failed, 2 wrong usage."""
    console = Console(stderr=True)
    options = vars(build_parser().parse_args(arguments))
    output, clips, seed, first, presses, (width, height), overwrite = (
        options.pop(name) for name in ("output", "clips", "seed", "first", "presses", "size", "overwrite")
    )
    knobs: dict[str, Any] = {name: tuple(end) if isinstance(end, list) else end for name, end in options.items()}
    try:
        settings = SceneSettings(width=width, height=height, **knobs)
    except ValueError as error:
        say(console, str(error), "red")
        return 2
    try:
        output.mkdir(parents=True, exist_ok=True)
        with progress_bars(console) as progress:
            task = progress.add_task("clips", total=clips * presses * settings.frames)
            for index in range(clips):
                progress.update(task, description=f"clip {index + 1} of {clips}")
                write_clip(
                    output,
                    first + index,
                    settings,
                    clip_seed(seed, index),
                    presses=presses,
                    overwrite=overwrite,
                    advance=functools.partial(progress.advance, task),
                )
    except (ValueError, OSError) as error:
        say(console, _sentence(error), "red")
        return 1
    say(console, f"{clips} clips with truth in {output}")
    return 0


def _sentence(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror and not isinstance(error, ForeignFile):
        where = error.filename or "The output"
        return f"{where} can't be written ({error.strerror}); check --output, its rights and its free space."
    return str(error)


if __name__ == "__main__":
    run_door(main, "Interrupted; finished clips are kept, and the same command continues.")
