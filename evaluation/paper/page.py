"""The evaluation as one self-contained HTML page: figures embedded, nothing loaded from anywhere."""

from __future__ import annotations

import base64
import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version

from markdown_it import MarkdownIt

from evaluation.paper.analysis import Evaluation
from evaluation.paper.tables import Table
from physics.mechanics import PARAMETERS, Bounds, Mechanics

TITLE = "Evaluation of the estimated tissue parameters"
PACKAGES = ("palpate", "numpy", "scipy", "matplotlib", "torch", "lightning")
STYLE = """
:root { --ink: #1d2939; --soft: #667085; --line: #e4e7ec; }
body { margin: 0; background: #f7f9fc; color: var(--ink);
  font: 15px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
main { max-width: 1080px; margin: 0 auto; padding: 32px 24px 64px; }
h1 { font-size: 28px; margin: 0 0 4px; }
h2 { font-size: 20px; margin: 40px 0 12px; }
h3 { font-size: 15px; margin: 24px 0 8px; }
blockquote { border-left: 4px solid #1d4e89; background: #fff; margin: 20px 0; padding: 2px 18px; font-size: 17px; }
img { width: 100%; height: auto; background: #fff; border: 1px solid var(--line); border-radius: 8px; }
em, h1 + p, table + ul { color: var(--soft); font-size: 13.5px; font-style: normal; }
table { display: block; overflow-x: auto; border-collapse: collapse; background: #fff; font-size: 13.5px;
  font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 6px 12px; border-bottom: 1px solid var(--line); vertical-align: top; }
th { color: var(--soft); font-weight: 600; }
@media print { body { background: #fff; } img, table { break-inside: avoid; } }
"""


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that made the evaluation; a package that isn't installed is left out."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):  # run from a checkout, or without the training extra
            found[name] = version(name)
    return found


def bullets(sentences: Sequence[str]) -> str:
    """A Markdown list."""
    return "".join(f"- {sentence}\n" for sentence in sentences)


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
    text = _text(evaluation, tables, mechanics, bounds, made)
    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    for name, png in figures.items():
        body = body.replace(f'src="{name}"', f'src="data:image/png;base64,{base64.b64encode(png).decode()}"')
    return (
        "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>{TITLE}</title><style>{STYLE}</style></head>\n<body><main>\n{body}</main></body></html>\n"
    )


def _text(
    evaluation: Evaluation, tables: Mapping[str, Table], mechanics: Mechanics, bounds: Bounds, made: datetime
) -> str:
    counts = ((len(evaluation.frames), "test frame"), (evaluation.check.clips, "clip"),
              (evaluation.contacts, "observed motion"))  # fmt: skip
    frames, clips, motions = (f"{count} {name}{'' if count == 1 else 's'}" for count, name in counts)
    told = {name: f"\n{table.to_markdown()}" for name, table in tables.items()}
    box = "; ".join(f"{name} {getattr(bounds, name)[0]:g} … {getattr(bounds, name)[1]:g}" for name in PARAMETERS)
    return f"""# {TITLE}

palpate · {made:%Y-%m-%d %H:%M} UTC · {frames} from {clips}, {motions}

**Not a medical device.** For research only; no clinical decision may rest on these numbers.

> {evaluation.conclusion}

{bullets((*evaluation.sentences, *evaluation.missing))}
## Simulation error
{told["errors"]}{told["tests"]}{told["regularity"]}
## Dynamic response

![Heat map and fan chart of relative displacement over time](figure3.png)

*Figure 3. Displacement of the contact vertex simulated with the predicted θ, relative to the highest peak.
(a) Every test frame, sorted by peak. (b) Median and percentiles over the test frames. Dashed: release.*
{told["settling"]}
## Collapse check

![Stiffness, damping and force by test frame](theta.png)

*Estimates by test frame. Left: within the admissible range, where a collapsed estimator shows a flat line.
Right: zoomed to the estimates. Grey lines separate clips.*
{told["spread"]}{told["constant"]}
## Next depth map

{bullets(evaluation.next_depth.sentences)}{told["depth"]}
## How this was made

- Simulation: mass–spring–damper on the tissue mesh of the frame, {mechanics.steps} steps of {mechanics.time_step:g} s,
  mass {mechanics.mass:g} a vertex, {mechanics.damping} damping, {mechanics.boundary} rim, anchor {mechanics.anchor:g};
  the load ends when the observation's contact ends.
- Error: mean over the observed steps of the squared distance between simulated and observed displacement of the
  contact vertex (Bini 2026, equation 14) [scene units²].
- Admissible box of θ (F signed, negative presses into the tissue): {box}.
- Units: lengths are scene units, the depth divided by the clip's one fixed scale. k_s, k_d and F are normalised,
  not N/m, N·s/m and N; scene units differ between clips unless a metric scale is known.
- No force or stiffness was measured on real clips: the evaluation says how well the simulation follows the observed
  motion, not how true the parameters are.
- Made with {", ".join(f"{name} {number}" for name, number in versions().items())}.
"""
