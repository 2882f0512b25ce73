"""The page: parsed as HTML, escaped, dated, with units and versions."""

import re
from datetime import UTC, datetime
from html.parser import HTMLParser

import numpy as np
import pytest

from evaluation.paper.analysis import analyse
from evaluation.paper.page import render_page, versions
from evaluation.paper.tables import Table
from tests.evaluation.simple_contacts import BOUNDS, MECHANICS, record

NAMES = ("errors", "tests", "regularity", "settling", "spread", "constant", "depth")


class _Balance(HTMLParser):
    """Checks that every element that needs it is closed, in order."""

    EMPTY = frozenset({"meta", "img"})

    def __init__(self):
        super().__init__()
        self.open, self.text = [], []

    def handle_starttag(self, tag, attrs):
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in self.EMPTY:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def page():
    evaluation = analyse([record(np.array([0.2, 0.02, -0.05]), (0.3, 0.05, -0.06))], [], MECHANICS, BOUNDS)
    tables = {name: Table(f"<{name}>", ("a", "b"), (("x", 1.5),)) for name in NAMES}
    figures = {"figure3.png": b"\x89PNG 1", "theta.png": b"\x89PNG 2"}
    return render_page(evaluation, tables, figures, MECHANICS, BOUNDS, datetime(2026, 3, 4, 5, 6, tzinfo=UTC))


def test_elements_are_balanced_and_text_is_escaped(page):
    parser = _Balance()
    parser.feed(page)
    assert parser.open == []
    text = "".join(parser.text)
    for name in NAMES:
        assert f"<{name}>" in text
    assert "<errors>" not in page


def test_page_says_what_it_is_when_and_how_it_was_made(page):
    assert "2026-03-04 05:06 UTC" in page
    assert "Not a medical device." in page
    assert "not N/m, N·s/m and N" in page
    assert "40 steps of 0.005 s" in page
    assert "stiffness 0.05 … 2; damping 0.005 … 0.3; force -0.5 … 0" in page
    assert f"numpy {np.__version__}" in page


def test_figures_are_embedded_with_descriptions(page):
    assert page.count("data:image/png;base64,iVBORyAx") == 1
    assert len(re.findall(r'<img src="data:[^"]*" alt="[^"]+" />', page)) == 2


def test_versions_leave_out_what_is_not_installed():
    found = versions()
    assert found["numpy"] == np.__version__
    assert re.fullmatch(r"3\.\d+\.\d+\S*", found["python"])
    assert None not in found.values()
