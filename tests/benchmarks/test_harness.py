"""What evaluations share: options, results on disk that are never lost or mixed, and what is written of them."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pandas as pd
import pytest

from benchmarks import harness
from palpate.common.doors import INTERRUPTED
from palpate.results.store import OutputError
from tests.benchmarks.recovery_cases import recovery

KEYS = ("suite", "index", "estimator")
WANTED = {"seed": 0, "split": "test", "suite clean": {"errors": 1}, "estimator direct": {"noise": None}}


def test_a_result_survives_the_file_and_what_is_not_known_stays_unknown(tmp_path):
    unsure = {"curve": np.array([[0.5, np.nan], [1.0, np.inf]]), "noise": float("nan"), "reason": None}
    rows = recovery(3), recovery(4, estimate=None, covariance=None) | unsure
    store = harness.Store(tmp_path, WANTED, KEYS)
    store.append(rows)
    found = harness.read_results(tmp_path / harness.RESULTS, KEYS)
    assert list(found) == list(store.rows) == [("clean", 3, "direct"), ("clean", 4, "direct")]
    for again in (found, store.rows):
        for row, kept in zip(rows, again.values(), strict=True):
            for name in row.keys() - unsure.keys():
                np.testing.assert_array_equal(kept[name], row[name])
        kept = again["clean", 4, "direct"]
        np.testing.assert_array_equal(kept["curve"], [[0.5, np.nan], [1.0, np.nan]])
        assert not {"noise", "reason"} & set(kept)
    assert "NaN" not in (tmp_path / harness.RESULTS).read_text()  # other readers of JSON know no such word


def test_a_row_of_the_same_key_takes_the_place_of_the_first(tmp_path):
    store = harness.Store(tmp_path, WANTED, KEYS)
    store.append([recovery(1)])
    store.append([recovery(1, misfit=2.0), recovery(0)])
    for rows in (store.rows, harness.read_results(tmp_path / harness.RESULTS, KEYS)):
        assert [(row["index"], row["misfit"]) for row in rows.values()] == [(1, 2.0), (0, 1.0)]


def test_an_unfinished_last_line_is_cut_off(tmp_path):
    harness.Store(tmp_path, WANTED, KEYS).append([recovery(0)])
    with (tmp_path / harness.RESULTS).open("a") as file:
        file.write('{"suite": "clean", "ind')
    store = harness.Store(tmp_path, WANTED, KEYS)
    store.append([recovery(1)])
    assert [row["index"] for row in harness.read_results(tmp_path / harness.RESULTS, KEYS).values()] == [0, 1]


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"seed": 1}, "another seed"),
        ({"split": "validation"}, "another split"),
        ({"suite clean": {"errors": 2}}, "another suite clean"),
        ({"estimator direct": {"noise": 0.1}}, "another estimator direct"),
    ],
)
def test_other_results_are_not_mixed_in(tmp_path, changed, named):
    harness.Store(tmp_path, WANTED, KEYS)
    with pytest.raises(OutputError, match=named):
        harness.Store(tmp_path, WANTED | changed, KEYS)


def test_suites_and_estimators_may_be_added(tmp_path):
    harness.Store(tmp_path, WANTED, KEYS)
    harness.Store(tmp_path, {"seed": 0, "suite 8bit": {"errors": 3}}, KEYS)
    harness.Store(tmp_path, WANTED, KEYS)
    record = json.loads((tmp_path / "run.json").read_text())
    assert {name for name in record if name.startswith("suite")} == {"suite clean", "suite 8bit"}


@pytest.mark.parametrize("name", ["table.csv", "details.csv"])
def test_a_user_s_file_among_the_tables_stays(tmp_path, name):
    (tmp_path / name).write_text("precious")
    report = harness.Report({"table.csv": pd.DataFrame(), "details.csv": pd.DataFrame()})
    with pytest.raises(OutputError, match=rf"{name} is not as this program wrote it; move it away"):
        harness.write(tmp_path, report)
    assert (tmp_path / name).read_text() == "precious"


def test_damaged_results_are_named(tmp_path):
    harness.Store(tmp_path, WANTED, KEYS).append([recovery(0)])
    (tmp_path / "results.jsonl").write_text("[" * 100_000 + "\n")
    with pytest.raises(OutputError, match=r"results.jsonl: line 1 is not a result; remove"):
        harness.Store(tmp_path, WANTED, KEYS)


@pytest.mark.parametrize("content", ["[]", '{"seed": 0}'])
def test_a_folder_of_something_else_is_refused(tmp_path, content):
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(OutputError, match="is not as this program wrote it"):
        harness.Store(tmp_path, WANTED, KEYS)
    assert (tmp_path / "run.json").read_text() == content
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is a file"):
        harness.Store(tmp_path / "file", WANTED, KEYS)


def square(case: tuple[harness.Experiment, tuple[int]]) -> list[harness.Row]:
    """Square of one number; 13 interrupts."""
    _, (number,) = case
    if number == 13:
        raise KeyboardInterrupt
    return [{"number": number} | harness.attempted(lambda: {"value": 1 / number, "array": np.full(2, number)})]


@dataclass(frozen=True)
class Squares(harness.Experiment):
    """Numbers."""

    numbers: tuple[int, ...] = (2, 4)
    """some of them"""
    unit_name: Literal["m", "mm"] = "m"
    """of them"""
    fine: bool = False
    """whether they are"""
    most: Annotated[float, 0, 1] | None = None
    """limit"""

    keys: ClassVar = ("number",)
    work: ClassVar = staticmethod(square)

    def record(self) -> Mapping[str, Any]:
        return {"unit": self.unit_name}

    @property
    def wanted(self) -> list[tuple[int]]:
        return [(number,) for number in self.numbers]

    def report(self, rows: Mapping[tuple, harness.Row]) -> harness.Report:
        found = [rows[number,] for number in self.numbers if (number,) in rows]
        frame = pd.DataFrame([{"number": row["number"], "value": row.get("value")} for row in found])
        return harness.Report({"table.csv": frame}, failed="value" not in found[0])


def measured(*arguments: str) -> int:
    return harness.run(Squares, arguments, "tests.squares", "Squares.")


def test_an_experiment_goes_on_where_it_stopped(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    output = ["--output", str(tmp_path)]
    assert measured(*output, "--numbers", "13") == INTERRUPTED
    assert not (tmp_path / "table.csv").exists()
    assert measured(*output, "--numbers", "2", "13", "3") == INTERRUPTED
    assert "the same command continues" in capsys.readouterr().err
    assert (tmp_path / "table.csv").read_text() == "number,value\n2,0.5\n"
    assert measured(*output, "--numbers", "3", "2") == 0
    assert (tmp_path / "table.csv").read_text() == "number,value\n3,0.333333\n2,0.5\n"
    assert measured(*output, "--unit-name", "mm") == 2
    assert "holds results of another unit" in capsys.readouterr().err
    (tmp_path / "table.csv").write_text("precious")
    assert measured(*output, "--numbers", "5") == 2
    assert "table.csv is not as this program wrote it; move it away" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "table.csv").read_text() == "precious"
    assert (5,) not in harness.read_results(tmp_path / harness.RESULTS, ("number",))  # it was told before the work


def test_a_case_that_breaks_is_a_row(tmp_path: Path) -> None:
    assert measured("--output", str(tmp_path), "--numbers", "0") == 1
    row = harness.read_results(tmp_path / harness.RESULTS, ("number",))[0,]
    assert (row["status"], row["reason"]) == ("error", "ZeroDivisionError: division by zero")
    (row,) = harness.measured(("file", "a.csv", lambda: {"value": 1 / 0}))
    assert row == {"file": "a.csv", "status": "ZeroDivisionError: division by zero"}


def test_cells_that_do_not_exist_are_empty_and_numbers_have_six_digits() -> None:
    frame = pd.DataFrame([{"name": "a, b", "n": 3, "value": 1 / 3}, {"name": None, "n": 4, "value": np.nan}])
    assert harness.csv_of(frame) == 'name,n,value\n"a, b",3,0.333333\n,4,\n'
