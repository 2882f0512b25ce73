"""What a sequence beside a robot is written as: particles in its frame, tables, and sentences of wrong usage."""

import csv
import json
from pathlib import Path

import meshio
import numpy as np
import pytest

from palpate.cli.infer import main
from tests.sequences import SHIFT, TURN, pull, write_sequence

SETTINGS = "{particles: 80, fitted: 0, method: {optimizer: gauss-newton}}"


def test_particles_and_tables_are_in_the_robots_frame_and_metres(tmp_path: Path) -> None:
    path, settings = write_sequence(tmp_path / "pull", 3, length=1000.0, unit="mm"), tmp_path / "settings.yaml"
    settings.write_text(SETTINGS)
    given = [str(path), "--output", str(tmp_path / "out"), "--estimator", "online", "--settings", str(settings)]
    assert main(given) == 0
    folder = tmp_path / "out/pull"
    made = (folder / "particles_000003.vtk").stat().st_mtime_ns
    assert main(given) == 0
    assert (folder / "particles_000003.vtk").stat().st_mtime_ns == made  # nothing has changed
    assert main([*given, "--overwrite"]) == 0
    assert (folder / "particles_000003.vtk").stat().st_mtime_ns > made
    record = json.loads((folder / "run.json").read_text())
    assert (record["input"]["frames"], record["verdicts"]) == (3, {"undetermined": 3})
    assert record["input"]["fps"] == pytest.approx(10)
    assert record["units"] == {"length": "m", "time": "s"}
    assert {"particles_000001.vtk", "particles_000003.vtk", "particles.csv", "parameters.csv"} <= {*record["files"]}
    assert "missed what the frame shows, m" in record["columns"]["parameters.csv"]["gap"]
    write_sequence(tmp_path / "pull", 3, length=1000.0, unit="mm", grip_radius=13.0)
    assert main(given) == 1  # another input: its results are not replaced unasked
    assert main([*given, "--overwrite"]) == 0
    assert sorted(file.name for file in folder.glob("particles_*")) == [
        f"particles_00000{number}.vtk" for number in (1, 2, 3)
    ]
    rows = list(csv.DictReader((folder / "particles.csv").open()))
    rest, now = (np.array([[float(row[f"{of}{axis}"]) for axis in "xyz"] for row in rows]) for of in ("rest_", ""))
    vtk = meshio.read(folder / "particles_000003.vtk")
    np.testing.assert_allclose(vtk.points, now)
    sheet = (rest - SHIFT) @ TURN
    np.testing.assert_allclose(sheet[:, 2], 0, atol=2e-4)
    np.testing.assert_allclose(np.ptp(sheet[:, :2], axis=0), 0.12, atol=0.01)
    tip = np.linalg.norm(sheet - (0.12, 0.06, 0), axis=1).argmin()
    np.testing.assert_allclose(
        (now - rest)[tip] @ TURN, pull(3).places[2, 0] - pull(3).body.rest[pull(3).gripped[0]], atol=1e-8
    )
    assert np.isnan(vtk.point_data["stiffness"]).all()  # three frames determine nothing
    assert {row["stiffness"] for row in rows} == {""}
    np.testing.assert_allclose(
        vtk.point_data["simulated_stiffness"], [float(row["simulated_stiffness"]) for row in rows]
    )
    table = list(csv.DictReader((folder / "parameters.csv").open()))
    assert [(row["frame"], row["time_s"], row["verdict"]) for row in table][:2] == [
        ("1", "0.1", "undetermined"),
        ("2", "0.2", "undetermined"),
    ]
    (folder / "particles.csv").write_text("mine")
    assert main(given) == 1
    assert (folder / "particles.csv").read_text() == "mine"


def test_frames_without_tissue_are_counted_and_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, settings = write_sequence(tmp_path / "pull", 4), tmp_path / "settings.yaml"
    settings.write_text(SETTINGS)
    for number in (0, 3):
        np.savez(path.parent / f"clouds/{number:03d}.npz", points=np.empty((0, 3)))
    given = [str(path), "--output", str(tmp_path / "out"), "--estimator", "online", "--settings", str(settings)]
    assert main(given) == 0
    said = "2 of 5 frames show no tissue: their clouds are empty"
    assert f"pull: {said}" in " ".join(capsys.readouterr().err.split())
    folder = tmp_path / "out/pull"
    assert json.loads((folder / "run.json").read_text())["warnings"] == [said]
    index = (tmp_path / "out/index.html").read_text()
    assert said in index
    assert 'href="pull/parameters.csv"' in index
    rows = list(csv.DictReader((folder / "parameters.csv").open()))
    assert [row["frame"] for row in rows] == ["2", "3", "4"]
    tip = meshio.read(folder / "particles_000003.vtk").points  # follows the tool and followed points
    assert np.linalg.norm(tip - meshio.read(folder / "particles_000002.vtk").points, axis=1).max() > 1e-4


def test_a_bad_sequence_does_not_stop_the_others(tmp_path: Path) -> None:
    bad, good = (write_sequence(tmp_path / name, 3) for name in "ab")
    settings = tmp_path / "settings.yaml"
    settings.write_text(SETTINGS)
    (bad.parent / "poses.csv").write_text("nothing")
    given = [str(bad), str(good), "--output", str(tmp_path / "out"), "--estimator", "online"]
    assert main([*given, "--settings", str(settings)]) == 1
    assert (tmp_path / "out/b/run.json").is_file()
    assert not (tmp_path / "out/a").exists()
    assert '<th scope="row">a</th>' in (tmp_path / "out/index.html").read_text()


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--estimator", "network"], "is a sequence, which is for --estimator online; give that"),
        (["--estimator", "online", "--depth", "stored"], "--depth is for videos, and .* is a sequence; leave it out"),
    ],
)
def test_what_is_for_videos_is_a_sentence(tmp_path: Path, capsys, more: list[str], sentence: str) -> None:
    assert main([str(write_sequence(tmp_path / "pull", 3)), "--output", str(tmp_path / "out"), *more]) == 1
    assert sentence.split(" .* ")[0] in " ".join(capsys.readouterr().err.split())
