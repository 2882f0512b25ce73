"""What results were made of, and when they are out of date."""

import json
import os
from argparse import Namespace
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from palpate.common.files import digest_of
from palpate.data.clip import ClipStream
from palpate.data.depth.normalise import DepthSettings
from palpate.data.settings import PrepareSettings
from palpate.data.source.frames import FrameSource, open_source
from palpate.data.source.layout import ClipLayout
from palpate.estimators.contract import ClipInfo, Preparation
from palpate.estimators.gan import GanEstimator
from palpate.estimators.model_settings import preparation_settings
from palpate.estimators.open import open_estimator
from palpate.estimators.records import FrameEstimate
from palpate.models.calibration import Calibration, Widths
from palpate.models.onnx_session import ParameterModel, PosteriorModel
from palpate.results import record as recording
from palpate.results.artefacts.base import artefacts
from palpate.results.store import write_record
from palpate.results.writer import ClipResults
from tests.inference_inputs import metadata, write_clip, write_model, write_posterior


def test_fingerprint_follows_what_results_depend_on(tmp_path: Path) -> None:
    clip, prepared = tmp_path / "clip.mp4", PrepareSettings()
    clip.write_bytes(b"one")

    def fingerprint(settings: PrepareSettings = prepared, **options: Any) -> str:
        estimator = open_estimator(**({"name": "direct"} | options))
        return digest_of(recording.depends_on(clip, settings, estimator))

    first = fingerprint()
    others = [
        fingerprint(PrepareSettings(depth=DepthSettings(near=0.05))),
        fingerprint(PrepareSettings(masks="automatic")),
        fingerprint(noise=0.002),
        fingerprint(name="gan", model=write_model(tmp_path / "one.onnx")),
        fingerprint(name="gan", model=write_model(tmp_path / "other.onnx", slope=(0.3, 0.0, 0.0))),
    ]
    assert fingerprint(PrepareSettings(depth=DepthSettings(threads=3))) == first
    clip.write_bytes(b"other")
    assert len({first, *others, fingerprint()}) == 7


def test_results_name_the_model_that_was_opened_whatever_becomes_of_its_file(tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip", 2, 1)
    estimator = open_estimator("gan", model=write_model(tmp_path / "model.onnx"))
    opened = recording.depends_on(clip, PrepareSettings(), estimator)["model"]
    assert opened == recording.sha256_of(tmp_path / "model.onnx")
    write_model(tmp_path / "model.onnx", slope=(0.3, 0.0, 0.0))
    again = recording.depends_on(clip, PrepareSettings(), estimator)["model"]
    assert again == opened != recording.sha256_of(tmp_path / "model.onnx")


def test_fingerprint_follows_the_content_of_named_models(tmp_path: Path) -> None:
    masks = tmp_path / "masks.onnx"

    def fingerprint(content: bytes) -> str:
        masks.write_bytes(content)
        settings = PrepareSettings(masks=str(masks))
        return digest_of(recording.depends_on(masks, settings, open_estimator("direct")))

    first, second = fingerprint(b"one"), fingerprint(b"other")
    masks.with_suffix(".yaml").write_text("size: 3")
    assert len({first, second, fingerprint(b"other")}) == 3


def test_record_holds_hashes_counts_units_and_times(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "clip", 6, 3)
    model = ParameterModel(write_model(tmp_path / "model.onnx"))
    estimator, settings = GanEstimator(model), preparation_settings(model, Preparation())
    causes = recording.depends_on(path, settings, estimator)
    source = open_source(path, settings.layout)
    clip = ClipStream(source, settings)
    session = estimator.start(ClipInfo.of(clip))
    options = Namespace(overlay=True, bag=None, export=None, force_scale=None)
    with ClipResults(tmp_path / "out", source, artefacts(options, estimator)) as results:
        frames = list(clip)
        found = [item for frame in frames for item in session.push(frame)] + list(session.finish())
        for frame, estimate in zip(frames, found[:-1], strict=True):
            results.write(frame, estimate)
        results.add(found[-1])
        record = recording.build_record(clip, causes, model, results, {**clip.seconds, **results.seconds})
        results.finish(record)
    stored = json.loads((tmp_path / "out" / "run.json").read_text(encoding="utf-8"))
    assert stored["input"]["path"] == str(path.resolve())
    assert stored["input"]["sha256"] == recording.sha256_of(path)
    assert stored["model"]["sha256"] == recording.sha256_of(model.path)
    assert stored["depth_model"]["identity"].startswith("stored:")
    assert stored["statuses"] == {"no_contact": 3, "ok": 3}
    assert stored["verdicts"] == {"undetermined": 3}
    assert stored["contacts"] == {"undetermined": 1}
    assert stored["estimator"] == {"name": "gan"}
    assert stored["settings"]["geometry"]["height"] == 48
    assert stored["units"]["stiffness"] == "scene units (normalised), not N/m"
    assert {table: columns["force"] for table, columns in stored["columns"].items()} == {
        "parameters.csv": "|F|",
        "interactions.csv": "|F|",
    }
    assert {"decode", "masks", "depth", "geometry", "overlay"} <= set(stored["timings_s"])
    assert {"palpate", "python", "numpy", "onnxruntime"} <= set(stored["versions"])
    assert stored["fingerprint"] == digest_of(causes)


@pytest.fixture
def source(tmp_path: Path) -> FrameSource:
    return open_source(write_clip(tmp_path / "clip", 3, 1), ClipLayout())


SOURCES = {"depth": "stored", "masks": "annotation"}


def test_warnings_name_broken_frames_and_another_preprocessing(source: FrameSource, tmp_path: Path) -> None:
    rows = [FrameEstimate(4, 0.0, "ok"), FrameEstimate(5, 0.1, "no_mask", detail="m.png does not exist; add it.")]
    unnamed = metadata()
    del unnamed["preprocessing_version"]  # which is that of the first
    for told, version in ((metadata(preprocessing_version=0), 0), (unnamed, 1)):
        found = recording.warnings_of(source, rows, ParameterModel(write_model(tmp_path / "model.onnx", told)), SOURCES)
        assert found[0] == "1 of 2 frames are no_mask, the first is 5: m.png does not exist; add it."
        assert found[1].startswith(f"the model was trained on preprocessing version {version}")


def test_warnings_name_sources_the_model_was_not_trained_on(source: FrameSource, tmp_path: Path) -> None:
    trained_on = {"depth": ["depthpro", "stored"], "masks": ["annotation"]}
    model = ParameterModel(write_model(tmp_path / "model.onnx", metadata(trained_on=trained_on)))
    rows = [FrameEstimate(0, 0.0, "ok")]
    assert recording.warnings_of(source, rows, model, SOURCES) == []
    found = recording.warnings_of(source, rows, model, {"depth": "photometric", "masks": "automatic"})
    assert found[0].startswith(
        "the model was trained on depth from depthpro and stored and this clip's come from photo"
    )
    assert found[1].startswith("the model was trained on masks from annotation and this clip's come from automatic")
    assert found[2].endswith("contact is undecided until instrument or tissue has moved")


@pytest.mark.parametrize(
    ("calibration", "told"),
    [(Calibration(), [recording.UNCALIBRATED]), (Calibration(Widths(power=(1.0, 0.8, 1.0))), [])],
)
def test_intervals_that_were_never_calibrated_are_warned_of(calibration, told, source, tmp_path) -> None:
    document = metadata() | {"calibration": asdict(calibration)}
    model = PosteriorModel(write_posterior(tmp_path / "contact.onnx", document, 10))
    assert recording.warnings_of(source, [], model, SOURCES) == told


def test_hash_of_a_folder_follows_names_and_contents(tmp_path: Path) -> None:
    (tmp_path / "clip" / "sub").mkdir(parents=True)
    (tmp_path / "clip" / "a.png").write_bytes(b"1")
    (tmp_path / "clip" / "sub" / "b.png").write_bytes(b"2")
    first = recording.sha256_of(tmp_path / "clip")
    (tmp_path / "clip" / ".hidden").write_bytes(b"3")
    assert recording.sha256_of(tmp_path / "clip") == first
    (tmp_path / "clip" / "out").mkdir()
    for name in ("parameters.csv", "overlay.mp4", "fit.png"):
        (tmp_path / "clip" / "out" / name).write_bytes(b"ours")
    write_record(tmp_path / "clip" / "out", {"program": "infer.py"})
    assert recording.sha256_of(tmp_path / "clip") == first
    (tmp_path / "clip" / "out" / "frame_1.png").write_bytes(b"a frame beside results")
    second = recording.sha256_of(tmp_path / "clip")
    assert second != first
    (tmp_path / "clip" / "a.png").rename(tmp_path / "clip" / "c.png")
    assert recording.sha256_of(tmp_path / "clip") != second
    (tmp_path / "clip" / "out" / "run.json").write_bytes(b"{}")  # then nothing tells whose the files are
    assert len({first, second, recording.sha256_of(tmp_path / "clip")}) == 3


def test_a_file_that_is_too_large_for_a_picture_counts_by_size_and_time(tmp_path, monkeypatch) -> None:
    """Nothing reads it, and hashing 12 GB would take longer than the clip."""
    (tmp_path / "1.png").write_bytes(b"x")
    with (tmp_path / "2.png").open("wb") as file:
        file.truncate(12 * 2**30)
    opened = []
    monkeypatch.setattr(recording, "file_sha256", lambda path: opened.append(path.name) or "0")
    first = recording.sha256_of(tmp_path)
    assert opened == ["1.png"]
    os.utime(tmp_path / "2.png", (1, 1))
    assert recording.sha256_of(tmp_path) != first
