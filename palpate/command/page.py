"""The pages of a folder of results, written again: one of the batch, index.html, and one of every clip.

    palpate page RESULTS

`palpate infer` writes them itself; this is for results that were moved, copied together or made by another version.
"""

from typing import Any

from rich.console import Console

from palpate.common.command_line import described_parser, path_option, say
from palpate.results.page.gather import clip_folders
from palpate.results.page.render import write_pages
from palpate.results.store import OutputError


def main(arguments: list[str] | None = None) -> int:
    """Write the pages of the folder that the command line names; returns the exit status."""
    parser = described_parser("palpate page", __doc__, "0 written; 1 they could not be; 2 wrong usage; 130 interrupted")
    parser.add_argument("results", type=path_option, metavar="RESULTS", help="what was --output of palpate infer")
    options: Any = parser.parse_args(arguments)
    try:
        found = options.results.is_dir() and clip_folders(options.results)
    except OSError as error:
        parser.error(f"{options.results} can't be read ({error.strerror}); give the folder that was --output.")
    if not found:
        parser.error(f"{options.results} holds no results of palpate infer; give the folder that was its --output.")
    try:
        print(write_pages(options.results, anew=True))
    except OutputError as error:
        say(Console(stderr=True), str(error), "red")
        return 1
    return 0
