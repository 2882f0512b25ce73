"""The pages of a folder of results, written again: one of the batch, index.html, and one of every clip.

    palpate page results

`palpate infer` writes them itself; this is for results that were moved, copied together or made by another version.
"""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from palpate.common.command_line import say
from palpate.common.options import option, options
from palpate.results.page.gather import clip_folders
from palpate.results.page.render import write_pages
from palpate.results.store import OutputError


@dataclass(frozen=True)
class PageOptions:
    """The results."""

    results: Path = option(positional=True, metavar="RESULTS")
    """folder of results: --output of palpate infer"""

    def __post_init__(self) -> None:
        """Raise a ValueError where the folder holds no results."""
        with suppress(OSError):
            if self.results.is_dir() and clip_folders(self.results):
                return
        raise ValueError(f"{self.results} holds no results, or can't be read; give --output of palpate infer.")


def main(arguments: list[str] | None = None) -> int:
    """Write the pages of the folder that the command line names; returns the exit status."""
    folder = options(PageOptions, arguments, "", __doc__).results
    try:
        print(write_pages(folder, anew=True))
    except OutputError as error:
        say(Console(stderr=True), str(error), "red")
        return 1
    return 0
