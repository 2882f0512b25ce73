"""How the clips of a batch went: in words, in counts, the closing table and the page."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from palpate.common.command_line import say
from palpate.common.doors import plain
from palpate.results.options import in_options
from palpate.results.page.render import write_pages
from palpate.results.store import OutputError

DONE, UP_TO_DATE, FAILED = "done", "up to date", "failed"


@dataclass
class Outcome:
    """How one clip, or one input without any, went."""

    name: str
    state: str
    where: str
    """Folder of the results, or why there are none."""
    counts: dict[str, int] = field(default_factory=dict)
    """What was found in the clip (see `counts_of`)."""


def wording(error: Exception) -> str:
    """An error's message in this program's words."""
    return in_options(str(error)) or type(error).__name__


def counts_of(record: Mapping[str, Any]) -> dict[str, int]:
    """What the closing table says of a clip: runs of contact by verdict, then frames by verdict or status."""
    contacts = {f"{plural(count, 'contact')} {name}": count for name, count in record.get("contacts", {}).items()}
    frames = {name: count for name, count in record.get("statuses", {}).items() if name != "ok"}
    verdicts = record.get("verdicts", {})
    touching = record.get("statuses", {}).get("ok", 0) - sum(verdicts.values())
    found = contacts | {f"{plural(count, 'frame')} {name}": count for name, count in (verdicts | frames).items()}
    return found | ({f"{plural(touching, 'frame')} in contact": touching} if touching else {})


def plural(count: int, noun: str) -> str:
    """The noun, in the plural unless the count is one."""
    return noun if count == 1 else f"{noun}s"


def _table(outcomes: list[Outcome]) -> Table:
    """Clips with what was counted in them, and where the results lie."""
    table = Table(title="Clips", title_justify="left")
    table.add_column("clip", no_wrap=True, max_width=24)
    table.add_column("result", no_wrap=True)
    table.add_column("found", no_wrap=True)
    table.add_column("results in, or why not", overflow="fold")
    for outcome in outcomes:
        # A line a status: a column each would leave no room for the rest on a narrow terminal.
        counts = "\n".join(plain(f"{count} {status}") for status, count in outcome.counts.items())
        table.add_row(Text(plain(outcome.name)), outcome.state, Text(counts), Text(plain(outcome.where)))
    return table


def conclude(output: Path, outcomes: list[Outcome], console: Console) -> None:
    """Print the closing table, write the batch's page and its clips', and say where, or why not."""
    Console().print(_table(outcomes), soft_wrap=True)
    failed = [(outcome.name, outcome.where) for outcome in outcomes if outcome.state == FAILED]
    try:
        say(console, f"Look at {write_pages(output, failed, anew=False)}")
    except OutputError as error:
        say(console, f"no page: {error}")
