"""The door runs what isn't there yet, tables all that was asked for, and refuses what can't be judged."""

from pathlib import Path

import pytest

from benchmarks.online.__main__ import STEP, main
from tests.tables import read_rows

SMALL = ["--sequences", "thin-shell-1", "--starts", "k2", "--frames", "14", "--every", "3"]
SMALL += ["--particles", "64", "--points", "80", "--match", "tracks"]


def test_a_run_goes_on_where_it_was(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    asked = [*SMALL, "--output", str(tmp_path), "--methods", "PBD"]
    assert main(asked) == 0
    path = tmp_path / "results.jsonl"
    (line,) = path.read_text().splitlines()
    assert main([*asked, "PBD-RM", "PBD-RM-ON"]) == 0
    first, *others = path.read_text().splitlines()
    assert (first, len(others)) == (line, 2)
    rows = read_rows(tmp_path / "table.csv")
    assert list(rows[0]) == ["sequence", "start", "method", "measure", "value"]
    assert {row["method"] for row in rows} == {"PBD", "PBD-RM", "PBD-RM-ON"}
    assert all(float(row["value"]) > 0 for row in rows if row["measure"] in ("future gap [mm]", STEP))
    head, *lines = (tmp_path / "table_2.csv").read_text().splitlines()
    assert head == 'method,"thin-shell-1, k2"'
    assert [line.split(",")[0] for line in lines] == ["PBD", "PBD-DiffCloud", "PBD-RM", "PBD-RM-ON"]
    (tmp_path / "table_2.csv").write_text("mine")
    assert main(asked) == 2
    assert "is not as this program wrote it" in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "table_2.csv").read_text() == "mine"


def test_the_paper_s_combination_runs(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Clouds and Adam, as docs/reports/online.md names the command."""
    asked = [*SMALL, "--match", "chamfer", "--optimizer", "adam", "--methods", "PBD", "PBD-RM-ON"]
    assert main([*asked, "--output", str(tmp_path)]) == 0
    out = " ".join(capsys.readouterr().err.split())
    assert "Matched: chamfer; adam." in out
    rows = read_rows(tmp_path / "table.csv")
    ranks = {row["method"]: row["value"] for row in rows if row["measure"] == "rank correlation of distances"}
    assert ranks["PBD"] == ""  # of a uniform field there is none
    assert -1 <= float(ranks["PBD-RM-ON"]) <= 1


def test_too_few_frames_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--output", str(tmp_path / "out"), "--frames", "14"])
    assert ended.value.code == 2
    assert "leaves no prediction 10 frames ahead within 14 frames" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        (["--sequences", "volume-1", "--particles", "64"], "--particles: 64 is less than 68"),
        (["--match", "chamfer"], "--match chamfer tells Gauss–Newton's steps nothing; give --optimizer adam, or both"),
    ],
)
def test_what_cannot_be_held_or_learnt_is_refused(tmp_path: Path, capsys, asked, sentence) -> None:
    with pytest.raises(SystemExit):
        main(["--output", str(tmp_path / "out"), *asked])
    assert sentence in " ".join(capsys.readouterr().err.split())
