"""Renderer of the pages of a folder of results. Jinja2 is imported where a page is made: programs start without it."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.common.files import as_json
from palpate.common.output import ForeignFile, write_own
from palpate.results import store
from palpate.results.page.gather import clip_folders, clip_of, summary_of
from palpate.results.verdicts import NOTES

if TYPE_CHECKING:
    from jinja2 import Environment


def write_pages(output: Path, failed: Iterable[tuple[str, str]] = (), *, anew: bool) -> Path:
    """Write the page of a folder of results, and those of its clips; returns the former.

    Args:
        output: the folder.
        failed: names of this batch's clips without results, each with the sentence that says why.
        anew: whether to write all clips' pages, not only those that are missing or older than their results.

    Raises:
        OutputError: a page can't be written, or a file that this program did not write is in its place.
    """
    environment, rows, failures, foreign = _environment(), [], list(failed), None
    (index, clip_page), colors = store.PAGES, {name: note.color for name, note in NOTES.items()}
    with store.writing(output):
        for folder in clip_folders(output):
            page, text = folder / clip_page, ""
            try:
                summary, made = summary_of(folder), (folder / store.RECORD).stat().st_mtime_ns
                if summary["page"] == clip_page and (anew or not page.exists() or page.stat().st_mtime_ns < made):
                    shown = clip_of(folder)
                    text = environment.get_template("clip.html").render(clip=shown, colors=colors)
            except Exception as error:  # whatever a damaged folder holds, the other clips have their pages
                why = f"its results are damaged or of another version ({type(error).__name__}: {error})"
                failures.append((folder.name, f"{folder}: {why}; compute it again with palpate infer --overwrite."))
                continue
            rows.append(summary)
            try:
                if text:
                    write_own(page, text)
            except ForeignFile as error:
                foreign = error
        shown = {"clips": rows, "failures": failures, "colors": colors}
        write_own(output / index, environment.get_template("index.html").render(shown))
        if foreign is not None:
            raise foreign
    return output / index


@functools.cache
def _environment() -> Environment:
    """Return templates whose every value is escaped: names of files are a user's."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    space: dict[str, Any] = dict.fromkeys(("trim_blocks", "lstrip_blocks", "keep_trailing_newline"), True)
    loader = FileSystemLoader(Path(__file__).with_name("templates"))
    found = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, **space)
    found.policies["json.dumps_function"] = as_json
    found.policies["json.dumps_kwargs"] = {}
    found.filters["cell"] = _cell
    return found


def _cell(value: Any) -> str:
    """Return a number of a JSON file as tables show it; a dash where there is none."""
    return "–" if value is None or value == "" else f"{value:.4g}" if isinstance(value, float) else str(value)
