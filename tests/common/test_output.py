"""Only files that are as this program wrote them are replaced."""

import json
import os
from pathlib import Path

import pytest

from palpate.common import output
from palpate.common.output import LIST, ForeignFile, replacing_own, require_own


def write(path: Path, text: str) -> None:
    with replacing_own(path) as partial:
        partial.write_text(text)


def test_own_files_are_replaced_again_and_again(tmp_path: Path) -> None:
    for text in ("one", "two", "two", "three"):
        write(tmp_path / "a", text)
        write(tmp_path / "b.csv", text)
        assert (tmp_path / "a").read_text() == (tmp_path / "b.csv").read_text() == text
    assert sorted(path.name for path in tmp_path.iterdir()) == [LIST, "a", "b.csv"]


def changed(path: Path) -> None:
    write(path, "own")
    path.write_text("mine")


def linked(path: Path) -> None:
    write(path, "own")
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


@pytest.mark.parametrize(
    "make",
    [
        lambda path: path.write_text("mine"),
        lambda path: path.write_text(""),
        changed,
        linked,
        Path.mkdir,
        os.mkfifo,
        lambda path: path.symlink_to("nowhere"),
    ],
)
def test_anything_else_is_named_and_stays(tmp_path: Path, make) -> None:
    path = tmp_path / "table.csv"
    make(path)
    before = path.lstat()
    with pytest.raises(ForeignFile, match=r"table\.csv is not as this program wrote it; move it away or choose"):
        write(path, "own")
    with pytest.raises(ForeignFile):
        require_own(path)
    assert path.lstat() == before


def test_a_file_that_appears_while_its_successor_is_written_stays(tmp_path: Path) -> None:
    def write_meanwhile() -> None:
        with replacing_own(tmp_path / "a") as partial:
            partial.write_text("own")
            (tmp_path / "a").write_text("mine")

    with pytest.raises(ForeignFile):
        write_meanwhile()
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "mine"}


@pytest.mark.parametrize("step", range(4))
def test_an_interruption_leaves_what_may_be_replaced(tmp_path, step, monkeypatch) -> None:
    """Twice at the same place, before or after one of the two files takes its place."""
    write(tmp_path / "a", "one")
    replace = os.replace
    for text in ("two", "three"):
        left = [step]

        def interrupted(*paths: Path, left: list[int] = left) -> None:
            for move in (False, True):
                if left[0] == 0:
                    raise KeyboardInterrupt
                left[0] -= 1
                if not move:
                    replace(*paths)

        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", interrupted)
            with pytest.raises(KeyboardInterrupt):
                write(tmp_path / "a", text)
        assert (tmp_path / "a").read_text() == ("one" if step < 3 else text)
    write(tmp_path / "a", "four")
    assert (tmp_path / "a").read_text() == "four"


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"program": "palpate", "files": 1}', "[" * 100_000])
def test_a_list_that_is_none_of_ours_is_named_and_stays(tmp_path: Path, content: str) -> None:
    (tmp_path / LIST).write_text(content)
    with pytest.raises(ForeignFile, match=LIST):
        write(tmp_path / "a", "own")
    assert ([path.name for path in tmp_path.iterdir()], (tmp_path / LIST).read_text()) == ([LIST], content)


@pytest.mark.parametrize("listed", [1, [1, None], {"a": "b"}])
def test_a_list_that_was_changed_owns_nothing(tmp_path: Path, listed: object) -> None:
    (tmp_path / LIST).write_text(json.dumps({"program": "palpate", "files": {"a": listed}}))
    (tmp_path / "a").write_text("mine")
    with pytest.raises(ForeignFile):
        write(tmp_path / "a", "own")


def test_a_huge_file_that_is_none_of_ours_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of 12 GB in no list, or listed and larger than memory: its hash alone, in pieces. Nor is such a list."""
    monkeypatch.setattr(output, "file_sha256", lambda path: pytest.fail("it was read"))
    for name, said in (("a", r"a is not"), (LIST, LIST)):
        with (tmp_path / name).open("wb") as file:
            file.truncate(12 * 2**30)
        with pytest.raises(ForeignFile, match=said):
            require_own(tmp_path / "a")
