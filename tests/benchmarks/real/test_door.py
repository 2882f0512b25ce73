"""`python -m benchmarks.real` as a user runs it: what it writes, how it ends, and what it says."""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.harness import Row, write
from benchmarks.real.__main__ import KNOWN, PulledClip, Real, evaluate_pull, main
from palpate.common.options import options
from palpate.common.output import LIST
from tests.benchmarks.real_clips import pull_clip
from tests.tables import read_measures

STILL = np.zeros(9)
PULLED = np.linspace(0, 3, 9)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two pulls, and a clip where nothing moves."""
    folder = tmp_path_factory.mktemp("inputs")
    for name, shares in {"pull": PULLED, "other": PULLED, "still": STILL}.items():
        pull_clip(folder / name, shares)
    return folder


judged = functools.cache(evaluate_pull)
"""Judgement of a clip, however often a door asks for it."""


def twin(clip: PulledClip) -> PulledClip:
    """Clip of the same pictures: `other` is drawn as `pull` is."""
    same = {name: getattr(clip, name) for name in ("path", "layout_file")}
    return replace(clip, **{name: path.with_name(path.name.replace("other", "pull")) for name, path in same.items()})


def evaluate_once(clip: PulledClip) -> Row:
    return judged(twin(clip))


@pytest.fixture(autouse=True)
def judging_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.real.__main__.evaluate_pull", evaluate_once)


def pulled(inputs: Path, name: str) -> list[str]:
    return ["--pulled", str(inputs / name), "--layout", str(inputs / f"{name}.yaml")]


def known(monkeypatch: pytest.MonkeyPatch, inputs: Path, *names: str) -> list[str]:
    """Clips below the data's folder."""
    clips = {name: PulledClip(Path(name), inputs / f"{name}.yaml") for name in names}
    monkeypatch.setattr("benchmarks.real.__main__.KNOWN", clips)
    return ["--data", str(inputs)]


def rows(output: Path) -> dict[str, dict[str, str]]:
    """Values by clip and measure."""
    found: dict[str, dict[str, str]] = {}
    for (clip, measure), value in read_measures(output / "table.csv").items():
        found.setdefault(clip, {})[measure] = value
    return found


def test_two_known_clips_are_judged(inputs, tmp_path, monkeypatch, capsys) -> None:
    assert main([*known(monkeypatch, inputs, "pull", "other", "absent"), "--output", str(tmp_path)]) == 0
    found = rows(tmp_path)
    assert list(found) == ["pull", "other"]
    for each in found.values():
        assert each["status"] == "ok"
        assert float(each["skill in frames kept back"]) > 0.5
    assert {path.name for path in tmp_path.iterdir()} == {LIST, "results.jsonl", "run.json", "table.csv"}
    told = capsys.readouterr()
    assert f"written: {tmp_path}/table.csv" in told.err
    assert "skill in frames kept back" in told.out


def test_masks_of_a_pulled_clip_are_those_that_are_given(inputs, tmp_path) -> None:
    outlines = tmp_path / "outlines.yaml"
    outlines.write_text("0: []\n")  # no instrument is in view
    assert main([*pulled(inputs, "other"), "--masks", str(outlines), "--output", str(tmp_path / "found")]) == 1
    assert rows(tmp_path / "found")["other"]["status"] == "No run of contact was found."


def test_a_clip_where_nothing_moves_is_a_sentence_and_the_other_is_judged(inputs, tmp_path, monkeypatch, capsys):
    assert main([*known(monkeypatch, inputs, "still", "pull"), "--output", str(tmp_path)]) == 1
    sentence = "In 0 of 8 frames the tissue moves with the instrument by more than 1 px"
    found = rows(tmp_path)
    contact = [f"contact_frame_{index:04d}" for index in range(9)]
    assert list(found["still"]) == ["status", "frames", "frames in contact", *contact]
    assert all(0.5 < float(found["still"][name]) < 0.9 for name in contact)  # nothing moves: outlines decide
    assert sentence in found["still"]["status"]
    assert found["pull"]["status"] == "ok"
    told = capsys.readouterr().err
    assert told.count(f"still: {found['still']['status']}") == 1
    assert "Traceback" not in told


def test_what_nobody_expected_of_a_clip_is_a_sentence_and_the_other_is_judged(inputs, tmp_path, monkeypatch, capsys):
    def fail(clip: PulledClip) -> Row:
        if clip.path.name == "pull":
            raise ZeroDivisionError("of something")
        return evaluate_once(clip)

    monkeypatch.setattr("benchmarks.real.__main__.evaluate_pull", fail)
    assert main([*known(monkeypatch, inputs, "pull", "other"), "--output", str(tmp_path)]) == 1
    found = rows(tmp_path)
    assert found["pull"]["status"] == "ZeroDivisionError: of something"
    assert found["other"]["status"] == "ok"
    assert "pull: ZeroDivisionError" in capsys.readouterr().err


def test_a_clip_that_can_t_be_read_is_a_sentence(inputs: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main([*pulled(inputs, "other")[:3], str(inputs / "no.yaml"), "--output", str(tmp_path)]) == 1
    assert "no.yaml" in rows(tmp_path)["other"]["status"]
    assert "other: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "there is nothing to judge. Give --data or --pulled."),
        (["--data", "{empty}"], "{empty} holds none of " + ", ".join(KNOWN)),
        (["--layout", "a.yaml"], "--layout a.yaml is of a clip of --pulled; give both, or leave it out."),
        (["--masks", "a.yaml"], "--masks a.yaml is of a clip of --pulled; give both, or leave it out."),
    ],
)
def test_wrong_usage_is_a_sentence(tmp_path, capsys, arguments, told) -> None:
    """And nothing is written."""
    output, empty = tmp_path / "out", tmp_path
    with pytest.raises(SystemExit) as stop:
        main([*(each.format(empty=empty) for each in arguments), "--output", str(output)])
    assert stop.value.code == 2
    assert told.format(empty=empty) in " ".join(capsys.readouterr().err.split())
    assert not output.exists()


def test_names_and_numbers_are_written_as_they_are(tmp_path: Path) -> None:
    """What is a table's syntax stays text, and what is not a number is empty."""
    real = chosen(tmp_path, "--pulled", "a|b <i>")
    report = real.report({("a|b <i>",): {"clip": "a|b <i>", "status": "ok", "one": 1 / 3, "two": float("nan")}})
    write(tmp_path, report)
    lines = (tmp_path / "table.csv").read_text().splitlines()
    assert lines == ["clip,measure,value", "a|b <i>,status,ok", "a|b <i>,one,0.333333", "a|b <i>,two,"]


def chosen(output: Path, *arguments: str) -> Real:
    return options(Real, ["--output", str(output), *arguments], "benchmarks.real", "")
