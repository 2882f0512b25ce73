"""Outlines of a clip's instruments by strokes on a page, followed from frame to frame, as `--masks` reads them.

    palpate outline clip.mp4

The page opens in a browser of this machine; nobody else can reach it. Draw a line along every instrument of one frame,
press "Follow and save", and draw again where an outline slips. Then:

    palpate infer CLIP --masks CLIP.outlines.yaml --output OUT
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from rich.console import Console

from palpate.common.command_line import say
from palpate.common.options import option
from palpate.common.options import options as read_options
from palpate.data.source.layout import InputError
from palpate.outline_page import OutlinePage


@dataclass(frozen=True)
class OutlineOptions:
    """The clip and its outlines."""

    clip: Path = option(positional=True, metavar="CLIP")
    """video file or folder of frames"""
    output: Path | None = None
    """outlines that are written (default: CLIP.outlines.yaml)"""
    port: Annotated[int, 0, 65535] = 0
    """port of 127.0.0.1 (default: a free one)"""


def main(arguments: list[str] | None = None) -> int:
    """Serve the page until it is interrupted; returns the exit status."""
    options: OutlineOptions = read_options(OutlineOptions, arguments, "", __doc__)
    console = Console(stderr=True)
    output = options.output or options.clip.with_name(f"{options.clip.stem}.outlines.yaml")
    try:
        with OutlinePage(options.clip, output, options.port) as page:
            say(console, f"Outline instruments at {page.url}; Ctrl-C ends it. Outlines are saved in {output}.")
            page.open()
    except InputError as error:
        say(console, str(error), "red")
    except OSError as error:
        say(console, f"--port {options.port} can't be opened ({error.strerror}); give another port.", "red")
    return 1
