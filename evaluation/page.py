"""The evaluation as one self-contained HTML page: figures embedded, nothing loaded from anywhere."""

from __future__ import annotations

import base64
import html
import platform
from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version

from evaluation.analysis import Evaluation
from evaluation.tables import Table
from physics.mechanics import PARAMETERS, Bounds, Mechanics

PACKAGES = ("palpate", "numpy", "scipy", "matplotlib", "torch", "lightning")

STYLE = """
:root { --ink: #1d2939; --soft: #667085; --line: #e4e7ec; --accent: #1d4e89; --ground: #f7f9fc; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink);
  font: 15px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
main { max-width: 1080px; margin: 0 auto; padding: 32px 24px 64px; }
h1 { font-size: 28px; margin: 0 0 4px; }
h2 { font-size: 20px; margin: 40px 0 12px; }
.meta { color: var(--soft); margin: 0 0 20px; }
.warning { border-left: 4px solid #b4432b; background: #fdf3f0; padding: 10px 16px; border-radius: 0 6px 6px 0; }
.verdict { border-left: 4px solid var(--accent); background: #fff; padding: 14px 18px; border-radius: 0 6px 6px 0;
  font-size: 17px; box-shadow: 0 1px 2px rgba(16, 24, 40, .08); }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(190px, 1fr)); gap: 12px; margin: 20px 0; }
.card { background: #fff; border: 1px solid var(--line); border-radius: 8px; padding: 12px 16px; }
.card b { display: block; font-size: 21px; font-variant-numeric: tabular-nums; }
.card span { color: var(--soft); font-size: 13px; }
figure { background: #fff; border: 1px solid var(--line); border-radius: 8px; margin: 0 0 18px; padding: 14px 16px; }
figure img { width: 100%; height: auto; display: block; }
figcaption { font-weight: 600; margin-bottom: 8px; }
figcaption.below { font-weight: 400; color: var(--soft); font-size: 13.5px; margin: 10px 0 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 13.5px; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 6px 12px 6px 0; border-bottom: 1px solid var(--line); vertical-align: top; }
thead th { color: var(--soft); font-weight: 600; border-bottom: 2px solid var(--line); }
tbody th { font-weight: 500; }
ul.notes { color: var(--soft); font-size: 13px; margin: 10px 0 0; padding-left: 18px; }
@media print { body { background: #fff; } figure { break-inside: avoid; } }
"""


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that made the evaluation; a package that isn't installed is left out."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue  # run from a checkout, or without the training extra
    return found


def _list(sentences: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{html.escape(sentence)}</li>" for sentence in sentences) + "</ul>"


def _image(png: bytes, caption: str, description: str) -> str:
    data = base64.b64encode(png).decode()
    return (
        f"<figure><img alt='{html.escape(description)}' src='data:image/png;base64,{data}'>"
        f"<figcaption class='below'>{html.escape(caption)}</figcaption></figure>"
    )


def _change(percent: float) -> str:
    """A relative change as a card shows it; from a doubling on as a factor."""
    return f"× {1 + percent / 100:,.3g}" if percent >= 100 else f"{percent:+.1f} %".replace("-", "−")


def _cards(evaluation: Evaluation) -> str:
    def card(value: str, label: str) -> str:
        return f"<div class='card'><b>{html.escape(value)}</b><span>{html.escape(label)}</span></div>"

    cards = [
        card(
            str(len(evaluation.frames)),
            f"test frames from {evaluation.check.clips} clip{'' if evaluation.check.clips == 1 else 's'}, "
            f"{evaluation.contacts} observed motion{'' if evaluation.contacts == 1 else 's'}",
        )
    ]
    for name, comparison in evaluation.comparisons.items():
        change = comparison.relative_change_percent
        value = "–" if change is None else _change(change)
        cards.append(card(value, f"error of the predicted θ against {name}"))
    return f"<div class='cards'>{''.join(cards)}</div>"


def _how(mechanics: Mechanics, bounds: Bounds) -> list[str]:
    box = "; ".join(f"{name} {getattr(bounds, name)[0]:g} … {getattr(bounds, name)[1]:g}" for name in PARAMETERS)
    return [
        f"Simulation: mass–spring–damper on the tissue mesh of the frame, {mechanics.steps} steps of "
        f"{mechanics.time_step:g} s, mass {mechanics.mass:g} a vertex, {mechanics.damping} damping, "
        f"{mechanics.boundary} rim, anchor {mechanics.anchor:g}; the load ends when the observation's contact ends.",
        "Error: weighted mean over the observed steps of the squared distance between simulated and observed "
        "displacement of the contact vertex (Bini 2026, equation 14) [scene units²].",
        f"Admissible box of θ (F signed, negative presses into the tissue): {box}.",
        "Units: lengths are scene units, the depth divided by the clip's one fixed scale. k_s, k_d and F are "
        "normalised, not N/m, N·s/m and N; scene units differ between clips unless a metric scale is known.",
        "No force or stiffness was measured on real clips: the evaluation says how well the simulation follows the "
        "observed motion, not how true the parameters are.",
    ]


def render_page(
    evaluation: Evaluation,
    tables: Mapping[str, Table],
    figures: Mapping[str, bytes],
    mechanics: Mechanics,
    bounds: Bounds,
    made: datetime,
) -> str:
    """The page as HTML text.

    Args:
        tables: errors, tests, regularity, settling, spread, constant, depth.
        figures: figure3.png and theta.png, encoded.
        made: when, in UTC.
    """
    stamp = f"{made:%Y-%m-%d %H:%M} UTC"
    software = ", ".join(f"{name} {number}" for name, number in versions().items())
    figure3 = _image(
        figures["figure3.png"],
        "Figure 3. Displacement of the contact vertex simulated with the predicted θ, relative to the highest peak. "
        "(a) Every test frame, sorted by peak. (b) Median and percentiles over the test frames. Dashed: release.",
        "Heat map and fan chart of relative displacement over time",
    )
    theta = _image(
        figures["theta.png"],
        "Estimates by test frame. Left: within the admissible range, where a collapsed estimator shows a flat line. "
        "Right: zoomed to the estimates. Grey lines separate clips.",
        "Stiffness, damping and force by test frame",
    )
    body = [
        "<h1>Evaluation of the estimated tissue parameters</h1>",
        f"<p class='meta'>palpate · {stamp}</p>",
        "<p class='warning'><strong>Not a medical device.</strong> For research only; no clinical decision may rest on "
        "these numbers.</p>",
        f"<p class='verdict'>{html.escape(evaluation.conclusion)}</p>",
        _cards(evaluation),
        _list((*evaluation.sentences, *evaluation.missing)),
        "<h2>Simulation error</h2>",
        *(tables[name].to_html() for name in ("errors", "tests", "regularity")),
        "<h2>Dynamic response</h2>",
        figure3,
        tables["settling"].to_html(),
        "<h2>Collapse check</h2>",
        theta,
        *(tables[name].to_html() for name in ("spread", "constant")),
        "<h2>Next depth map</h2>",
        _list(evaluation.next_depth.sentences),
        tables["depth"].to_html(),
        "<h2>How this was made</h2>",
        _list(_how(mechanics, bounds)),
        f"<p class='meta'>{html.escape(software)}</p>",
    ]
    return (
        "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>Evaluation of the estimated tissue parameters</title><style>{STYLE}</style></head>\n"
        f"<body><main>{chr(10).join(body)}</main></body></html>\n"
    )
