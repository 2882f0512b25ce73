"""Content of the pages: a folder of results as plain dicts, with the numbers of its files."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from palpate.estimators.result import ENDS
from palpate.results import store
from palpate.results.artefacts.forces import RELATIVE
from palpate.results.verdicts import NOTES, OWN_UNITS, in_words, numbers, rounded

FIXES = {
    "was trained on": "Give depth and masks from the sources that the model was trained on, or another --model.",
    "masks": "Look at the overlay. Where an instrument's outline is wrong, draw it by palpate outline CLIP, and give "
    "that file as --masks.",
    "compression": "Give the video as the camera recorded it, or less compressed.",
    "never calibrated": "Take the shipped model, or calibrate yours (docs/training.md).",
    "no stiffness is known": "Give a clip in which an instrument pulls or pushes tissue in view.",
    "not exported": "Contacts are exported where stiffness, damping and force are all determined.",
    "reached the limit": "The limit is that of --force-limit.",
}
"""Remedies for a warning that has these words."""


def clip_folders(output: Path) -> list[Path]:
    """Return folders of complete clips in a folder of results, by name."""
    return [path for path in sorted(output.iterdir()) if not path.name.startswith(".") and store.read_record(path)]


def summary_of(folder: Path) -> dict[str, Any]:
    """Return facts about a clip on the page of a batch: name, runs of contact and frames by what was found, warnings.

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
    """Return the content of a clip's page.

    Raises:
        OSError: a file can't be read.
        KeyError, TypeError, ValueError: the results are damaged, or of another version.
    """
    record, frames, contacts = store.read_record(folder), _json(folder / store.RESULTS)["frames"], contacts_of(folder)
    # A series of .vtu files is listed by its index.
    files = [name for name in store.own_files(folder) if (folder / name).is_file() and not name.endswith(".vtu")]
    states = Counter(frame["verdict"] or frame["status"] for frame in frames)
    shown, order = summary_of(folder), [*NOTES, *record["contacts"]]
    names = dict.fromkeys([*(contact["name"] for contact in contacts), *states])
    warnings = [(text, _fix(text, states)) for text in shown["warnings"]]
    first = min(contacts, key=lambda contact: order.index(contact["name"]), default=None)
    return shown | {
        "files": files,
        "video": store.OVERLAY if (folder / store.OVERLAY).is_file() else None,
        "first": first,
        "contacts": contacts,
        "length": record["units"].get("length", ""),
        "states": [_explained(name, states[name]) for name in names],
        "warnings": warnings,
        "fixes": {fix: FIXES[fix] for _, fix in warnings if fix in FIXES},
        "questions": {"k_s": "How stiff?", "k_d": "How damped?", "|F|": "How hard?", "mean F": "How hard?"}
        | {"k_d/k_s": "Damping over stiffness", "|F|/k_s": "Force over stiffness"},
        "own_units": OWN_UNITS,
        "curves": _curves(record, frames, contacts, first),
    }


def _fix(warning: str, states: Iterable[str]) -> str:
    """Return the anchor of the remedy for a warning, a status or a key of FIXES; empty where there is none."""
    found = [name for name in states if f"are {name}" in warning] + [words for words in FIXES if words in warning]
    return found[0] if found else ""


def contacts_of(folder: Path) -> list[dict[str, Any]]:
    """Return facts about a video's contacts."""
    report, runs = _json(folder / store.REPORT)["contacts"], _json(folder / store.RESULTS)["contacts"]
    found = []
    for run, forces in zip(runs, report, strict=True):
        # A press over its own peak is as its model assumes: it has no interval, and nothing to show.
        flat = forces["unit"] == RELATIVE and not any(low is not None for low in forces["force_low"])
        shown = {"row": run, "forces": forces, "flat": flat, "numbers": contact_numbers(run, forces)}
        found.append(shown | _explained(run["verdict"] or "no_estimate"))
    return found


def _explained(name: str, count: int = 0) -> dict[str, Any]:
    """Return a verdict or a status in words, what it means, and what to do about it."""
    note = NOTES.get(name, NOTES["doubtful"])
    return {"name": name, "words": in_words(name), "count": count, "means": note.text, "do": note.remedy}


def contact_numbers(run: Mapping[str, Any], force: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return the symbol, text and unit of what is known of a contact, in physical units where it is determined in
    those.

    Args:
        run: the contact as results.json has it.
        force: the contact as forces.json has it.
    """
    newtons, verdict = run["newtons"] or {}, run["verdict"] or ""
    if verdict == "relative_force" and force["mean"] is not None:
        unit = "of peak" if force["unit"] == RELATIVE else force["unit"].partition(",")[0]
        return [("mean F", rounded(force["mean"], abs(force["mean_high"] - force["mean_low"]) / 2), unit)]
    if names := newtons.get("determined"):
        return numbers("determined", {f"{x}{end}": newtons[f"{x}{end}"] for x in names for end in (*ENDS, "_unit")})
    return numbers("doubtful" if verdict == "determined" and run["detail"] else verdict, run)


def _curves(
    record: Mapping[str, Any], frames: list[dict[str, Any]], contacts: list[dict[str, Any]], first: Any
) -> dict[str, Any]:
    """Return values that the page's script draws, by frame and by contact; what is not known is None."""
    found: dict[str, Any] = {"fps": record["input"]["fps"], "contacts": []}
    drawn = ("stiffness", "stiffness_low", "stiffness_high")
    for name in ("frame", "time_s", *drawn):
        found[name] = [frame[name] for frame in frames]
    # The page opens at the last frame of the contact that is known best.
    *_, end = [-1.0] if first is None else [-1.0, *first["forces"]["time_s"]]
    found["open"] = max(sum(frame["time_s"] <= end + 1e-6 for frame in frames) - 1, 0)
    found["sure"] = ["stiffness" in frame["determined"] for frame in frames]
    found["state"] = _coded([frame["verdict"] or frame["status"] for frame in frames])
    found["detail"] = _coded([frame["detail"] or "" for frame in frames])
    if record["force_limit"]:
        found["alarm"] = _coded([frame["alarm"] or "" for frame in frames])
    for contact in contacts:
        row, forces = contact["row"], contact["forces"]
        # A pull determines no stiffness: its press, if one was fitted, would only hide the rest.
        values = {name: None if contact["name"] == "relative_force" else row[name] for name in drawn}
        values |= {"sure": "stiffness" in row["determined"], "words": contact["words"], "flat": contact["flat"]}
        values |= {x: forces[x] for x in ("unit", "time_s", "frame_s", "force", "force_low", "force_high")}
        found["contacts"].append(values)
    return found


def _coded(texts: Sequence[str]) -> dict[str, Any]:
    """Return texts that repeat, as their places in a list of them."""
    places = {name: place for place, name in enumerate(dict.fromkeys(texts))}
    return {"names": list(places), "words": list(map(in_words, places)), "index": [places[text] for text in texts]}


def _json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))
