"""Synthetic clips with known truth, in memory or in CholecSeg8k's folder layout.

    python -m data.synthetic --output clips --clips 3 --seed 1

Writes DIR/videoNN/videoNN_00000/ with each frame's picture, masks and
depth, with clip.json (frame rate, camera, times), truth.json and truth.npz, and next to it a video of the clip.
Every clip is a video of its own, so that a split by video works. No training reads the truth.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from rich.console import Console

from palpate.common.command_line import progress_bars, say, size_of
from palpate.common.options import filled, parse
from palpate.common.output import ForeignFile
from palpate.common.settings import LARGEST
from palpate.data.synthetic.clip import clip_seed, write_clip
from palpate.data.synthetic.settings import SceneSettings


@dataclass(frozen=True)
class Clips:
    """Clips to write."""

    output: Path
    """folder that gets videoNN/videoNN_00000/"""
    clips: Annotated[int, 1, LARGEST] = 1
    """number of clips"""
    seed: Annotated[int, 0, LARGEST] = 0
    """another seed gives other clips"""
    first: Annotated[int, 0, LARGEST] = 1
    """number of the first video; --first 4 --clips 3 writes the last three of --clips 6"""
    size: str = "full"
    """picture: full (854x480), medium (428x240), small (214x120) or WIDTHxHEIGHT"""
    overwrite: bool = False
    """replace synthetic clips that were made with other settings"""

    def __post_init__(self) -> None:
        picture_size(self.size)


def picture_size(text: str) -> tuple[int, int]:
    """Width and height [px] of a named size or WIDTHxHEIGHT.

    Raises:
        ValueError: neither.
    """
    sizes = {"full": (854, 480), "medium": (428, 240), "small": (214, 120)}  # CholecSeg8k's, half, the network's input
    found = sizes.get(text) or size_of(text.lower())
    if found is None:
        raise ValueError(f"--size is '{text}'; give {', '.join(sizes)} or WIDTHxHEIGHT such as 854x480")
    return found


def main(arguments: list[str] | None = None) -> int:
    """Write the clips that the command line asks for; returns the exit status: 0 done, 1 failed, 2 wrong usage."""
    console = Console(stderr=True)
    sides = "width", "height"  # one option, --size
    given = vars(parse((Clips, SceneSettings), arguments, "data.synthetic", __doc__, without=sides))
    try:
        wanted = filled(Clips, given)
        settings = filled(SceneSettings, given | dict(zip(sides, picture_size(wanted.size), strict=True)))
    except ValueError as error:
        say(console, str(error), "red")
        return 2
    try:
        wanted.output.mkdir(parents=True, exist_ok=True)
        with progress_bars(console) as progress:
            task = progress.add_task("clips", total=wanted.clips * settings.frames)
            advance = functools.partial(progress.advance, task)
            for index in range(wanted.clips):
                progress.update(task, description=f"clip {index + 1} of {wanted.clips}")
                number = wanted.first + index
                seed = clip_seed(wanted.seed, number - 1)
                write_clip(wanted.output, number, settings, seed, overwrite=wanted.overwrite, advance=advance)
    except (ValueError, OSError) as error:
        say(console, _sentence(error), "red")
        return 1
    say(console, f"{wanted.clips} clips with truth in {wanted.output}")
    return 0


def _sentence(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror and not isinstance(error, ForeignFile):
        where = error.filename or "The output"
        return f"{where} can't be written ({error.strerror}); check --output, its rights and its free space."
    return str(error)


if __name__ == "__main__":
    run_door(main, "Interrupted; finished clips are kept, and the same command continues.")
