"""`python -m evaluation.real` as a user runs it: what it writes, how it ends, and what it says."""

from __future__ import annotations

import base64
import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.common.output import LIST
from palpate.evaluation.harness import options, write
from palpate.evaluation.real.__main__ import KNOWN, Real, main
from palpate.evaluation.real.pulled import PulledClip
from tests.evaluation.real_clips import LAYOUT, pull_clip, ramp, write_press, write_wrench

FACTOR = 0.35
STILL = np.zeros(9)
PULLED = np.linspace(0, 3, 13)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pull, a clip where nothing moves, and a press."""
    folder = tmp_path_factory.mktemp("inputs")
    pull_clip(folder / "pull", PULLED)
    pull_clip(folder / "still", STILL)
    write_press(folder / "press", ramp(90))
    write_wrench(folder / "wrench.csv", FACTOR * ramp(90) + np.random.default_rng(0).normal(0, 0.01, 90))
    return folder


def pulled(inputs: Path, name: str) -> list[str]:
    return ["--pulled", str(inputs / name), "--layout", str(inputs / f"{name}.yaml")]


def pressed(inputs: Path, wrench: str = "wrench.csv") -> list[str]:
    return ["--pressed", str(inputs / "press"), "--wrench", str(inputs / wrench)]


def rows(output: Path) -> dict[str, dict[str, str]]:
    """Values by clip and measure."""
    with (output / "table.csv").open(encoding="utf-8", newline="") as file:
        table = csv.DictReader(file)
        assert tuple(table.fieldnames or ()) == ("clip", "measure", "value")
        found: dict[str, dict[str, str]] = {}
        for row in table:
            found.setdefault(row["clip"], {})[row["measure"]] = row["value"]
    return found


def test_two_clips_are_judged(inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main([*pulled(inputs, "pull"), *pressed(inputs), "--output", str(tmp_path)]) == 0
    found = rows(tmp_path)
    assert list(found) == ["pull", "press"]
    assert found["pull"]["status"] == found["press"]["status"] == "ok"
    assert float(found["pull"]["skill in frames kept back"]) > 0.5
    assert float(found["press"]["force over dent [N/mm]"]) == pytest.approx(FACTOR, rel=0.01)
    assert found["press"]["damping time"] == "not determined"
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Not a medical device" in page
    assert "<td>force over dent [N/mm]</td>" in page
    for name in ("1.png", "2.png"):
        content = (tmp_path / "figures" / name).read_bytes()
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        assert picture.std() > 10
        assert f"data:image/png;base64,{base64.b64encode(content).decode()}" in page
    assert 'src="1.png"' not in page
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        LIST,
        "figures",
        "report.html",
        "results.jsonl",
        "run.json",
        "table.csv",
    ]
    told = capsys.readouterr()
    assert f"written: {tmp_path}/table.csv, report.html, figures/" in told.err
    assert "force over dent" in told.out


def test_an_interruption_keeps_what_is_finished(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("palpate.evaluation.real.__main__.evaluate_press", interrupt)
    assert main([*pulled(inputs, "pull"), *pressed(inputs), "--output", str(tmp_path / "part")]) == 130
    assert list(rows(tmp_path / "part")) == ["pull"]
    assert "Interrupted; what is finished is kept" in capsys.readouterr().err
    assert main([*pressed(inputs), "--output", str(tmp_path / "nothing")]) == 130
    assert not (tmp_path / "nothing" / "table.csv").exists()


def test_a_clip_where_nothing_moves_is_a_sentence_and_the_other_is_judged(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    assert main([*pulled(inputs, "still"), *pressed(inputs), "--output", str(tmp_path)]) == 1
    sentence = "In 0 of 8 frames the tissue moves with the instrument by more than 1 px"
    found = rows(tmp_path)
    contact = [f"contact_frame_{index:04d}" for index in range(9)]
    assert list(found["still"]) == ["status", "frames", "frames in contact", *contact]
    assert sentence in found["still"]["status"]
    assert float(found["press"]["force over dent [N/mm]"]) == pytest.approx(FACTOR, rel=0.01)
    assert [path.name for path in (tmp_path / "figures").glob("*.png")] == ["1.png"]
    assert sentence in (tmp_path / "report.html").read_text(encoding="utf-8")
    told = capsys.readouterr().err
    assert told.count(f"still: {found['still']['status']}") == 1
    assert "Traceback" not in told


def test_what_nobody_expected_of_a_clip_is_a_sentence_and_the_other_is_judged(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("of something")

    monkeypatch.setattr("palpate.evaluation.real.__main__.evaluate_pull", fail)
    assert main([*pulled(inputs, "pull"), *pressed(inputs), "--output", str(tmp_path)]) == 1
    found = rows(tmp_path)
    told = "unexpected ZeroDivisionError (of something); please report it with the clip."
    assert found["pull"]["status"] == told
    assert found["press"]["status"] == "ok"
    assert "pull: unexpected ZeroDivisionError" in capsys.readouterr().err


def test_a_clip_that_can_t_be_read_is_a_sentence(inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main([*pressed(inputs, "no.csv"), "--output", str(tmp_path)]) == 1
    assert "no.csv is no table of forces" in rows(tmp_path)["press"]["status"]
    assert "press: " in capsys.readouterr().err
    assert (tmp_path / "report.html").is_file()
    assert not (tmp_path / "figures").exists()


def test_known_clips_are_found_below_a_folder(inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = tmp_path / "data"
    data.mkdir()
    (data / "recover_tissue").symlink_to(inputs / "pull")
    layout = tmp_path / "layout.yaml"
    layout.write_text(LAYOUT)
    monkeypatch.setitem(KNOWN, "recover_tissue", PulledClip(Path("recover_tissue"), layout))
    (data / "pressed_membrane").symlink_to(inputs / "press")
    for rows_known in (73, 90):
        write_wrench(inputs / "press" / f"wrench_{rows_known}.csv", FACTOR * ramp(rows_known))
    assert main(["--data", str(data), "--output", str(tmp_path / "out")]) == 0
    found = rows(tmp_path / "out")
    assert list(found) == ["recover_tissue", "pressed_membrane, wrench_73", "pressed_membrane, wrench_90"]
    assert float(found["recover_tissue"]["skill in frames kept back"]) > 0.5
    judged = [found[f"pressed_membrane, wrench_{known}"]["frames judged"] for known in (73, 90)]
    assert judged == ["67 to 72", "73 to 89"]
    assert len(list((tmp_path / "out" / "figures").glob("*.png"))) == 3


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "there is nothing to judge. Give --data, --pulled or --pressed."),
        (["--data", "{empty}"], "{empty} holds none of " + ", ".join([*KNOWN, "pressed_membrane"])),
        (["--layout", "a.yaml"], "--layout a.yaml is of a clip of --pulled; give both, or leave it out."),
        (["--pressed", "a"], "--pressed and --wrench belong together; give both."),
        (["--wrench", "a.csv"], "--pressed and --wrench belong together; give both."),
    ],
)
def test_wrong_usage_is_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture, arguments: list[str], told: str
) -> None:
    """And nothing is written."""
    output, empty = tmp_path / "out", tmp_path
    with pytest.raises(SystemExit) as stop:
        main([*(each.format(empty=empty) for each in arguments), "--output", str(output)])
    assert stop.value.code == 2
    assert told.format(empty=empty) in " ".join(capsys.readouterr().err.split())
    assert not output.exists()


def test_an_output_that_can_t_be_written_is_a_sentence(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "file").write_text("")
    assert main([*pressed(inputs), "--output", str(tmp_path / "file")]) == 2
    told = capsys.readouterr().err
    assert "is a file; give a folder as --output" in told
    assert "written:" not in told


@pytest.mark.parametrize("name", ["table.csv", "report.html", "figures/1.png"])
def test_a_user_s_file_in_the_output_is_named_before_the_work_and_stays(
    inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture, name: str
) -> None:
    path = tmp_path / "out" / name
    path.parent.mkdir(parents=True)
    path.write_text("precious")
    command = [*pressed(inputs), "--output", str(tmp_path / "out")]
    assert main(command) == 2
    said = f"{path} is not as this program wrote it; move it away or choose another place."
    assert said in " ".join(capsys.readouterr().err.replace("\n", "").split()).replace("- ", "-")
    assert [each for each in (tmp_path / "out").rglob("*") if each.is_file()] == [path]
    assert path.read_text() == "precious"
    path.unlink()
    assert main(command) == main(command) == 0  # its own are replaced


def test_names_and_numbers_are_written_as_they_are(tmp_path: Path) -> None:
    """What is a table's or a page's syntax stays text, and what is not a number is empty."""
    real = chosen(tmp_path, "--pulled", "a|b <i>")
    report = real.report({("a|b <i>",): {"clip": "a|b <i>", "status": "ok", "one": 1 / 3, "two": float("nan")}})
    write(tmp_path, report)
    lines = (tmp_path / "table.csv").read_text().splitlines()
    assert lines == ["clip,measure,value", "a|b <i>,status,ok", "a|b <i>,one,0.333333", "a|b <i>,two,"]
    page = (tmp_path / "report.html").read_text()
    assert "<td>a|b &lt;i&gt;</td>" in page
    assert "<td>0.333</td>" in page


def test_two_clips_of_one_name_are_both_judged(tmp_path: Path) -> None:
    real = chosen(tmp_path, "--pulled", "a/clip", "--pressed", "b/clip", "--wrench", "w.csv")
    assert [case.name for case in real.asked] == ["clip", "clip (2)"]


def chosen(output: Path, *arguments: str) -> Real:
    return options(Real, ["--output", str(output), *arguments], "evaluation.real", "")
