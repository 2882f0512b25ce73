"""The files of an evaluation: complete, consistent with each other, and never half written."""

import math

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from palpate.common.output import LIST
from palpate.results.paper.report import FILES, REGIMES, EvaluationError, write_evaluation
from tests.results.paper.simple_contacts import BOUNDS, MECHANICS, contact, record

SOFT, HARD = np.array([0.2, 0.02, -0.05]), np.array([1.5, 0.15, -0.2])


@pytest.fixture(scope="module")
def records():
    truths = {"weich ü": SOFT, "hard": HARD, "third": SOFT * 1.2}
    made = [record(theta, theta * 1.05, clip, frame) for clip, theta in truths.items() for frame in range(3)]
    made[0] |= {"reference_trajectory": np.full((40, 3), np.nan, np.float32), "error_reference": math.nan}
    return made


@pytest.fixture(scope="module")
def written(records, tmp_path_factory):
    folder = tmp_path_factory.mktemp("evaluation") / "new" / "folder"
    paths = write_evaluation(records, [contact(SOFT), contact(HARD)], MECHANICS, BOUNDS, folder)
    assert {path.name for path in folder.iterdir()} == {*FILES, LIST}
    return paths


def test_table_2_has_every_regime_s_error_in_full_precision(written):
    table, frames = (pd.read_csv(written[name], index_col=0) for name in ("table_2.csv", "per_frame.csv"))
    assert list(table.index) == list(REGIMES)
    found, errors = table.loc["predicted θ"], frames["error_predicted"]
    assert (found["mean"], found["sd"]) == pytest.approx((errors.mean(), errors.std()), rel=1e-12)
    assert found["low"] < errors.mean() < found["high"]
    assert table["left_out"].tolist() == [1, 0, 0, 0, 0]
    assert table["frames"].tolist() == [8, 9, 9, 9, 9]


def test_rows_of_frames_are_in_order_with_parameters_as_reported(written, records):
    frames = pd.read_csv(written["per_frame.csv"])
    assert frames["clip"].tolist() == sorted(["weich ü", "hard", "third"] * 3)
    assert frames["force"][0] == pytest.approx(0.21)  # a magnitude
    assert frames["copy_error"][0] == next(one for one in records if one["clip"] == "hard")["copy_error"]
    assert math.isnan(frames["error_reference"][6])  # not finite: empty, never 0
    assert set(frames["state"]) <= {"settled", "not reached"}
    assert pd.read_csv(written["motion.csv"], index_col=0)["not finite"].tolist() == [1, 0]
    assert pd.read_csv(written["spread.csv"])["verdict"].tolist() == ["varies"] * 3


def test_figure_3_is_a_picture_with_content(written):
    picture = Image.open(written["figure3.png"]).convert("RGB")
    assert picture.width > 1500
    assert len(picture.reduce(4).getcolors(1_000_000)) > 100


def test_one_record_is_enough_to_write(tmp_path):
    written = write_evaluation([record(SOFT, SOFT)], [], MECHANICS, BOUNDS, tmp_path)
    assert pd.read_csv(written["spread.csv"])["verdict"].tolist() == ["n too small"] * 3
    assert np.isnan(pd.read_csv(written["table_2.csv"], index_col=0).loc["constant θ", "mean"])


def test_no_records_and_a_folder_that_cannot_be_made_are_named(records, tmp_path):
    with pytest.raises(EvaluationError, match="no test pair is in contact"):
        write_evaluation([], [], MECHANICS, BOUNDS, tmp_path)
    blocker = tmp_path / "file"
    blocker.write_text("")
    with pytest.raises(FileExistsError):
        write_evaluation(records[:1], [], MECHANICS, BOUNDS, blocker)
