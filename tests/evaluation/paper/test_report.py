"""The files of an evaluation: complete, consistent with each other, readable, and never half written."""

import json
import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from palpate.common.output import LIST
from palpate.evaluation.page import render_page
from palpate.evaluation.paper.analysis import REGIMES, EvaluationError
from palpate.evaluation.paper.report import COMPARISONS, ERRORS, write_evaluation
from palpate.evaluation.paper.statistics import format_number
from tests.evaluation.simple_contacts import BOUNDS, MECHANICS, contact, record
from tests.tables import read_rows

SOFT, HARD = np.array([0.2, 0.02, -0.05]), np.array([1.5, 0.15, -0.2])
NAMES = {"figure3.png", "theta.png", "per_frame.csv", "report.html", "evaluation.json"}


@pytest.fixture(scope="module")
def records():
    truths = {"weich ü": SOFT, "hard": HARD, "third": SOFT * 1.2}
    made = [record(theta, theta * 1.05, clip, frame) for clip, theta in truths.items() for frame in range(3)]
    made[0] |= {"reference_trajectory": np.full((40, 3), np.nan, np.float32), "error_reference": math.nan}
    return made


@pytest.fixture(scope="module")
def written(records, tmp_path_factory):
    folder = tmp_path_factory.mktemp("evaluation") / "new" / "folder"
    return write_evaluation(records, [contact(SOFT), contact(HARD)], MECHANICS, BOUNDS, folder)


def _content(path):
    def refuse(name):
        raise AssertionError(f"{name} in JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def test_every_file_is_there_and_nothing_else(written):
    assert set(written) == NAMES
    folder = written["per_frame.csv"].parent
    assert {path.name for path in folder.iterdir()} == NAMES | {LIST}


def test_json_holds_all_numbers_without_nan(written):
    content = _content(written["evaluation.json"])
    assert [row["error_reference"] for row in content["frames"].values()].count(None) == 1
    assert content["comparisons"]["constant θ"]["n"]["value"] == 9
    assert content["mechanics"]["steps"] == 40
    assert content["bounds"]["force"] == [-0.5, 0.0]
    assert content["motion"]["predicted θ"]["not finite"] == 0
    assert np.shape(content["trajectories"]) == (9, 40, 3)
    assert content["versions"]["numpy"] == np.__version__
    summaries = content["summaries"]
    assert list(summaries) == list(REGIMES)
    assert f"{summaries['predicted θ']['mean']['value']:.4g}".replace("e-0", "e−") in written["report.html"].read_text()


def test_table_2_has_every_statistic_in_full_precision(written):
    found = _content(written["evaluation.json"])["summaries"]["predicted θ"]
    errors = np.array([float(row["error_predicted"]) for row in read_rows(written["per_frame.csv"])])
    assert found["mean"]["value"] == pytest.approx(errors.mean(), rel=1e-12)
    assert found["sd"]["value"] == pytest.approx(errors.std(ddof=1), rel=1e-12)
    assert (found["interval"]["value"], found["mean"]["low"]) == (None, None)
    assert found["interval"]["low"] < errors.mean() < found["interval"]["high"]
    text = written["report.html"].read_text("utf-8")
    for label in (*ERRORS, *COMPARISONS):
        assert f"<td>{label}</td>" in text


def test_rows_of_frames_and_which_did_not_settle(written, records):
    content = _content(written["evaluation.json"])
    for row in content["frames"].values():
        assert row["state"] in ("settled", "not reached")
        assert (row["settling_time_s"] is not None) == (row["state"] == "settled")
    assert content["motion"]["reference θ"]["not finite"] == 1
    rows = read_rows(written["per_frame.csv"])
    assert [row["clip"] + row["frame"] for row in rows[:4]] == ["hard0", "hard1", "hard2", "third0"]
    hard = next(one for one in records if one["clip"] == "hard")
    assert float(rows[0]["force"]) == pytest.approx(0.21)  # a magnitude
    assert float(rows[0]["error_predicted"]) == hard["error_predicted"]
    assert float(rows[0]["copy_error"]) == hard["copy_error"]
    assert len(rows) == 9
    assert rows[6]["clip"] == "weich ü"
    assert rows[6]["error_reference"] == ""  # not finite: empty, never 0


def test_spread_by_parameter(written):
    rows = _content(written["evaluation.json"])["spread"]
    assert ",".join(rows["stiffness"]) == ("mean,sd,minimum,maximum,low,high,sd_of_range,sd_of_mean,at_bound,verdict")
    assert [(name, row["verdict"]) for name, row in rows.items()] == [
        (name, "varies") for name in ("stiffness", "damping", "force")
    ]


def test_the_page_says_what_was_left_out_and_concludes(written):
    page = written["report.html"].read_text("utf-8")
    rows = [re.findall("<td>(.*?)</td>", row) for row in re.findall("<tr>(.*?)</tr>", page, re.DOTALL)]
    assert ["frames left out (error not finite)", *"10000"] in rows
    assert ["reference θ", *"––080010"] in [row[:9] for row in rows]
    assert "Spread of the estimates over the test frames" in page
    assert "Constant θ fitted on the training contacts (n = 2)" in page
    assert not [row for row in rows if "nan" in row]


@pytest.mark.parametrize("name", ["figure3.png", "theta.png"])
def test_figures_are_pictures_with_content(written, name):
    picture = Image.open(written[name]).convert("RGB")
    assert picture.width > 1500
    assert len(picture.reduce(4).getcolors(1_000_000)) > 100


def test_page_is_self_contained_says_how_it_was_made_and_begins_with_what_was_found(written):
    """The conclusion, numbers and figures come before comparisons; a page of few clips gives no verdict."""
    page = written["report.html"].read_text("utf-8")
    # Every element is closed, in order, but for those that need not be.
    root = ElementTree.fromstring(re.sub("<(meta|img)([^>]*?)/?>", r"<\1\2/>", page))
    assert page.count('<img src="data:image/png;base64,') == 2
    assert "http" not in page
    text = "".join(root.itertext())
    assert "Not a medical device." in text
    assert "not N/m, N·s/m and N" in text
    assert "40 steps of 0.005 s" in text
    assert "stiffness 0.05 … 2; damping 0.005 … 0.3; force -0.5 … 0" in text
    assert f"numpy {np.__version__}" in text
    assert "3 clips: too few to judge whether the estimates beat the constant θ" in text
    order = ["3 clips: too few to judge", "How well simulations follow the observed motion (9 test frames of 3 clips)",
             "What was estimated, in normalised units (9 test frames of 3 clips)", "<img", "Wilcoxon p"]  # fmt: skip
    places = [page.index(text) for text in order]
    assert places == sorted(places)
    assert not any(f"θ against {name}: {verdict}" in page for name in REGIMES for verdict in ("better", "worse"))
    assert "success" not in page.lower()
    summaries = _content(written["evaluation.json"])["summaries"]
    predicted, still = (summaries[name]["mean"]["value"] for name in ("predicted θ", "no motion"))
    cells = (format_number(value) for value in (predicted, 100 * predicted / still))
    assert "<td>predicted θ</td>\n<td>{}</td>\n<td>{}</td>".format(*cells) in page


def test_text_of_the_page_is_escaped():
    assert "<script>" not in render_page("title", "a <script> & b", {}).split("<body>")[1]


@pytest.fixture
def undrawn(monkeypatch):
    monkeypatch.setattr("palpate.evaluation.paper.report.as_png", lambda figure: b"")


@pytest.mark.usefixtures("undrawn")
def test_one_record_is_enough_to_write(tmp_path):
    written = write_evaluation([record(SOFT, SOFT)], [], MECHANICS, BOUNDS, tmp_path)
    text = written["report.html"].read_text("utf-8")
    assert "n too small" in text
    assert ">nan<" not in text


@pytest.mark.usefixtures("undrawn")
def test_a_folder_that_cannot_be_made_is_named(records, tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("")
    with pytest.raises(EvaluationError, match=r"file: the evaluation can't be written \(.+\); choose a folder"):
        write_evaluation(records[:1], [], MECHANICS, BOUNDS, blocker)


@pytest.mark.usefixtures("undrawn")
def test_a_write_that_fails_keeps_the_earlier_file(records, tmp_path, monkeypatch):
    (tmp_path / "per_frame.csv").write_text("earlier")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("palpate.common.files.os.replace", full)
    with pytest.raises(EvaluationError, match="No space left on device"):
        write_evaluation(records[:1], [], MECHANICS, BOUNDS, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["per_frame.csv"]
    assert (tmp_path / "per_frame.csv").read_text() == "earlier"
