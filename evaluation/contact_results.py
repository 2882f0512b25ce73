"""What a whole run of contact gave: rows of `contacts.csv`, and the clip's folder written in one go."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data.collected import CollectedClip
from data.samples import ContactCase, release_after
from estimators.direct import DOUBTFUL_MISFIT
from estimators.estimate import UNCERTAINTY, ContactEstimate, uncertainty
from estimators.oblique import remark
from evaluation.contact_picture import draw_fits
from evaluation.result_store import RECORD, partial_folder, publish, remove_leftovers, write_record, writing
from evaluation.results import cell
from evaluation.summary import write_summary
from physics.mechanics import PARAMETERS, Mechanics

CONTACTS, FIT = "contacts.csv", "fit.png"
FILES = (CONTACTS, FIT, RECORD)
"""Files of a clip's folder."""
COLUMNS: dict[str, str] = {
    "onset_frame": "number of the run's first frame in contact",
    "onset_time_s": "s",
    "frames": "frames after the onset in which its tissue was followed",
    "load_s": "s from the onset to the release; empty: the onset or the release was not seen",
    "delay_s": "s from the onset frame to the beginning of the press, as fitted; empty: taken to be 0, or no estimate",
    "release_delay_s": "s from the first frame after contact to the end of the press; empty: the same, or not seen",
    "stiffness": "k_s",
    "stiffness_sd": "standard deviation of stiffness",
    "damping": "k_d",
    "damping_sd": "standard deviation of damping",
    "force": "magnitude |F|",
    "force_sd": "standard deviation of force",
    **UNCERTAINTY,
    "verdict": "determined, ratios (only k_s/k_d and F/k_d are) or undetermined",
    "explanation": "which products of k_s, k_d and F are determined, with their relative errors",
    "noise": "standard deviation of every observed coordinate, scene units",
    "misfit": "root mean square of observed minus simulated displacement along the force over the noise; 1: it fits",
    "at_bound": "parameters that lie at the end of their admissible range",
    "status": "ok or no_estimate",
    "detail": "sentence about the status, or about a fit that can't be trusted",
}
"""Columns of the table, in order, each with what it is."""


@dataclass(frozen=True)
class ContactRun:
    """Frames of one run of contact; indices into the clip."""

    first: int
    """The run's first frame in contact."""
    last: int
    """Its last one; contact may flicker in between."""
    onset_seen: bool
    """Whether frames without contact came just before."""


@dataclass(frozen=True)
class ContactResult:
    """One run of contact with its estimate, or with the reason why there is none."""

    onset_frame: int
    """Number of the run's first frame in contact."""
    onset_time_s: float
    """Its time stamp [s]."""
    load_s: float | None
    """Time from the onset to the release [s]; None where either was not seen."""
    case: ContactCase | None
    """What was observed; None where the tissue was not followed from an onset."""
    estimate: ContactEstimate | None
    """The fitted parameters."""
    detail: str = ""
    """Why there is no estimate, or why it can't be trusted."""


def contact_runs(clip: CollectedClip, bridge_frames: int) -> list[ContactRun]:
    """Runs of contact of a clip in order, whether or not their onset was seen.

    Args:
        clip: a prepared clip.
        bridge_frames: contact that is missing on up to this many frames is still the same run.
    """
    runs: list[list[int]] = []
    for index in np.flatnonzero(clip.contact).tolist():
        begins = clip.track_start[index] == index
        same = runs and clip.track_start[runs[-1][0]] == clip.track_start[index]
        if same and not begins and index - runs[-1][-1] - 1 <= bridge_frames:
            runs[-1].append(index)
        else:
            runs.append([index])
    return [ContactRun(run[0], run[-1], bool(clip.track_start[run[0]] == run[0])) for run in runs]


def load_seconds(clip: CollectedClip, run: ContactRun) -> float | None:
    """Time from a run's onset to the first frame seen out of contact [s]; None where either was not seen.

    Where a frame without depth or mask comes first, the release was not seen.
    """
    release = release_after(clip, run.last)
    return None if release is None or not run.onset_seen else float(clip.times[release] - clip.times[run.first])


def doubts(estimate: ContactEstimate, ranges: Sequence[tuple[float, float]]) -> str:
    """Sentences on why an estimate can't be trusted; empty where nothing speaks against it.

    Args:
        ranges: admissible k_s, k_d and |F|.
    """
    oblique = remark(estimate)
    told = [oblique] if oblique else []
    if estimate.misfit > DOUBTFUL_MISFIT:
        told.append(
            f"The model does not explain the data: they lie {estimate.misfit:.2g} times the noise from it"
            # An oblique one was widened by its misfit.
            + ("." if oblique else ", so the uncertainties are too small.")
        )
    if estimate.delays_at_end:
        told.append(
            "The press seems to have begun or ended a whole frame from where it was seen to; don't trust the fit."
        )
    for name, stuck, (low, high) in zip(PARAMETERS, estimate.at_bound, ranges, strict=True):
        if stuck:
            told.append(f"The best fit lies at the end of the {name}'s admissible range, {low:g} to {high:g}.")
    return " ".join(told)


def table_row(result: ContactResult) -> list[str]:
    """The cells of one run of contact, in the order of COLUMNS."""
    values: dict[str, Any] = {
        "onset_frame": result.onset_frame,
        "frames": 0 if result.case is None else len(result.case.steps),
        "load_s": result.load_s,
        "status": "no_estimate",
        "detail": result.detail,
    }
    if result.estimate is not None:
        values |= _numbers(result.estimate) | {"status": "ok"}
    row = {name: cell(values.get(name)) for name in COLUMNS}
    row["onset_time_s"] = cell(result.onset_time_s, decimals=6)
    return list(row.values())


def _numbers(estimate: ContactEstimate) -> dict[str, Any]:
    return {
        **dict(zip(PARAMETERS, np.abs(estimate.theta).tolist(), strict=True)),
        **uncertainty(estimate),
        **dict(zip(("delay_s", "release_delay_s"), estimate.delays, strict=False)),
        "verdict": estimate.verdict,
        "explanation": estimate.explanation,
        "noise": estimate.noise,
        "misfit": estimate.misfit,
        "at_bound": " ".join(name for name, stuck in zip(PARAMETERS, estimate.at_bound, strict=True) if stuck),
    }


def write_contacts(
    folder: Path, results: Sequence[ContactResult], mechanics: Mechanics, record: Mapping[str, Any], title: str
) -> None:
    """Write table, picture and record of a clip; the folder is complete or not there at all.

    Args:
        folder: final folder of the clip; earlier results in it are replaced.
        results: its runs of contact, in order.
        mechanics: of the fits.
        record: content of `run.json`.
        title: name of the clip.

    Raises:
        OutputError: the output folder is full or can't be written.
    """
    partial = partial_folder(folder)
    with writing(folder.parent):
        remove_leftovers(folder)
        try:
            partial.mkdir()
            with (partial / CONTACTS).open("w", encoding="utf-8", newline="") as table:
                rows = csv.writer(table)
                rows.writerow(COLUMNS)
                rows.writerows(table_row(result) for result in results)
            write_summary(partial / FIT, draw_fits(results, mechanics, title))
            write_record(partial, record)
            publish(partial, folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def count_contacts(results: Sequence[ContactResult]) -> dict[str, int]:
    """Number of runs of contact by verdict, those without an estimate last."""
    found = [result.estimate.verdict for result in results if result.estimate is not None]
    counts = {verdict: found.count(verdict) for verdict in ("determined", "ratios", "undetermined")}
    counts["no_estimate"] = len(results) - len(found)
    return {name: count for name, count in counts.items() if count}
