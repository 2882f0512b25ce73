"""Per-frame tissue stiffness, damping and tool force from laparoscopic video, with a trained and exported network.

    python infer.py INPUT... --output DIR [--model parameters.onnx]

Exit status: 0 all clips done, 1 some failed (named; the others are complete), 2 wrong usage, 130 interrupted (finished
clips stay, and the same command continues).
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from data.clip import PrepareSettings, stream
from data.frames import open_source
from estimators.contact_network import ContactNetwork
from estimators.exported import open_exported
from estimators.model_settings import preparation_settings
from estimators.onset import ONSETS
from evaluation.batch import (
    DONE,
    ONSET_HELP,
    UP_TO_DATE,
    Batch,
    Outcome,
    add_input_options,
    add_version,
    chosen_depth,
    chosen_layout,
    run,
    short,
)
from evaluation.result_store import OVERLAY, RECORD, SUMMARY, TABLE, read_record
from evaluation.results import ClipResults
from evaluation.run_record import Provenance, build_record, describe, sha256_of, units_of

SHIPPED = Path(__file__).resolve().parent / "models" / "weights" / "contact.onnx"
"""The model that comes with the program; its card lies beside it."""


class Inference(Batch):
    """A network applied to every frame of each clip.

    Raises:
        ValueError: something asked for can't be used.
    """

    program, counted = "infer.py", "frames"

    def __init__(self, options: argparse.Namespace, console: Console) -> None:
        self.estimator = open_exported(options.model, options.threads or None, options.onset)
        self.model = self.estimator.model
        super().__init__(options, console)
        self.model_sha256 = sha256_of(self.model.path)
        self.files = (TABLE, SUMMARY, RECORD) + ((OVERLAY,) if options.overlay else ())

    def preparation(self) -> PrepareSettings:
        """As the model was trained, with what the user chooses otherwise."""
        layout, depth = chosen_layout(self.options), chosen_depth(self.options)
        return preparation_settings(self.model, layout=layout, masks=self.options.masks, depth=depth)

    def process(self, path: Path, progress: Progress, place: str) -> Outcome:
        """Estimate every frame of a clip and write its results."""
        source, output = open_source(path, self.settings.layout), self.options.output
        folder = self.store.folder(source.name, path)
        estimator = {"onset": self.estimator.onset} if isinstance(self.estimator, ContactNetwork) else {}
        provenance = Provenance(sha256_of(path, exclude=output.resolve()), self.model_sha256, self.settings, estimator)
        if not self.options.overwrite and self.store.is_complete(folder, provenance.fingerprint, self.files):
            self.say(f"{source.name}: up to date in {folder}; --overwrite computes it again")
            return Outcome(source.name, UP_TO_DATE, str(folder), read_record(folder).get("statuses", {}))
        task = progress.add_task(f"{place} {short(source.name)}", total=source.length or None)
        units = units_of(self.model)
        try:
            with ClipResults(folder, source.size, source.fps, units, overlay=self.options.overlay) as results:
                clip, started = stream(source, self.settings), time.perf_counter()
                for result in self.estimator.run(clip):
                    results.write(result)
                    progress.advance(task)
                seconds = {**clip.seconds, **self.estimator.seconds, **results.seconds}
                seconds["total"] = time.perf_counter() - started + clip.seconds["scale"]
                record = build_record(clip, provenance, self.model, results, seconds)
                results.finish(record, title=source.name, subtitle=describe(record))
        finally:
            progress.remove_task(task)
        for warning in record["warnings"]:
            self.say(f"{source.name}: {warning}")
        return Outcome(source.name, DONE, str(folder), record["statuses"])


def main(arguments: list[str] | None = None) -> int:
    """Run the program and return its exit status."""
    return run(Inference, _parser().parse_args(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description="Estimate tissue stiffness, damping and tool force for every frame of laparoscopic clips. "
        "Research software, not a medical device.",
        epilog="Exit status: 0 all clips done, 1 some failed, 2 wrong usage, 130 interrupted.",
    )
    add_input_options(parser.add_argument, "as the model was trained")
    parser.add_argument(
        "--model",
        type=Path,
        default=SHIPPED,
        help="file from train.py export (default: the one that comes along)",
    )
    parser.add_argument("--no-overlay", dest="overlay", action="store_false", help="leave the overlay video out")
    parser.add_argument("--onset", choices=ONSETS, help=ONSET_HELP)
    add_version(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
