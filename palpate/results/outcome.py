"""Outcome of a batch's clips: in words, in counts, the closing table and the page."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from palpate.common.command_line import say
from palpate.common.doors import plain
from palpate.results.options import in_options
from palpate.results.page.gather import contacts_of
from palpate.results.page.render import write_pages
from palpate.results.store import RESULTS, OutputError, read_record
from palpate.results.verdicts import OWN_UNITS

DONE, UP_TO_DATE, FAILED = "done", "up to date", "failed"


@dataclass
class Outcome:
    """Outcome of one clip, or of one input without any."""

    name: str
    state: str
    where: str
    """Folder of the results, or why there are none."""
    counts: dict[str, int] = field(default_factory=dict)
    """Counts of what was found in the clip (see `counts_of`)."""
    contacts: list[tuple[str, ...]] = field(default_factory=list)
    """Number and first frame, what is determined, and verdict of every contact."""

    @classmethod
    def of(cls, name: str, state: str, folder: Path) -> Self:
        """Return the outcome of a clip with results in a folder."""
        return cls(name, state, str(folder), counts_of(read_record(folder)), _contacts(folder))


def wording(error: Exception) -> str:
    """Return an error's message in this program's words."""
    return in_options(str(error)) or type(error).__name__


def counts_of(record: Mapping[str, Any]) -> dict[str, int]:
    """Return counts of a clip for the closing table: runs of contact by verdict, then frames by verdict or status."""
    contacts = {f"{plural(count, 'contact')} {name}": count for name, count in record.get("contacts", {}).items()}
    frames = {name: count for name, count in record.get("statuses", {}).items() if name != "ok"}
    verdicts = record.get("verdicts", {})
    touching = record.get("statuses", {}).get("ok", 0) - sum(verdicts.values())
    found = contacts | {f"{plural(count, 'frame')} {name}": count for name, count in (verdicts | frames).items()}
    return found | ({f"{plural(touching, 'frame')} in contact": touching} if touching else {})


def plural(count: int, noun: str) -> str:
    """Return the noun, in the plural unless the count is one."""
    return noun if count == 1 else f"{noun}s"


def _contacts(folder: Path) -> list[tuple[str, ...]]:
    """Return lines of the table of estimates: number and first frame, what is determined, and verdict of every
    contact."""
    if not (folder / RESULTS).is_file():
        return []  # a sequence
    return [
        (f"{at}, frame {one['row']['onset_frame']}", estimate, one["name"].replace("_", " "))
        for at, one in enumerate(contacts_of(folder), start=1)
        for estimate in ["\n".join(" ".join(each) for each in one["numbers"] if "±" in each[1]) or "—"]
    ]


def _print(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table of cells that do nothing to a terminal."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in columns:
        table.add_column(name, no_wrap=name == "estimate", overflow="fold", max_width=24 if name == "clip" else None)
    for row in rows:
        table.add_row(*map(Text, row))
    Console().print(table, soft_wrap=True)


def conclude(output: Path, outcomes: list[Outcome], console: Console) -> None:
    """Print what was estimated and how the clips went, write the batch's page and its clips', and say where."""
    estimates = [(plain(outcome.name), *line) for outcome in outcomes for line in outcome.contacts]
    if estimates:
        _print(f"Estimates (±: 90 % interval). {OWN_UNITS}", ("clip", "contact", "estimate", "verdict"), estimates)
    # A line a status: a column each would leave no room for the rest on a narrow terminal.
    counts = ["\n".join(plain(f"{count} {status}") for status, count in outcome.counts.items()) for outcome in outcomes]
    clips = [(plain(one.name), one.state, found, plain(one.where)) for one, found in zip(outcomes, counts, strict=True)]
    _print("Clips", ("clip", "result", "found", "results in, or why not"), clips)
    failed = [(outcome.name, outcome.where) for outcome in outcomes if outcome.state == FAILED]
    try:
        say(console, f"Look at {write_pages(output, failed, anew=False)}")
    except OutputError as error:
        say(console, f"no page: {error}")
