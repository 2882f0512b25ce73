"""Record of hashes, versions and settings behind a clip's results; decides whether they are still up to date."""

import dataclasses
import functools
import hashlib
import math
import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import distributions
from os.path import isfile
from pathlib import Path
from typing import Any

from palpate.common.files import all_below, digest_of, file_sha256
from palpate.common.output import is_own
from palpate.common.provenance import __version__, code_digest
from palpate.data.clip import ClipStream
from palpate.data.settings import PREPROCESSING_VERSION, PrepareSettings
from palpate.data.source.frames import FrameSource
from palpate.data.source.images import MOST_BYTES
from palpate.data.source.layout import right_beside
from palpate.data.source.lerobot import file_of, span_of
from palpate.estimators.contract import Estimator
from palpate.estimators.records import FrameEstimate
from palpate.estimators.result import UNITS
from palpate.models.onnx_session import ExportedModel, PosteriorModel
from palpate.results.store import PAGES, PROGRAM, own_files
from palpate.results.writer import ClipResults

FORMAT_VERSION = 1
"""Version of the record's layout."""

UNCALIBRATED = "the model's uncertainty was never calibrated: the coverage of its 90 % intervals is lower than that"
PERSISTENT = ("unreadable", "no_mask", "bad_depth", "repeated")
"""Statuses that mean a broken input, not an empty scene."""


def depends_on(clip: Path, settings: PrepareSettings, estimator: Estimator) -> dict[str, Any]:
    """Return dependencies of a clip's results: hashes of files, settings, and the code.

    Those with the same digest, the record's `fingerprint`, need not be computed again.
    """
    model, prepared, beside = model_of(estimator), dataclasses.asdict(settings), right_beside(clip, settings.layout)
    for name in ("threads", "device"):  # where a model runs does not change what it means
        prepared["depth"].pop(name)
    return {
        "format": FORMAT_VERSION,
        "clip": sha256_of(file_of(clip)),
        "span": span_of(clip),
        "right": sha256_of(beside) if beside is not None and beside.exists() else None,
        "model": None if model is None else model.sha256,
        "settings": prepared,
        "estimator": dict(estimator.described),
        "files": _named_files(settings),
        "code": code_digest(),
        "program": __version__,
    }


def model_of(estimator: Estimator) -> ExportedModel | None:
    """Return the estimator's network, where it has one."""
    return getattr(estimator, "model", None)


def head_of(kind: str, causes: Mapping[str, Any]) -> dict[str, Any]:
    """Return entries of run.json for any results: what they are, and what they depend on."""
    return {
        "format_version": FORMAT_VERSION,
        "program": PROGRAM,
        "kind": kind,
        "notice": "Research software, not a medical device.",
        "fingerprint": digest_of(causes),
        "estimator": causes["estimator"],
        "versions": versions(),
    }


def build_record(
    clip: ClipStream,
    causes: Mapping[str, Any],
    model: ExportedModel | None,
    results: ClipResults,
    seconds: Mapping[str, float],
) -> dict[str, Any]:
    """Return the content of `run.json`.

    Args:
        clip: the clip, read to its end.
        causes: what its results depend on (see `depends_on`).
        model: the estimator's network, where it has one.
        results: what was written of it.
        seconds: time spent by stage [s].
    """
    source, frames = clip.source, results.estimates
    depth_identity, masks_identity = clip.identity
    undriven = "no tissue stretches with an instrument, so no stiffness is known; give a clip whose tool drives tissue"
    coded = f"by compression brightness lags by {results.lag:.1f} of 255 levels: k_d/k_s and F/k_s may be too large"
    return head_of("video", causes) | {
        "input": {
            "path": str(source.path.resolve()),
            "sha256": causes["clip"],
            "frames": len(frames),
            "width": source.size[0],
            "height": source.size[1],
            "fps": source.fps,
        },
        "depth_model": {"identity": depth_identity, "files_sha256": causes["files"]},
        "masks": {"source": clip.sources["masks"], "identity": masks_identity},
        "scale": {
            "depth_at_1": clip.scale if math.isfinite(clip.scale) else None,
            "unit": "m" if clip.metres and clip.metres[0] == 1 else "of the depth source",
            **results.length.record,
        },
        "camera": dataclasses.asdict(clip.picture_camera),
        "settings": dataclasses.asdict(clip.settings),
        "statuses": Counter(frame.status for frame in frames),
        "verdicts": Counter(frame.verdict for frame in frames if frame.verdict),
        "contacts": results.counts,
        "calibration": None if results.calibration is None else results.calibration.record(),
        "force_limit": None if results.alarm is None else results.alarm.record(),
        "model": model and {"path": str(model.path.resolve()), "sha256": causes["model"], "metadata": model.metadata},
        "providers": ({} if model is None else {"estimator": model.provider}) | clip.providers,
        "units": UNITS | {"length": results.length.record["says"]},
        "columns": {item.name: item.columns for item in results.artefacts if item.columns is not None},
        "warnings": [
            *clip.warnings,
            *([results.length.by] if results.length.metres is None and results.length.by else []),
            *warnings_of(source, frames, model, clip.sources),
            *([] if results.stretched or causes["estimator"]["name"] != "online" else [undriven]),
            *([coded] if results.lag else []),
            *(warning for artefact in results.artefacts for warning in artefact.warnings()),
            *([] if results.alarm is None else [results.alarm.sentence()]),
            *([results.calibration.reason] if results.calibration and results.calibration.reason else []),
        ],
        "timings_s": {stage: round(value, 4) for stage, value in seconds.items()},
    }


def warnings_of(
    source: FrameSource, frames: Sequence[FrameEstimate], model: ExportedModel | None, sources: Mapping[str, str]
) -> list[str]:
    """Return warnings about a clip, one sentence each: damage to it, doubtful masks or intervals.

    Args:
        source: the clip.
        frames: its results.
        model: what estimated them, where it is a network.
        sources: where its `depth` and `masks` came from.
    """
    metadata, found = {} if model is None else model.metadata, []
    for what, trained in (metadata.get("trained_on") or {}).items():
        if sources[what] not in trained:
            known = f"the model was trained on {what} from {' and '.join(trained)}"
            found.append(f"{known} and this clip's come from {sources[what]}: its errors here are unknown")
    found += source.warnings
    if sources["masks"] == "automatic":
        found.append("automatic masks take all lit tissue: contact is undecided until instrument or tissue has moved")
    for status in PERSISTENT:
        if hit := [frame for frame in frames if frame.status == status]:
            share, first = f"{len(hit)} of {len(frames)} frames are {status}", hit[0]
            found.append(f"{share}, the first is {first.frame}: {first.detail}")
    if isinstance(model, PosteriorModel) and not model.calibrated:
        found.append(UNCALIBRATED)
    # Contact posteriors of version 1 did not say.
    trained = PREPROCESSING_VERSION if model is None else metadata.get("preprocessing_version", 1)
    if trained != PREPROCESSING_VERSION:
        found.append(f"the model was trained on preprocessing version {trained}, this is {PREPROCESSING_VERSION}")
    return found


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, or of a folder's files with their names; hidden ones and our own results don't
    count.

    Of a folder's files that are too large to be pictures, size and time of change count instead of the content.

    Raises:
        OSError: a file can't be read.
    """
    if path.is_file():
        state = path.stat()
        return _file_sha256(path, state.st_size, state.st_mtime_ns)
    digest, written = hashlib.sha256(), dict[Path, set[str]]()
    for file in all_below(path):
        relative = file.relative_to(path)
        if file.parent not in written:
            written[file.parent] = {*own_files(file.parent)}
        own = file.name in written[file.parent] or (file.name in PAGES and is_own(file))
        if not own and file.is_file() and not any(part.startswith(".") for part in relative.parts):
            state = file.stat()
            content = f"{state.st_size} {state.st_mtime_ns}" if state.st_size > MOST_BYTES else sha256_of(file)
            digest.update(f"{relative.as_posix()}\0{content}\n".encode("utf-8", "surrogatepass"))
    return digest.hexdigest()


@functools.lru_cache(maxsize=64)
def _file_sha256(path: Path, size: int, changed: int) -> str:
    """Return the digest of a file's content; size and time of change only keep a changed file from being remembered."""
    return file_sha256(path)


def _named_files(settings: PrepareSettings) -> dict[str, str]:
    """Return hashes of the files outside the clip that the settings name, and of the YAML files next to their
    models."""
    depth = settings.depth
    named = {"depth.source": depth.source, "depth.model": depth.model, "depth.preset": depth.preset}
    named |= {"masks": settings.masks, "camera": settings.layout.camera}
    paths = {name: Path(value) for name, value in named.items() if value is not None}
    paths |= {f"{name}, yaml": path.with_suffix(".yaml") for name, path in paths.items() if path.suffix == ".onnx"}
    return {name: sha256_of(path) for name, path in paths.items() if isfile(path)}


@functools.cache
def versions() -> dict[str, str]:
    """Return versions of this program and of the packages that the numbers depend on."""
    packages = ("palpate", "numpy", "scipy", "opencv-python-headless", "onnxruntime", "av")
    found = {name: item.version for name in packages for item in distributions(name=name)}
    return found | {"python": platform.python_version(), "preprocessing": str(PREPROCESSING_VERSION)}
