"""The benchmark's command: options, resuming, exit status, and one real run."""

import numpy as np
import pytest

from benchmarks.recovery.__main__ import Benchmark, main
from benchmarks.recovery.scores import COLUMNS
from benchmarks.recovery.suites import SUITES
from palpate.common.options import options
from palpate.models.onnx_session import SHIPPED
from tests.benchmarks.recovery_cases import off_by, recovery
from tests.tables import read_rows


@pytest.fixture
def evaluated(monkeypatch):
    """Clips that were evaluated, by a stand-in that does so at once."""
    seen = []

    def evaluate(task):
        seen.append(task.index)
        errors = np.random.default_rng(task.index).normal(0, 0.1, 3)
        return [
            recovery(task.index, suite=suite, estimator=name, estimate=off_by(errors))
            for suite, candidates in task.wanted.items()
            for name in candidates
        ]

    monkeypatch.setattr(Benchmark, "work", staticmethod(evaluate))
    return seen


def run(output, *arguments, clips=6):
    return main(["--output", str(output), "--workers", "0", "--clips", str(clips), *arguments])


def test_tables_are_written(tmp_path, evaluated):
    assert run(tmp_path, "--suite", "clean", "8bit", "--estimator", "direct", "network", "--model", str(SHIPPED)) == 0
    rows = read_rows(tmp_path / "table.csv")
    assert tuple(rows[0]) == COLUMNS
    assert {(row["estimator"], row["suite"]) for row in rows} == {
        (estimator, suite) for estimator in ("direct", "network") for suite in ("clean", "8bit")
    }


def test_a_second_run_does_only_what_is_left(tmp_path, evaluated):
    run(tmp_path)
    assert sorted(evaluated) == [0, 1, 2, 3, 4, 5]
    evaluated.clear()
    assert run(tmp_path) == 0
    assert evaluated == []
    assert run(tmp_path, clips=8) == 0
    assert sorted(evaluated) == [6, 7]
    evaluated.clear()
    run(tmp_path, "--suite", "noisy", clips=2)
    assert sorted(evaluated) == [0, 1]
    assert {row["suite"] for row in read_rows(tmp_path / "table.csv")} == {"noisy"}


def test_failed_clips_are_shown_and_no_error(tmp_path, monkeypatch, evaluated, capsys):
    lost = {"estimate": None, "covariance": None, "field_information": None}

    def evaluate(task):
        status = {} if task.index else {"status": "no contact", "reason": "no onset of contact was found.", **lost}
        return [recovery(task.index, **status)]

    monkeypatch.setattr(Benchmark, "work", staticmethod(evaluate))
    assert run(tmp_path, clips=2) == 0
    assert "clean, clip 0 (under-damped): no contact" in capsys.readouterr().err
    monkeypatch.setattr(
        Benchmark, "work", staticmethod(lambda task: [recovery(task.index, status="no contact", reason="", **lost)])
    )
    assert run(tmp_path / "none", clips=2) == 1
    assert "No clip could be estimated" in capsys.readouterr().err


def test_pictures_of_another_size_are_another_folder_s(tmp_path, evaluated, monkeypatch, capsys):
    sizes, evaluate = [], Benchmark.work

    def measured(task):
        sizes.append(task.size)
        return evaluate(task)

    monkeypatch.setattr(Benchmark, "work", staticmethod(measured))
    assert run(tmp_path, clips=1) == run(tmp_path / "large", "--size", "854x480", clips=1) == 0
    assert sizes == [(214, 120), (854, 480)]
    assert run(tmp_path, "--size", "854x480", clips=1) == 2
    assert "holds results of another size" in capsys.readouterr().err


def test_a_file_that_is_missing_or_no_network_is_refused(tmp_path, capsys):
    (tmp_path / "model.onnx").write_text("no")
    for told, said in (
        (("gan", "--gan-model", "missing.onnx"), "missing.onnx is not a file"),
        (("network", "--model", str(tmp_path / "model.onnx")), "model.onnx"),
    ):
        assert run(tmp_path / "out", "--estimator", *told) == 2
        assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--estimator", "network"), "give its file as --model FILE"),
        (("--gan-model", "x.onnx"), "of no use without --estimator gan"),
        (("--estimator", "gan", "--seen", "press"), "--seen is of no use to gan"),
        (("--suite", "dirty"), "argument --suite: invalid choice: 'dirty' (choose from 'clean', '8bit', 'noisy'"),
        (("--seed", "-1"), "argument --seed: '-1' is not a whole number from 0 to"),
        (("--seed", str(2**32)), "from 0 to 4.29497e+09"),
        (("--clips", "0"), "argument --clips: '0' is not a whole number from 1 to"),
        (("--size", "854"), "854 is no size of pictures; give WIDTHxHEIGHT from 214x120 up"),
        (("--size", "213x120"), "213x120 is no size of pictures"),
        (("--size", "214x119"), "214x119 is no size of pictures"),
        (("--size", "854x480x3"), "854x480x3 is no size of pictures"),
        (("--size", "5000x480"), "5000x480 is no size of pictures"),
        (("--workers", "100000"), "argument --workers: '100000' is not"),
        (("--size=-854x480",), "-854x480 is no size of pictures"),
        (("--size", "８５４x480"), "８５４x480 is no size of pictures"),
        (("--size", "854x4.8e2"), "854x4.8e2 is no size of pictures"),
    ],
)
def test_options_that_take_something_else_or_do_not_belong_together(tmp_path, arguments, sentence, capsys):
    with pytest.raises(SystemExit) as stop:
        run(tmp_path, *arguments)
    assert stop.value.code == 2
    assert sentence in capsys.readouterr().err


def test_all_suites_once_and_in_order():
    arguments = ["--output", "x", "--suite", "noisy", "--suite", "all", "clean"]
    found = options(Benchmark, arguments, "evaluation.benchmark", "")
    assert found.suites == list(SUITES)
    assert list(found.estimators) == ["direct"]


@pytest.mark.acceptance
def test_two_real_clips_in_two_processes(tmp_path):
    arguments = ["--output", str(tmp_path), "--clips", "2", "--workers", "2"]
    assert main([*arguments, "--estimator", "network", "--model", str(SHIPPED)]) == 0
    table = read_rows(tmp_path / "table.csv")
    rows = [row for row in table if row["regime"] == "all" and row["estimator"] == "network"]
    force = next(row for row in rows if row["parameter"] == "force/damping")
    assert force["n"] == "2"
    assert float(force["rmse_log"]) < float(force["constant_rmse_log"])
