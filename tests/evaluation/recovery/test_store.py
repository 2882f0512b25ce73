"""Results on disk: never lost, never mixed."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from evaluation.recovery.output import write_results
from evaluation.recovery.scores import score_all
from evaluation.recovery.store import RESULTS, RecoveryStore, read_results
from results.store import OutputError
from tests.evaluation.recovery_cases import recovery

WANTED = {"seed": 0, "split": "test", "suite clean": {"errors": 1}, "estimator direct": {"noise": None}}


def test_a_result_survives_the_file_and_what_is_not_known_stays_unknown(tmp_path):
    rows = recovery(3), recovery(4, estimate=None, covariance=None, noise=float("nan"))
    RecoveryStore(tmp_path, WANTED).append(rows)
    for again, row in zip(read_results(tmp_path / RESULTS), rows, strict=True):
        for name, value in vars(row).items():
            np.testing.assert_array_equal(getattr(again, name), value)
    assert rows[0].key == ("clean", 3, "direct")
    assert "NaN" not in (tmp_path / RESULTS).read_text()  # other readers of JSON know no such word


def test_what_is_there_is_not_kept_twice(tmp_path):
    store = RecoveryStore(tmp_path, WANTED)
    store.append([recovery(1)])
    store.append([recovery(1), recovery(0)])
    assert [row.index for row in store.rows] == [row.index for row in read_results(tmp_path / RESULTS)] == [1, 0]


def test_a_second_run_finds_the_first_ones_results(tmp_path):
    RecoveryStore(tmp_path, WANTED).append([recovery(0), recovery(1)])
    store = RecoveryStore(tmp_path, WANTED)
    assert store.done == {("clean", 0, "direct"), ("clean", 1, "direct")}
    assert not store.outdated


def test_an_unfinished_last_line_is_cut_off(tmp_path):
    RecoveryStore(tmp_path, WANTED).append([recovery(0)])
    with (tmp_path / RESULTS).open("a") as file:
        file.write('{"suite": "clean", "ind')
    store = RecoveryStore(tmp_path, WANTED)
    store.append([recovery(1)])
    assert [row.index for row in read_results(tmp_path / RESULTS)] == [0, 1]


def test_a_broken_line_is_named(tmp_path):
    RecoveryStore(tmp_path, WANTED).append([recovery(0)])
    (tmp_path / RESULTS).write_text("{}\n")
    with pytest.raises(OutputError, match=r"results\.jsonl: line 1 is not a result"):
        RecoveryStore(tmp_path, WANTED)


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
    RecoveryStore(tmp_path, WANTED)
    with pytest.raises(OutputError, match=named):
        RecoveryStore(tmp_path, WANTED | changed)


def test_suites_and_estimators_may_be_added(tmp_path):
    RecoveryStore(tmp_path, WANTED)
    RecoveryStore(tmp_path, {"seed": 0, "suite 8bit": {"errors": 3}})
    RecoveryStore(tmp_path, WANTED)
    record = json.loads((tmp_path / "run.json").read_text())
    assert {name for name in record if name.startswith("suite")} == {"suite clean", "suite 8bit"}


def test_another_version_of_the_program_is_noticed(tmp_path, monkeypatch):
    RecoveryStore(tmp_path, WANTED).append([recovery(0)])
    monkeypatch.setattr("evaluation.recovery.store.code_digest", lambda: "other")
    assert RecoveryStore(tmp_path, WANTED).outdated


def test_a_line_that_is_none_of_ours_is_not_cut_off(tmp_path):
    RecoveryStore(tmp_path, WANTED).append([recovery(0)])
    for content in ("mine", (tmp_path / RESULTS).read_text() + "mine"):
        (tmp_path / RESULTS).write_text(content)
        with pytest.raises(OutputError, match=r"results\.jsonl: line \d is not a result"):
            RecoveryStore(tmp_path, WANTED)
        assert (tmp_path / RESULTS).read_text() == content


@pytest.mark.parametrize("name", ["table.csv", "details.csv", "figures/bias.png"])
def test_a_user_s_file_among_the_tables_stays(tmp_path, name, monkeypatch):
    monkeypatch.setattr("evaluation.recovery.figures.figures", lambda scores: [("bias.png", Figure((1, 1)))])
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("precious")
    with pytest.raises(OutputError, match=rf"{name} is not as this program wrote it; move it away"):
        write_results(tmp_path, score_all([recovery(0)]))
    assert (tmp_path / name).read_text() == "precious"


@pytest.mark.parametrize("name", ["run.json", "results.jsonl"])
def test_damaged_files_are_named(tmp_path, name):
    RecoveryStore(tmp_path, WANTED).append([recovery(0)])
    (tmp_path / name).write_text("[" * 100_000 + "\n")
    with pytest.raises(OutputError, match=rf"{name}: (is not readable|line 1 is not a result); remove"):
        RecoveryStore(tmp_path, WANTED)


@pytest.mark.parametrize("content", ["[]", '{"seed": 0}'])
def test_a_folder_of_something_else_is_refused(tmp_path, content):
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(OutputError, match="belongs to something else"):
        RecoveryStore(tmp_path, WANTED)
    assert (tmp_path / "run.json").read_text() == content
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is a file"):
        RecoveryStore(tmp_path / "file", WANTED)


def test_a_name_that_no_folder_has_is_a_sentence(tmp_path):
    with pytest.raises(OutputError, match=r"writing failed \(File name too long\); check the output folder or choose"):
        RecoveryStore(tmp_path / ("a" * 300), WANTED)
