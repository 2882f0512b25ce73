"""What the pages show: a folder of results as plain dicts. Cells are taken as they stand, nothing is computed anew."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from palpate.results import store
from palpate.results.verdicts import NOTES, in_words, numbers

CURVES = ("stiffness", "stiffness_low", "stiffness_high")
"""Columns of both tables that are drawn over time."""


def clip_folders(output: Path) -> list[Path]:
    """Folders of complete clips in a folder of results, by name."""
    return [path for path in sorted(output.iterdir()) if not path.name.startswith(".") and store.read_record(path)]


def summary_of(folder: Path) -> dict[str, Any]:
    """What the page of a batch shows of a clip: name, runs of contact and frames by what was found, warnings.

    Raises:
        KeyError, TypeError, ValueError: the record is damaged, or of another version.
    """
    record = store.read_record(folder)
    given, contacts = record["input"], record["contacts"]
    order = [*NOTES, *contacts]
    return {
        "name": folder.name,
        "page": store.TABLE if record.get("kind") == "sequence" else store.PAGES[1],
        "contacts": [(name, in_words(name), int(contacts[name])) for name in sorted(contacts, key=order.index)],
        "frames": int(given["frames"]),
        "seconds": given["frames"] / given["fps"],
        "touching": int(record["statuses"].get("ok", 0)),
        "estimator": str(record["estimator"]["name"]),
        "warnings": [str(warning) for warning in record["warnings"]],
    }


def clip_of(folder: Path) -> dict[str, Any]:
    """What a clip's page shows.

    Raises:
        OSError: a table can't be read.
        KeyError, TypeError, ValueError: the results are damaged, or of another version.
    """
    record = store.read_record(folder)
    # A series of .vtu files is listed by its index.
    files = [name for name in store.own_files(folder) if (folder / name).is_file() and not name.endswith(".vtu")]
    shown = summary_of(folder) | _of_video(folder, record) | {"files": files}
    return shown | {"verdicts": [_explained(*item) for item in record["verdicts"].items()]}


def _of_video(folder: Path, record: Mapping[str, Any]) -> dict[str, Any]:
    """Curves, contacts and forces of a video."""
    columns = "frame", "time_s", *CURVES, "status", "verdict", "determined", "detail", "alarm"
    frames, contacts = _table(folder / store.TABLE, columns), contacts_of(folder)
    return {
        "video": store.OVERLAY if (folder / store.OVERLAY).is_file() else None,
        "found": contacts,
        "length": record["units"].get("length", ""),
        "states": [_explained(*item) for item in record["statuses"].items()],
        "curves": _curves(record, frames, contacts),
    }


def contacts_of(folder: Path) -> list[dict[str, Any]]:
    """What is shown of a video's contacts."""
    report = json.loads((folder / store.REPORT).read_text(encoding="utf-8"))["contacts"]
    runs, newtons = _table(folder / store.INTERACTIONS), folder / store.CALIBRATED
    physical = _table(newtons) if newtons.is_file() else [{}] * len(runs)
    return [_contact(*one) for one in zip(runs, report, physical, strict=True)]


def _explained(name: str, count: int = 0) -> dict[str, Any]:
    """A verdict or a status in words, what it means, and what to do about it."""
    note = NOTES.get(name, NOTES["doubtful"])
    return {"name": name, "words": in_words(name), "count": count, "means": note.text, "do": note.remedy}


def _contact(run: Mapping[str, str], forces: Mapping[str, Any], newtons: Mapping[str, str]) -> dict[str, Any]:
    """A run of contact: its rows of both tables, and its verdict in words, with no number surer than that."""
    verdict, values = run["verdict"], {name: number(cell) for name, cell in run.items()}
    doubtful = verdict == "determined" and run["detail"]
    shown = numbers("doubtful" if doubtful else verdict, values) if verdict else []
    return {"row": run, "known": values, "forces": forces, "newtons": newtons, "numbers": shown} | _explained(
        verdict or "no_estimate"
    )


def _curves(record: Mapping[str, Any], frames: list[dict[str, str]], contacts: list[dict[str, Any]]) -> dict[str, Any]:
    """What the page's script draws, by frame and by run of contact; what is not known is None."""
    found: dict[str, Any] = {"fps": record["input"]["fps"], "unit": record["units"]["stiffness"], "contacts": []}
    for name in ("frame", "time_s", *CURVES):
        found[name] = [number(row[name]) for row in frames]
    found["sure"] = [_is_sure(row) for row in frames]
    found["state"] = _coded([row["verdict"] or row["status"] for row in frames])
    found["detail"] = _coded([row["detail"] for row in frames])
    if record["force_limit"]:
        found["alarm"] = _coded([row["alarm"] for row in frames])
    for contact in contacts:
        values = {name: number(contact["row"][name]) for name in CURVES}
        values |= {"name": contact["name"], "sure": _is_sure(contact["row"])}
        names = "unit", "time_s", "frame_s", "force", "force_low", "force_high"
        found["contacts"].append(values | {name: contact["forces"][name] for name in names})
    return found


def _is_sure(row: Mapping[str, str]) -> bool:
    """Whether a row's stiffness is determined."""
    return "stiffness" in row["determined"].split(";")


def _coded(texts: Sequence[str]) -> dict[str, Any]:
    """Texts that repeat, as their places in a list of them."""
    places = {name: place for place, name in enumerate(dict.fromkeys(texts))}
    return {"names": list(places), "words": list(map(in_words, places)), "index": [places[text] for text in texts]}


def number(cell: str) -> float | None:
    """A cell of a table; None where it is no number."""
    try:
        return float(cell)
    except ValueError:
        return None


def _table(path: Path, columns: Sequence[str] = ()) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", errors="replace", newline="") as stream:
        return [{name: row.get(name, "") for name in columns or row} for row in csv.DictReader(stream)]
