"""Markdown and figures as one HTML page."""

import base64
import io
from collections.abc import Mapping
from pathlib import Path
from string import Template

from markdown_it import MarkdownIt
from matplotlib.figure import Figure

PAGE = Template(Path(__file__).with_suffix(".html").read_text(encoding="utf-8"))


def render_page(title: str, text: str, figures: Mapping[str, bytes]) -> str:
    """Markdown as one self-contained HTML page: figures, PNG by name, embedded; nothing is loaded from anywhere."""
    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    for name, png in figures.items():
        body = body.replace(f'src="{name}"', f'src="data:image/png;base64,{base64.b64encode(png).decode()}"')
    return PAGE.substitute(title=title, body=body)


def as_png(figure: Figure) -> bytes:
    """A figure as the content of a file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
