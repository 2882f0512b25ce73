"""What the pages show: a folder of results as plain dicts. Cells are taken as they stand, nothing is computed anew."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from palpate.common.files import read_file
from palpate.results import store
from palpate.results.verdicts import COLORS, MEANINGS, in_words, numbers

TEXTS: dict[str, Any] = yaml.safe_load(Path(__file__).with_name("texts.yaml").read_text(encoding="utf-8"))
MOST_BYTES = 2**28
"""Of a table; a day's frames have less."""
CURVES = ("stiffness", "stiffness_low", "stiffness_high")
"""Columns of both tables that are drawn over time."""
CONTACT_CURVES = ("time_s", "frame_s", "force", "force_low", "force_high")
"""What forces.json has of every frame in contact."""


def clip_folders(output: Path) -> list[Path]:
    """Folders of complete clips in a folder of results, by name."""
    return [path for path in sorted(output.iterdir()) if not path.name.startswith(".") and store.read_record(path)]


def summary_of(folder: Path) -> dict[str, Any]:
    """What the page of a batch shows of a clip: name, runs of contact and frames by what was found, warnings.

    Raises:
        KeyError, TypeError, ValueError: the record is damaged, or of another version.
    """
    record = store.read_record(folder)
    given, contacts, statuses = record["input"], record["contacts"], record["statuses"]
    return {
        "name": folder.name,
        "contacts": _counted(contacts),
        "statuses": _counted(statuses),
        "frames": int(given["frames"]),
        "seconds": given["frames"] / given["fps"],
        "touching": int(statuses.get("ok", 0)),
        "estimator": str(record["estimator"]["name"]),
        "warnings": [str(warning) for warning in record["warnings"]],
        "newtons": bool((record.get("calibration") or {}).get("scale")),
    }


def clip_of(folder: Path) -> dict[str, Any]:
    """What a clip's page shows.

    Raises:
        OSError: a table can't be read.
        KeyError, TypeError, ValueError: the results are damaged, or of another version.
    """
    record = store.read_record(folder)
    frames, runs = _table(folder / store.TABLE), _table(folder / store.INTERACTIONS)
    report = json.loads(read_file(folder / store.REPORT, MOST_BYTES))
    calibrated = _table(folder / store.CALIBRATED) if (folder / store.CALIBRATED).is_file() else []
    contacts = [_contact(run, forces) for run, forces in zip(runs, report["contacts"], strict=True)]
    encoder = record["overlay_encoder"] if (folder / store.OVERLAY).is_file() else "none"
    settings = {"estimator": record["estimator"], "depth": record["depth_model"]["identity"], "masks": record["masks"]}
    settings |= {"model": (record["model"] or {}).get("path"), "scale": record["scale"], "camera": record["camera"]}
    settings |= {"input": record["input"], "versions": record["versions"]} | record["settings"]
    return summary_of(folder) | {
        "video": None if encoder == "none" else store.OVERLAY,
        "video_note": TEXTS["video"][encoder],
        "found": contacts,
        "limit": report["force_limit"],
        "force_fields": report["fields"],
        "states": [_explained(*item) for item in record["statuses"].items()],
        "verdicts": [_explained(*item) for item in record["verdicts"].items()],
        "advice": [(warning, advice(warning)) for warning in record["warnings"]],
        "calibrated": calibrated,
        "columns": record["columns"],
        "settings": _flat(settings),
        "timings": record["timings_s"],
        "files": [(name, TEXTS["files"][name]) for name in store.WRITTEN if (folder / name).is_file()],
        "curves": _curves(record, frames, contacts),
    }


def advice(warning: str) -> str:
    """What to do about a warning of run.json."""
    return next((what for words, what in TEXTS["warnings"].items() if words in warning), TEXTS["other_warning"])


def _explained(name: str, count: int = 0) -> dict[str, Any]:
    """A verdict or a status in words, what it means, and what to do about it."""
    said = TEXTS["statuses"].get(name) or {"means": MEANINGS.get(name, ""), "do": TEXTS["verdicts"].get(name, "")}
    return {"name": name, "words": in_words(name), "count": count} | said


def _contact(run: Mapping[str, str], forces: Mapping[str, Any]) -> dict[str, Any]:
    """A run of contact: its rows of both tables, and its verdict in words, with no number surer than that."""
    verdict = run["verdict"] or "no_estimate"
    values = {name: number for name, cell in run.items() if (number := _number(cell)) is not None}
    shown = numbers(verdict, values) if verdict != "no_estimate" else []
    return {"row": run, "forces": forces, "numbers": shown} | _explained(verdict)


def _curves(
    record: Mapping[str, Any], frames: Sequence[Mapping[str, str]], contacts: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """What the page's script draws, by frame and by run of contact; what is not known is None."""
    found: dict[str, Any] = {"fps": record["input"]["fps"], "unit": record["units"]["stiffness"], "contacts": []}
    for name in ("frame", "time_s", *CURVES):
        found[name] = [_number(row[name]) for row in frames]
    found["sure"] = ["stiffness" in row["determined"].split(";") for row in frames]
    found["state"] = _coded([row["verdict"] or row["status"] for row in frames])
    found["detail"] = _coded([row["detail"] for row in frames])
    if record["force_limit"]:
        found["alarm"] = _coded([row["alarm"] for row in frames])
    for contact in contacts:
        row, forces = contact["row"], contact["forces"]
        values = {name: _number(row[name]) for name in ("onset_frame", "onset_time_s", *CURVES)}
        values |= {"name": contact["name"], "words": contact["words"], "unit": forces["unit"]}
        values["sure"] = "stiffness" in row["determined"].split(";")
        found["contacts"].append(values | {name: forces[name] for name in CONTACT_CURVES})
    return found


def _coded(texts: Sequence[str]) -> dict[str, Any]:
    """Texts that repeat, as their places in a list of them."""
    names = list(dict.fromkeys(texts))
    places = {name: place for place, name in enumerate(names)}
    return {"names": names, "words": [in_words(name) for name in names], "index": [places[text] for text in texts]}


def _counted(counts: Mapping[str, int]) -> list[tuple[str, str, int]]:
    """Name, words and count of verdicts or statuses, in the order of COLORS."""
    order = list(COLORS)
    known = sorted(counts, key=lambda name: order.index(name) if name in order else len(order))
    return [(name, in_words(name), int(counts[name])) for name in known]


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(read_file(path, MOST_BYTES).decode("utf-8", "replace").splitlines()))


def _flat(values: Mapping[str, Any], before: str = "") -> list[tuple[str, Any]]:
    """Settings with those within settings, by their joined names."""
    found = []
    for name, value in values.items():
        nested = isinstance(value, dict) and value
        found += _flat(value, f"{before}{name}.") if nested else [(f"{before}{name}", value)]
    return found
