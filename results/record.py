"""What a clip's results were made of: hashes, versions, settings. Also decides whether they are still up to date."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import platform
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from os.path import isfile
from pathlib import Path
from typing import Any

from data.clip import ClipStream
from data.settings import PREPROCESSING_VERSION, PrepareSettings
from data.source.frames import FrameSource
from estimators.estimate import FrameEstimate
from models.onnx_session import ExportedModel, PosteriorModel
from physics.provenance import ROOT, code_digest
from results import columns
from results.store import INTERACTIONS, TABLE, WRITTEN, file_sha256, own_files
from results.writer import ClipResults

FORMAT_VERSION = 1
"""Version of the record's layout."""
PROGRAM = "infer.py"
"""What writes results."""
PACKAGES = ("numpy", "scipy", "opencv-python-headless", "onnxruntime", "av")
UNITS = {
    "stiffness": "scene units (normalised), not N/m",
    "damping": "scene units (normalised), not N·s/m",
    "force": "scene units (normalised), not N",
    "displacement": "scene units: depth divided by the clip's one fixed scale",
    "time": "s",
}
"""Units of the table where the model's metadata gives none."""
UNCALIBRATED = (
    "the model's uncertainty was never calibrated: its standard deviations are the network's own, and its 90 % "
    "intervals hold the truth less often than that"
)
PERSISTENT = ("unreadable", "no_mask", "bad_depth")
"""Statuses that mean a broken input, not an empty scene."""


@dataclass(frozen=True)
class Provenance:
    """What a clip's results depend on."""

    clip_sha256: str
    """Hash of the clip's file, or of its folder's files."""
    model_sha256: str
    """Hash of the parameter network's file; empty where none is used."""
    settings: PrepareSettings
    """How frames are prepared."""
    estimator: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Settings of the estimator that are not in a network's file."""

    @property
    def fingerprint(self) -> str:
        """Digest of everything; results with the same one need not be computed again."""
        document = {
            "format": FORMAT_VERSION,
            "clip": self.clip_sha256,
            "model": self.model_sha256,
            "settings": self._settings(),
            "estimator": self.estimator,
            "files": _named_files(self.settings),
            "code": code_digest(),
            "program": program_version(),
        }
        return hashlib.sha256(json.dumps(document, sort_keys=True).encode("utf-8", "surrogatepass")).hexdigest()

    def _settings(self) -> dict[str, Any]:
        fields = dataclasses.asdict(self.settings)
        for name in ("threads", "device"):  # where a model runs does not change what it means
            fields["depth"].pop(name)
        return fields


def build_record(
    clip: ClipStream,
    provenance: Provenance,
    model: ExportedModel | None,
    results: ClipResults,
    seconds: Mapping[str, float],
) -> dict[str, Any]:
    """The content of `run.json`.

    Args:
        clip: the clip, read to its end.
        model: the estimator's network, where it has one.
        results: what was written of it.
        seconds: time spent by stage [s].
    """
    source, settings, frames = clip.source, clip.settings, results.estimates
    depth_identity, masks_identity = clip.identity
    network = None
    if model is not None:
        path = str(model.path.resolve())
        network = {"path": path, "sha256": provenance.model_sha256, "metadata": model.metadata}
    return {
        "format_version": FORMAT_VERSION,
        "program": PROGRAM,
        "notice": "Research software, not a medical device.",
        "fingerprint": provenance.fingerprint,
        "input": {
            "path": str(source.path.resolve()),
            "sha256": provenance.clip_sha256,
            "frames": len(frames),
            "width": source.size[0],
            "height": source.size[1],
            "fps": source.fps,
        },
        "depth_model": {"identity": depth_identity, "files_sha256": _named_files(settings)},
        "masks": {"source": clip.sources["masks"], "identity": masks_identity},
        "scale": {
            "depth_at_1": clip.scale if math.isfinite(clip.scale) else None,
            "unit": "m" if clip.metric else "of the depth source, not metric",
        },
        "camera": dataclasses.asdict(clip.picture_camera),
        "settings": dataclasses.asdict(settings),
        "statuses": dict(Counter(frame.status for frame in frames)),
        "verdicts": dict(Counter(frame.verdict for frame in frames if frame.verdict)),
        "contacts": dict(results.counts),
        "model": network,
        "estimator": dict(provenance.estimator),
        "units": units_of(model),
        "columns": {TABLE: columns.FRAMES, INTERACTIONS: columns.INTERACTIONS},
        "warnings": warnings_of(clip.source, frames, model, clip.sources),
        "timings_s": {stage: round(value, 4) for stage, value in seconds.items()},
        "overlay_encoder": results.encoder or None,
        "versions": versions(),
    }


def describe(record: Mapping[str, Any]) -> str:
    """One line about what made a clip's results, for its summary."""
    given, model = record["input"], record["model"]
    told = "" if model is None else f", {Path(model['path']).name} ({model['sha256'][:8]})"
    return " · ".join(
        (
            f"{given['frames']} frames, {given['width']}×{given['height']}, {given['fps']:.4g} fps",
            f"estimator {record['estimator']['name']}{told}",
            f"depth {record['depth_model']['identity'].split(':')[0]}",
            f"masks {record['masks']['source']}",
        )
    )


def warnings_of(
    source: FrameSource, frames: Sequence[FrameEstimate], model: ExportedModel | None, sources: Mapping[str, str]
) -> list[str]:
    """What the user should know about a clip, one sentence each: damage to it, doubtful masks or intervals.

    Args:
        source: the clip.
        frames: its results.
        model: what estimated them, where it is a network.
        sources: where its `depth` and `masks` came from.
    """
    metadata, found = {} if model is None else model.metadata, []
    for what, trained in (metadata.get("trained_on") or {}).items():
        if sources[what] not in trained:
            found.append(
                f"the model was trained on {what} from {' and '.join(trained)} and this clip's come from "
                f"{sources[what]}: its estimates here are off by an amount that nobody has measured"
            )
    found += source.warnings
    if sources["masks"] == "automatic":
        found.append(
            "automatic masks take all lit tissue, so an instrument touches it in the picture whenever it is seen: "
            "contact here means in view, not pressing"
        )
    for status in PERSISTENT:
        hit = [frame for frame in frames if frame.status == status]
        if hit:
            share = f"{len(hit)} of {len(frames)} frames are {status}"
            found.append(f"{share}, the first is {hit[0].frame}: {hit[0].detail}")
    if isinstance(model, PosteriorModel) and not model.calibrated:
        found.append(UNCALIBRATED)
    # Contact posteriors of version 1 did not say.
    trained = PREPROCESSING_VERSION if model is None else metadata.get("preprocessing_version", 1)
    if trained != PREPROCESSING_VERSION:
        found.append(f"the model was trained on preprocessing version {trained}, this is {PREPROCESSING_VERSION}")
    return found


def units_of(model: ExportedModel | None) -> dict[str, str]:
    """Units of the results: the model's where there is one, for a force that is a magnitude."""
    units = UNITS | ({} if model is None else model.metadata.get("units", {}))
    # The network's force is signed, the table's is not.
    units["force"] = units["force"].split(";")[0]
    return units


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, or of a folder's files with their names; hidden ones and our own results don't count.

    Raises:
        OSError: a file can't be read.
    """
    if path.is_file():
        state = path.stat()
        return _file_sha256(path, state.st_size, state.st_mtime_ns)
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")):
        relative = file.relative_to(path)
        own = file.name in WRITTEN and file.name in own_files(file.parent)
        if not own and file.is_file() and not any(part.startswith(".") for part in relative.parts):
            digest.update(f"{relative.as_posix()}\0{sha256_of(file)}\n".encode("utf-8", "surrogatepass"))
    return digest.hexdigest()


@functools.lru_cache(maxsize=64)
def _file_sha256(path: Path, size: int, changed: int) -> str:
    """Digest of a file's content; size and time of change only keep a changed file from being remembered."""
    return file_sha256(path)


def _named_files(settings: PrepareSettings) -> dict[str, str]:
    """Hashes of the files outside the clip that the settings name, and of the YAML files beside their models."""
    depth = settings.depth
    named = {"depth.source": depth.source, "depth.model": depth.model, "depth.preset": depth.preset}
    named |= {"masks": settings.masks, "camera": settings.layout.camera}
    paths = {name: Path(value) for name, value in named.items() if value is not None}
    paths |= {f"{name}, yaml": path.with_suffix(".yaml") for name, path in paths.items() if path.suffix == ".onnx"}
    return {name: sha256_of(path) for name, path in paths.items() if isfile(path)}


@functools.cache
def program_version() -> str:
    """Version of this program: the checkout's, or the installed package's."""
    project = ROOT / "pyproject.toml"
    if project.is_file():
        return str(tomllib.loads(project.read_text(encoding="utf-8"))["project"]["version"])
    return version("palpate")


def versions() -> dict[str, str]:
    """Versions of this program and of the packages that the numbers depend on."""
    found = {"palpate": program_version(), "python": platform.python_version()}
    found["preprocessing"] = str(PREPROCESSING_VERSION)
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
