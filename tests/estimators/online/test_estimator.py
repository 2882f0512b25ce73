"""`infer.py --estimator online` as a user runs it: fields of tissue that is pulled, and a sentence where none is."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import infer
from data.masks.class_table import CLASSES
from tests.evaluation.real_clips import pull_pictures, tissue_motion, tool_mask, write

SHARES = np.linspace(0, 1, 6)
SETTINGS = "particles: 150\nstrain: 0.01\n"


def write_annotated(folder: Path, shares: np.ndarray, camera: tuple[float, float] = (0.0, 0.0)) -> Path:
    """A pull in CholecSeg8k's layout."""
    for number, (share, picture) in enumerate(zip(shares, pull_pictures(shares, camera), strict=True), start=10):
        tool = tool_mask(share)[..., None]
        colors = np.where(tool, CLASSES["grasper"].color, CLASSES["gallbladder"].color).astype(np.uint8)
        for name, image in (("", picture), ("_color_mask", colors)):
            write(folder / f"frame_{number}_endo{name}.png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    return folder


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a clip where tissue is pulled while the camera moves, and of one where nothing moves."""
    folder = tmp_path_factory.mktemp("online")
    clips = [
        write_annotated(folder / "pulled", SHARES, (6.0, 0.0)),
        write_annotated(folder / "still", np.zeros(4)),
    ]
    (folder / "online.yaml").write_text(SETTINGS)
    told = ["--estimator", "online", "--settings", str(folder / "online.yaml"), "--output", str(folder / "out")]
    assert infer.main([*map(str, clips), *told]) == 0
    return folder / "out"


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / name).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_every_frame_in_contact_has_a_field(results: Path) -> None:
    table = rows(results / "pulled", "parameters.csv")
    assert [row["status"] for row in table] == ["ok"] * len(SHARES)
    with np.load(results / "pulled" / "fields.npz", allow_pickle=False) as fields:
        for row in table:
            part = f"frame_{row['frame']}/"
            known, distance = fields[part + "known"], fields[part + "distance"]
            assert fields[part + "run"] == 10
            assert float(row["field_known"]) == pytest.approx(known.mean(), rel=1e-5)
            assert (row["distance_stiffness"] != "") == known.any()
            if known.any():
                assert float(row["distance_stiffness"]) == pytest.approx(np.median(distance[known]), rel=1e-5)
        assert not fields["frame_10/known"].any()
        assert fields["frame_15/known"].any()
        assert all(row["stiffness"] == row["force"] == "" for row in table)


def test_particles_are_drawn_where_their_tissue_is(results: Path) -> None:
    """The camera's motion, which the state doesn't have, included."""
    with np.load(results / "pulled" / "fields.npz", allow_pickle=False) as fields:
        first, last = fields["frame_10/pixels"], fields["frame_15/pixels"]
        here, there = fields["frame_10/positions"], fields["frame_15/positions"]
    inner = (first > 24).all(axis=1) & (first[:, 0] < 216) & (first[:, 1] < 152)
    away = inner & (np.linalg.norm(tissue_motion(first, 1.0), axis=1) < 0.8)
    assert away.sum() > 5
    np.testing.assert_allclose(np.median((last - first)[away], axis=0), [6.0, 0.0], atol=1.0)
    pixel = np.ptp(here[:, 0]) / np.ptp(first[:, 0])
    assert np.median(np.linalg.norm((there - here)[away], axis=1)) < 1.5 * pixel


def test_a_run_says_that_theta_is_not_told(results: Path) -> None:
    (run,) = rows(results / "pulled", "interactions.csv")
    assert (run["onset_frame"], run["status"], run["verdict"]) == ("10", "no_estimate", "")
    assert "relative stiffness place by place (fields.npz)" in run["detail"]
    assert "Fitted to the first frames: steps of" in run["detail"]
    record = json.loads((results / "pulled" / "run.json").read_text())
    assert "relative" in record["units"]["distance_stiffness"]
    assert record["estimator"]["particles"] == 150
    assert not any("stretch" in warning for warning in record["warnings"])


def test_a_clip_without_a_driving_tool_says_so_in_a_sentence(results: Path) -> None:
    record = json.loads((results / "still" / "run.json").read_text())
    (warning,) = [each for each in record["warnings"] if "stretch" in each]
    assert "the online estimator needs a clip whose tool drives the tissue" in warning
    assert {row["distance_stiffness"] for row in rows(results / "still", "parameters.csv")} == {""}


def test_bad_settings_end_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "online.yaml").write_text("particles: 3\n")
    clip = write_annotated(tmp_path / "clip", np.zeros(1))
    told = [str(clip), "--output", str(tmp_path / "out"), "--settings", str(tmp_path / "online.yaml")]
    assert infer.main([*told, "--estimator", "online"]) == 2
    assert "particles is 3; give 30 to 10000" in " ".join(capsys.readouterr().err.split())
    assert infer.main([*told, "--estimator", "direct"]) == 2
    assert "is for --estimator online; leave it out" in " ".join(capsys.readouterr().err.split())
