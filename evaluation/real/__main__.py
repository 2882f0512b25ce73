"""What can be said on real clips, judged on what was kept back from the fit.

    python -m evaluation.real --data DIR --output OUT
    python -m evaluation.real --pulled CLIP [--layout YAML] [--estimator direct|online] [--settings YAML] --output OUT
    python -m evaluation.real --pressed FOLDER --wrench CSV --output OUT

--data runs every known clip under a folder (docs/real.md). A pulled clip shows tissue that an instrument holds and
moves: the table has what the session of `infer.py --estimator direct` says of it, its skill in frames that were not
fitted included; `contact_frame_N` is the probability that tissue moves with the instrument. With `--estimator online`
it is predicted ten frames ahead instead, by stiffness place by place and by a sheet of one number. A pressed one is a
folder with `depth/` and a table of the force. Writes table.csv (clip, measure, value), figures/ and report.html. Not a
medical device.
"""

from __future__ import annotations

from physics.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from data.command_line import path_option, progress_bars, say
from data.source.layout import InputError
from estimators.estimate import NoEstimate
from estimators.grip.lattice import NothingMoves
from estimators.online.settings import FILES, OnlineSettings, load_settings
from evaluation.page import as_png, render_page
from evaluation.real.figures import draw_prediction, draw_press
from evaluation.real.predicted import evaluate_prediction
from evaluation.real.pressed import evaluate_press
from evaluation.real.pulled import PulledClip, evaluate_pull
from evaluation.tables import to_csv, to_markdown
from physics.doors import INTERRUPTED, interruptible, plain
from physics.ownership import replacing_own, require_own
from physics.provenance import ROOT
from results.plots import draw_summary
from results.store import OutputError, writing

COLUMNS = ("clip", "measure", "value")
TEXTS = ("table.csv", "report.html")
TITLE = "Real clips, judged on what was kept back"
KNOWN = {
    "recover_tissue": PulledClip(Path("recover_tissue"), ROOT / "configs/layouts/recover_tissue.yaml"),
    "video01_00080": PulledClip(Path("cholecseg8k/video01/video01_00080")),
}
"""Pulled clips, below the data's folder."""
PRESSED = "pressed_membrane"

Measures = dict[str, object]
Task = Callable[[Measures], bytes]
"""Fills in what is measured, by name, as far as it comes, and gives a figure."""


def build_parser() -> argparse.ArgumentParser:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m evaluation.real",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="Exit status: 0 all clips judged; 1 some could not be; 2 wrong usage; 130 interrupted.",
    )
    add = parser.add_argument
    add("--data", type=path_option, metavar="DIR", help="folder of the known clips")
    add("--pulled", type=path_option, metavar="CLIP", help="a clip, as infer.py takes it")
    text = "of CLIP: YAML file that names a folder's files (default: CholecSeg8k)"
    add("--layout", type=path_option, metavar="YAML", help=text)
    text = "of pulled clips: direct (default), as infer.py runs it, or online, ahead from frames 3, 4 and 5"
    add("--estimator", choices=("direct", "online"), default="direct", help=text)
    text = "of online (default: as configs/online.yaml)"
    add("--settings", type=path_option, metavar="YAML", help=text)
    add("--pressed", type=path_option, metavar="FOLDER", help="a press with depth")
    add("--wrench", type=path_option, metavar="CSV", help="its force, one row a frame")
    add("--output", type=path_option, required=True, metavar="OUT", help="folder of the results")
    return parser


def tasks_of(options: argparse.Namespace) -> dict[str, Task]:
    """What to do, by the clip's name.

    Raises:
        InputError: settings that can't be used.
    """
    tasks: dict[str, Task] = {}
    online = OnlineSettings() if options.settings is None else load_settings(options.settings)
    for name in FILES:
        if getattr(online, name) is not None:
            raise InputError(f"{options.settings} names a file of {name}, which is for infer.py; leave it out here.")

    def add(name: str, task: Task) -> None:
        same = sum(other == name or other.startswith(f"{name} (") for other in tasks)
        tasks[f"{name} ({same + 1})" if same else name] = task

    def pull(name: str, clip: PulledClip) -> None:
        if options.estimator == "online":
            add(name, lambda measures: _predicted(clip, online, measures))
        else:
            add(name, lambda measures: _pulled(name, clip, measures))

    if options.data is not None:
        for name, clip in KNOWN.items():
            if (options.data / clip.path).exists():
                pull(name, PulledClip(options.data / clip.path, clip.layout_file))
        folder = options.data / PRESSED
        for wrench in sorted(folder.glob("wrench_*.csv")):
            add(f"{PRESSED}, {wrench.stem}", lambda measures, wrench=wrench: _pressed(folder, wrench, measures))
    if options.pulled is not None:
        pull(options.pulled.resolve().name, PulledClip(options.pulled, options.layout))
    if options.pressed is not None:
        add(options.pressed.resolve().name, lambda measures: _pressed(options.pressed, options.wrench, measures))
    return tasks


def _pulled(name: str, clip: PulledClip, measures: Measures) -> bytes:
    found = evaluate_pull(clip, measures)
    measures |= found.measures
    return as_png(draw_summary(found.frames, runs=[found.run], title=name))


def _predicted(clip: PulledClip, settings: OnlineSettings, measures: Measures) -> bytes:
    found = evaluate_prediction(clip, settings)
    measures |= found.measures
    return as_png(draw_prediction(found))


def _pressed(folder: Path, wrench: Path, measures: Measures) -> bytes:
    found = evaluate_press(folder, wrench)
    measures |= found.measures
    return as_png(draw_press(found))


def main(arguments: list[str] | None = None) -> int:
    """Judge what the command line names; returns the exit status."""
    parser, console = build_parser(), Console(stderr=True)
    options: Any = parser.parse_args(arguments)
    if options.layout is not None and options.pulled is None:
        parser.error(f"--layout {options.layout} is of a clip of --pulled; give both, or leave it out.")
    if (options.pressed is None) != (options.wrench is None):
        parser.error("--pressed and --wrench belong together; give both.")
    if options.settings is not None and options.estimator != "online":
        parser.error(f"--settings {options.settings} is for --estimator online; leave it out.")
    try:
        tasks = tasks_of(options)
    except InputError as error:
        say(console, str(error), "red")
        return 2
    if not tasks:
        where = "" if options.data is None else f"; {options.data} holds none of {', '.join([*KNOWN, PRESSED])}"
        parser.error(f"there is nothing to judge{where}. Give --data, --pulled or --pressed.")
    try:
        with writing(options.output):  # before the long work
            numbers = range(1, len(tasks) + 1)
            require_own(*(options.output / name for name in (*TEXTS, *(f"figures/{n}.png" for n in numbers))))
    except OutputError as error:
        say(console, str(error), "red")
        return 2
    rows: list[dict[str, object]] = []
    figures: dict[str, bytes] = {}
    status = 0
    try:
        with progress_bars(console) as progress:
            bar = progress.add_task("clips", total=len(tasks))
            for name, task in tasks.items():
                measures: Measures = {"status": ""}
                try:
                    with interruptible():
                        figure = task(measures)
                    figures[f"{len(figures) + 1}.png"] = figure
                except Exception as error:
                    measures["status"] = _sentence(error)
                    say(console, f"{name}: {_sentence(error)}", "red")
                    status = 1
                rows += [{"clip": name, "measure": measure, "value": value} for measure, value in measures.items()]
                progress.advance(bar)
    except KeyboardInterrupt:
        say(console, "Interrupted; what is finished is written.", "yellow")
        status = INTERRUPTED
    if not rows:
        return status
    try:
        write(options.output, rows, figures)
    except OutputError as error:
        say(console, str(error), "red")
        return 1
    table = Table(*COLUMNS)
    for row in rows:
        table.add_row(*(Text(plain(_shown(row[column]))) for column in COLUMNS))
    Console().print(table)
    say(console, f"written: {options.output}/table.csv, report.html, figures/")
    return status


def _sentence(error: Exception) -> str:
    """Why a clip could not be judged; the others still are."""
    if isinstance(error, (InputError, NoEstimate, NothingMoves)):
        return str(error)
    return f"unexpected {type(error).__name__} ({error}); please report it with the clip."


def _shown(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def write(output: Path, rows: list[dict[str, object]], figures: Mapping[str, bytes]) -> None:
    """Write table, figures and page.

    Raises:
        OutputError: they can't be written.
    """
    table = to_markdown(COLUMNS, ([_shown(row[column]) for column in COLUMNS] for row in rows))
    shown = "\n".join(f"![Figure {name}]({name})\n" for name in figures)
    told = "> **Not a medical device.** Lengths in pixels; forces in newtons only where some were measured.\n"
    page = render_page(TITLE, f"# {TITLE}\n\n{told}\n{shown}\n{table}\n", figures)
    texts = dict(zip(TEXTS, (to_csv(rows, COLUMNS, ".6g"), page), strict=True))
    with writing(output):
        (output / "figures").mkdir(parents=True, exist_ok=True)
        for name, content in (
            {f"figures/{n}": c for n, c in figures.items()} | {n: t.encode() for n, t in texts.items()}
        ).items():
            with replacing_own(output / name) as partial:
                partial.write_bytes(content)


if __name__ == "__main__":
    run_door(main)
