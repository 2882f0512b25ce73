"""The door infer.py: what it writes, when it works again, and how it ends."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import cv2
import pytest

import infer
from evaluation.results import ClipResults
from tests.inference_inputs import metadata, write_clip, write_model, write_video

FILES = ["overlay.mp4", "parameters.csv", "run.json", "summary.png"]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model and, under clips, a frame folder and a video."""
    folder = tmp_path_factory.mktemp("inputs")
    write_model(folder / "parameters.onnx")
    write_clip(folder / "clips" / "folder", 8, 4)
    write_video(folder / "clips" / "film.mp4", 8, 4)
    return folder


def call(inputs: Path, output: Path, *options: str, clips: str = "clips") -> int:
    arguments = [str(inputs / clips), "--output", str(output), "--model", str(inputs / "parameters.onnx"), *options]
    return infer.main(arguments)


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "parameters.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_closing_table_is_readable_on_a_narrow_terminal(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert call(inputs, tmp_path, "--no-overlay", clips="clips/folder") == 0
    told = capsys.readouterr().out
    assert all(text in told for text in ("folder", "done", "1 no_tool", "3 no_contact", "4 ok"))
    assert "…" not in told


def test_folder_and_video_give_complete_results(inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert call(inputs, tmp_path) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["film", "folder"]
    for name in ("film", "folder"):
        assert sorted(path.name for path in (tmp_path / name).iterdir()) == FILES
        table = rows(tmp_path / name)
        record = json.loads((tmp_path / name / "run.json").read_text(encoding="utf-8"))
        assert len(table) == 8
        assert record["input"]["frames"] == 8
        video = cv2.VideoCapture(str(tmp_path / name / "overlay.mp4"))
        assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 8
        assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(25.0)
    found = rows(tmp_path / "folder")
    assert [row["status"] for row in found] == ["no_tool"] + ["no_contact"] * 3 + ["ok"] * 4
    assert [row["frame"] for row in found] == [str(number) for number in range(10, 18)]
    assert [float(row["time_s"]) for row in found] == pytest.approx([0.04 * index for index in range(8)])
    assert all((row["stiffness"] != "") == (row["status"] == "ok") for row in found)
    assert {row["force"] for row in found[4:]} == {"0.4"}
    assert {row["stiffness_sd"] + row["damping_sd"] + row["force_sd"] for row in found} == {""}
    printed = capsys.readouterr().out
    assert "folder" in printed
    assert "no_contact" in printed


def test_finished_clips_are_not_computed_again(inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert call(inputs, tmp_path, clips="clips/folder") == 0
    before = (tmp_path / "folder" / "run.json").stat().st_mtime_ns
    assert call(inputs, tmp_path, clips="clips/folder") == 0
    assert (tmp_path / "folder" / "run.json").stat().st_mtime_ns == before
    assert "up to date" in capsys.readouterr().err
    # Without the overlay nothing is missing either; other settings and --overwrite ask for new results.
    assert call(inputs, tmp_path, "--no-overlay", clips="clips/folder") == 0
    assert (tmp_path / "folder" / "run.json").stat().st_mtime_ns == before
    assert call(inputs, tmp_path, "--depth", "photometric", clips="clips/folder") == 0
    changed = (tmp_path / "folder" / "run.json").stat().st_mtime_ns
    assert changed != before
    assert call(inputs, tmp_path, "--depth", "photometric", "--overwrite", clips="clips/folder") == 0
    assert (tmp_path / "folder" / "run.json").stat().st_mtime_ns != changed


def test_changed_clip_is_computed_again(inputs: Path, tmp_path: Path) -> None:
    shutil.copytree(inputs / "clips" / "folder", tmp_path / "clip")
    arguments = [str(tmp_path / "clip"), "--output", str(tmp_path / "out"), "--model", str(inputs / "parameters.onnx")]
    assert infer.main(arguments) == 0
    (tmp_path / "clip" / "frame_17_endo.png").unlink()
    assert infer.main(arguments) == 0
    assert len(rows(tmp_path / "out" / "clip")) == 7


def test_no_overlay_leaves_the_video_out(inputs: Path, tmp_path: Path) -> None:
    assert call(inputs, tmp_path, "--no-overlay", "--threads", "1", clips="clips/folder") == 0
    assert sorted(path.name for path in (tmp_path / "folder").iterdir()) == FILES[1:]


def test_output_among_the_inputs_is_no_input(inputs: Path, tmp_path: Path) -> None:
    shutil.copytree(inputs / "clips", tmp_path / "clips")
    for _ in range(2):
        assert call(tmp_path, tmp_path / "clips" / "folder", "--model", str(inputs / "parameters.onnx")) == 0
    made = sorted(path.name for path in (tmp_path / "clips" / "folder").iterdir() if path.is_dir())
    assert made == ["film", "folder"]


def test_clip_beside_its_results_is_never_replaced(inputs: Path, tmp_path: Path) -> None:
    shutil.copytree(inputs / "clips" / "folder", tmp_path / "folder")
    options = ["--output", str(tmp_path), "--model", str(inputs / "parameters.onnx")]
    assert infer.main([str(tmp_path / "folder"), *options]) == 0
    assert (tmp_path / "folder" / "frame_10_endo.png").is_file()
    marked = [path for path in tmp_path.iterdir() if path.name.startswith("folder-")]
    assert [len(rows(path)) for path in marked] == [8]


def test_interruption_keeps_finished_clips_and_continues(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    write = ClipResults.write

    def interrupt(self: ClipResults, result: object) -> None:
        if self.folder.name == "folder" and len(self.estimates) == 3:
            raise KeyboardInterrupt
        write(self, result)

    with monkeypatch.context() as patch:
        patch.setattr(ClipResults, "write", interrupt)
        assert call(inputs, tmp_path) == 130
    assert [path.name for path in tmp_path.iterdir()] == ["film"]
    assert "1 of 2 clips are complete; run the same command to continue" in capsys.readouterr().err
    before = (tmp_path / "film" / "run.json").stat().st_mtime_ns
    assert call(inputs, tmp_path) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["film", "folder"]
    assert (tmp_path / "film" / "run.json").stat().st_mtime_ns == before


def test_one_failing_clip_does_not_stop_the_others(inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    shutil.copytree(inputs / "clips", tmp_path / "clips")
    (tmp_path / "clips" / "broken.mp4").write_bytes(b"no video")
    assert call(tmp_path, tmp_path / "out", "--model", str(inputs / "parameters.onnx")) == 1
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["film", "folder"]
    told = capsys.readouterr()
    assert "broken.mp4" in told.err
    assert "failed" in told.out


def test_unexpected_error_is_one_sentence_unless_debugging(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("two\nlines")

    monkeypatch.setattr(infer, "open_source", fail)
    assert call(inputs, tmp_path, clips="clips/film.mp4") == 1
    told = capsys.readouterr().err.strip()
    assert told.startswith("failed: ")
    assert "film.mp4: unexpected RuntimeError (two lines); run with --debug" in told.splitlines()[0]
    with pytest.raises(RuntimeError):
        call(inputs, tmp_path, "--debug", clips="clips/film.mp4")


def test_files_of_another_layout_and_a_camera_are_read(inputs: Path, tmp_path: Path) -> None:
    shutil.copytree(inputs / "clips" / "folder", tmp_path / "clip")
    for path in sorted((tmp_path / "clip").glob("*_endo.png")):
        path.rename(path.with_name(path.name.replace("_endo", "")))
    (tmp_path / "layout.yaml").write_text("image: frame_{number}.png\nfps: 50\n")
    camera = {"fx": 150.0, "fy": 150.0, "cx": 80.0, "cy": 48.0, "width": 160, "height": 96}
    (tmp_path / "camera.yaml").write_text(json.dumps(camera))
    options = ("--layout", str(tmp_path / "layout.yaml"), "--camera", str(tmp_path / "camera.yaml"))
    arguments = [str(tmp_path / "clip"), "--output", str(tmp_path / "out"), "--model", str(inputs / "parameters.onnx")]
    assert infer.main([*arguments, *options]) == 0
    found = rows(tmp_path / "out" / "clip")
    assert float(found[1]["time_s"]) == pytest.approx(0.02)
    assert [row["status"] for row in found[4:]] == ["ok"] * 4
    record = json.loads((tmp_path / "out" / "clip" / "run.json").read_text(encoding="utf-8"))
    assert record["camera"]["fx"] == 150.0


def test_an_onset_is_refused_by_networks_that_know_none(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    assert call(inputs, tmp_path / "out", "--onset", "stamp") == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "parameters.onnx knows nothing of when a press begins; leave --onset stamp out." in told


@pytest.mark.parametrize("option", ["--version", "--help"])
def test_help_and_version(option: str, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as ended:
        infer.main([option])
    assert ended.value.code == 0
    assert capsys.readouterr().out


@pytest.mark.slow
def test_real_clip(real_data: Path, tmp_path: Path) -> None:
    """Judged: 80 rows, no tool on frames 80–148, and at least 9 of 149–159 in contact."""
    geometry = {"height": 120, "width": 214}
    write_model(tmp_path / "parameters.onnx", metadata(geometry=geometry))
    assert call(tmp_path, tmp_path / "out", clips=str(real_data / "cholecseg8k")) == 0
    status = {int(row["frame"]): row["status"] for row in rows(tmp_path / "out" / "video01_00080")}
    assert sorted(status) == list(range(80, 160))
    assert {status[number] for number in range(80, 149)} == {"no_tool"}
    assert sum(status[number] == "ok" for number in range(149, 160)) >= 9
