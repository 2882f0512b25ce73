"""Outlines of a clip's instruments by strokes on a page, followed from frame to frame, as `--masks` reads them.

    palpate outline CLIP [--output CLIP.outlines.yaml]

The page opens in a browser of this machine; nobody else can reach it. Draw a line along every instrument of one frame,
press "Follow and save", and draw again where an outline slips. Then:

    palpate infer CLIP --masks CLIP.outlines.yaml --output OUT
"""

import argparse
from typing import Any

from rich.console import Console

from palpate.common.command_line import described_parser, path_option, say, whole_number
from palpate.data.source.layout import InputError
from palpate.outline_page import OutlinePage


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = described_parser("palpate outline", __doc__, "1 the clip can't be used; 2 wrong usage; 130 at Ctrl-C")
    parser.add_argument("clip", type=path_option, metavar="CLIP", help="video file or folder of frames")
    parser.add_argument("--output", type=path_option, help="outlines that are written (default: CLIP.outlines.yaml)")
    parser.add_argument("--port", type=whole_number(0, 65535), default=0, help="of 127.0.0.1 (default: a free one)")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Serve the page until it is interrupted; returns the exit status."""
    options: Any = build_parser().parse_args(arguments)
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
