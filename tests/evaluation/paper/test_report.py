"""The files of an evaluation: complete, consistent with each other, and never half written."""

import csv
import json
import math

import numpy as np
import pytest
from PIL import Image

from evaluation.paper.baselines import ConstantThetaSettings
from evaluation.paper.report import EvaluationError, write_evaluation
from tests.evaluation.simple_contacts import BOUNDS, MECHANICS, contact, record

SETTINGS = ConstantThetaSettings(contacts=2, starts=2, refined=1, iterations=4)
SOFT, HARD = np.array([0.2, 0.02, -0.05]), np.array([1.5, 0.15, -0.2])
NAMES = {"table2.md", "table2.csv", "collapse.md", "collapse.csv", "settling.csv", "figure3.png", "theta.png",
         "per_frame.csv", "report.html", "evaluation.json"}  # fmt: skip


@pytest.fixture(scope="module")
def records():
    truths = {"weich ü": SOFT, "hard": HARD, "third": SOFT * 1.2}
    made = [record(theta, theta * 1.05, clip, frame) for clip, theta in truths.items() for frame in range(3)]
    made[0] |= {"reference_trajectory": np.full((40, 3), np.nan, np.float32), "error_reference": math.nan}
    return made


@pytest.fixture(scope="module")
def written(records, tmp_path_factory):
    folder = tmp_path_factory.mktemp("evaluation") / "new" / "folder"
    return write_evaluation(records, [contact(SOFT), contact(HARD)], MECHANICS, BOUNDS, folder, SETTINGS)


def _rows(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_every_file_is_there_and_nothing_else(written):
    assert set(written) == NAMES
    folder = written["table2.md"].parent
    assert {path.name for path in folder.iterdir()} == NAMES


def test_json_holds_all_numbers_without_nan(written):
    def refuse(name):
        raise AssertionError(f"{name} in JSON")

    content = json.loads(written["evaluation.json"].read_text(encoding="utf-8"), parse_constant=refuse)
    evaluation = content["evaluation"]
    assert evaluation["errors"]["reference θ"].count(None) == 1
    assert evaluation["comparisons"]["constant θ"]["n"] == 9
    assert evaluation["constant"]["contacts_used"] == 2
    assert content["mechanics"]["steps"] == 40
    assert content["bounds"]["force"] == [-0.5, 0.0]
    assert content["settling_summary"]["predicted θ"]["counts"]["not finite"] == 0
    assert set(evaluation["response"]) >= {"relative", "percentiles", "release", "order"}


def test_tables_and_json_agree(written):
    summaries = json.loads(written["evaluation.json"].read_text(encoding="utf-8"))["evaluation"]["summaries"]
    means = {row["regime"]: row["value"] for row in _rows(written["table2.csv"]) if row["quantity"] == "mean"}
    assert {name: float(value) for name, value in means.items()} == {
        name: summary["mean"] for name, summary in summaries.items()
    }
    assert f"{summaries['predicted θ']['mean']:.4g}".replace("e-0", "e−") in written["table2.md"].read_text("utf-8")


def test_per_frame_rows(written, records):
    rows = _rows(written["per_frame.csv"])
    assert len(rows) == 9
    assert [(row["clip"], row["frame"]) for row in rows[:4]] == [
        ("hard", "0"),
        ("hard", "1"),
        ("hard", "2"),
        ("third", "0"),
    ]
    hard = next(one for one in records if one["clip"] == "hard")
    assert float(rows[0]["force"]) == pytest.approx(0.21)  # a magnitude
    assert float(rows[0]["error_predicted"]) == hard["error_predicted"]
    assert float(rows[0]["copy_error"]) == hard["copy_error"]
    assert rows[6]["clip"] == "weich ü"
    assert rows[6]["error_reference"] == ""  # not finite: empty, never 0


def test_settling_rows_name_what_did_not_settle(written):
    rows = _rows(written["settling.csv"])
    assert len(rows) == 18
    assert {row["state"] for row in rows} <= {"settled", "not reached", "not finite"}
    for row in rows:
        assert (row["settling_time_s"] != "") == (row["state"] == "settled")
    assert sum(row["state"] == "not finite" for row in rows) == 1


def test_markdown_says_what_was_left_out_and_concludes(written):
    text = written["table2.md"].read_text("utf-8")
    assert "reference θ: 1 of 9 errors are not finite and left out of its column." in text
    assert "| reference θ | 9 | 1 | 0 |" in text
    collapse = written["collapse.md"].read_text("utf-8")
    assert "Spread of the estimates over the test frames" in collapse
    assert "| training contacts used | 2 of 2 |" in collapse
    assert "nan" not in (text + collapse).lower()


@pytest.mark.parametrize("name", ["figure3.png", "theta.png"])
def test_figures_are_pictures_with_content(written, name):
    pixels = np.asarray(Image.open(written[name]).convert("RGB"))
    assert pixels.shape[1] > 1500
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 100


def test_page_is_self_contained(written):
    page = written["report.html"].read_text("utf-8")
    assert page.count('src="data:image/png;base64,') == 2
    assert "http" not in page
    assert "Not a medical device." in page


def test_one_record_is_enough_to_write(tmp_path):
    written = write_evaluation([record(SOFT, SOFT)], [contact(SOFT)], MECHANICS, BOUNDS, tmp_path, SETTINGS)
    text = "".join(written[name].read_text("utf-8") for name in ("table2.md", "collapse.md", "report.html"))
    assert "n too small" in text
    assert ">nan<" not in text
    assert "| nan" not in text


def test_no_records_are_one_sentence(tmp_path):
    with pytest.raises(EvaluationError, match="no test pair is in contact"):
        write_evaluation([], [], MECHANICS, BOUNDS, tmp_path)


def test_a_folder_that_cannot_be_made_is_named(records, tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("")
    with pytest.raises(EvaluationError, match=r"file: the evaluation can't be written \(.+\); choose a folder"):
        write_evaluation(records, [], MECHANICS, BOUNDS, blocker, SETTINGS)


def test_a_write_that_fails_keeps_the_earlier_file(records, tmp_path, monkeypatch):
    (tmp_path / "table2.md").write_text("earlier")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("physics.files.os.replace", full)
    with pytest.raises(EvaluationError, match="No space left on device"):
        write_evaluation(records, [], MECHANICS, BOUNDS, tmp_path, SETTINGS)
    assert [path.name for path in tmp_path.iterdir()] == ["table2.md"]
    assert (tmp_path / "table2.md").read_text() == "earlier"
