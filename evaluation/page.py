"""Markdown and figures as one HTML page."""

import base64
import io
from collections.abc import Mapping

from markdown_it import MarkdownIt
from matplotlib.figure import Figure

STYLE = """
body { max-width: 1080px; margin: 0 auto; padding: 24px; color: #1d2939; font: 15px/1.5 "DejaVu Sans", sans-serif; }
blockquote { border-left: 4px solid #1d4e89; margin: 20px 0; padding: 2px 18px; font-size: 17px; }
img { width: 100%; border: 1px solid #e4e7ec; }
table { display: block; overflow-x: auto; border-collapse: collapse; font-size: 13.5px; }
th, td { text-align: left; padding: 6px 12px; border-bottom: 1px solid #e4e7ec; vertical-align: top; }
em, table + ul { color: #667085; font-size: 13.5px; font-style: normal; }
"""


def render_page(title: str, text: str, figures: Mapping[str, bytes]) -> str:
    """Markdown as one self-contained HTML page: figures, PNG by name, embedded; nothing is loaded from anywhere."""
    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    for name, png in figures.items():
        body = body.replace(f'src="{name}"', f'src="data:image/png;base64,{base64.b64encode(png).decode()}"')
    return (
        "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>{title}</title><style>{STYLE}</style></head>\n<body>\n{body}</body></html>\n"
    )


def as_png(figure: Figure) -> bytes:
    """A figure as the content of a file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
