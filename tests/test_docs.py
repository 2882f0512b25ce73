"""README and the pages in docs/: links lead somewhere, the reference is complete, and guide pages are easy to read."""

import re
import shlex
from functools import cache
from pathlib import Path

import pytest

import palpate
from palpate.__main__ import main
from tests.conftest import CHECKOUT

DOCS = CHECKOUT / "docs"
GUIDE = [CHECKOUT / "README.md", *(path for path in DOCS.glob("*.md") if path.stem not in ("changelog", "internals"))]
PAGES = [*CHECKOUT.glob("*.md"), *DOCS.rglob("*.md"), *(CHECKOUT / "models/weights").glob("*.md")]
CODE = re.compile(r"```\w*\n(.*?)```", re.DOTALL)


def prose(page: Path) -> str:
    """Text of a page without blocks of code."""
    return CODE.sub("", page.read_text("utf-8"))


def name(page: Path) -> str:
    """Name of a test of a page."""
    return str(page.relative_to(CHECKOUT))


@cache
def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub and MkDocs name them."""
    titles = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if "://" not in target:
            file, _, anchor = target.partition("#")
            found = page.parent / file if file else page
            assert found.exists(), target
            assert not anchor or anchor in anchors(found.resolve()), target


def test_the_reference_has_every_public_name() -> None:
    names = re.findall(r"^::: ([\w.]+)$", (DOCS / "api.md").read_text("utf-8"), re.MULTILINE)
    assert {path.rpartition(".")[2] for path in names} == set(palpate.__all__) - {"__version__"}


@pytest.mark.parametrize("page", GUIDE, ids=name)
def test_pages_are_short_and_so_are_sentences(page: Path) -> None:
    """At most 30 words and two numbers; intervals' 90 %, the lines under tables and numbers in tables don't count."""
    assert page.stat().st_size <= (5000 if page.name == "README.md" else 8000)
    text = re.sub(r"^\*[^*\s][^\n]*(?:\n[^\n]+)*\*$", "", prose(page), flags=re.MULTILINE)
    text = re.sub(r"!?\[((?:[^\[\]]|\[[^\]]*\])*)\]\([^)]*\)|`[^`]*`", lambda found: found[1] or "code", text)
    cells = "|".join(re.findall(r"^\|.*$", text, re.MULTILINE))
    assert [words for words in re.split(r"\||(?<=[.!?])\s", cells) if len(words.split()) > 30] == []
    for paragraph in re.split(r"\n\s*\n|^\s*(?:[-*>] |\d+\. |\|.*|#.*)", text, flags=re.MULTILINE):
        for sentence in re.split(r"(?<=[.!?])\**\s+", " ".join(paragraph.split())):
            assert len(sentence.split()) <= 30, sentence
            assert len(re.findall(r"(?<![\w.×])\d+(?:[.,×]\d+)*(?! % interval)(?![-\w])", sentence)) <= 2, sentence


def test_reports_are_few_and_short_and_open_with_an_abstract_and_a_table() -> None:
    reports = [*(DOCS / "reports").glob("*.md")]
    assert len(reports) <= 6
    for page in reports:
        assert page.stat().st_size <= 10_000, page
        assert re.match(r"# .+\n\n(?:[^#|\n].*\n)+\n(?:## .+\n\n)?\|", page.read_text("utf-8")), page


@pytest.mark.parametrize("page", [*GUIDE, DOCS / "internals.md", *(DOCS / "reports").glob("*.md")], ids=name)
def test_options_of_commands_exist(page: Path, capsys, monkeypatch) -> None:
    monkeypatch.setattr("sys.argv", [])
    code = "\n".join(CODE.findall(page.read_text("utf-8"))).replace("\\\n", "")
    for line in re.findall(r"^(?:.*[|&] )?palpate (\w+.*)$", code, re.MULTILINE):
        command, *words = shlex.split(line, comments=True)
        if command in ("train", "export"):
            continue
        chosen = ["--estimator", words[words.index("--estimator") + 1]] if "--estimator" in words else []
        with pytest.raises(SystemExit, match="0"):
            main([command, *chosen, "--help"])
        known = capsys.readouterr().out
        assert all(re.search(rf"{word}\b", known) for word in words if word.startswith("--")), line
