"""Files that appear complete or not at all, and reading that neither waits nor goes on for ever."""

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest

from palpate.common.files import all_below, as_json, digest_of, file_sha256, read_file, replacing


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("earlier")
    return path


def test_a_file_takes_its_place_when_it_is_complete(table):
    with replacing(table) as partial:
        partial.write_text("new")
        assert (table.read_text(), partial.suffix) == ("earlier", ".csv")
    assert {path.name: path.read_text() for path in table.parent.iterdir()} == {"table.csv": "new"}


@pytest.mark.parametrize("reason", [OSError("full"), KeyboardInterrupt()])
def test_what_fails_half_way_leaves_the_earlier_file_and_nothing_else(table, reason):
    def write():
        with replacing(table) as partial:
            partial.write_text("half")
            raise reason

    with pytest.raises(type(reason)):
        write()
    assert {path.name: path.read_text() for path in table.parent.iterdir()} == {"table.csv": "earlier"}


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (os.mkfifo, "no file but a pipe or a device"),
        (lambda path: path.symlink_to("/dev/zero"), "no file but a pipe or a device"),
        (lambda path: path.symlink_to(path.name), "symbolic links"),
        (lambda path: path.mkdir(), "Is a directory"),
        (lambda path: path.write_bytes(b"x" * 2049), "larger than 2 kB"),
    ],
    ids=["pipe", "device", "loop", "folder", "large"],
)
def test_only_a_file_of_a_reasonable_size_is_read(tmp_path, make, said):
    make(tmp_path / "it")
    with pytest.raises(OSError, match=said):
        read_file(tmp_path / "it", 2048)
    (tmp_path / "file").write_bytes(b"x" * 2048)
    assert read_file(tmp_path / "file", 2048) == b"x" * 2048


def test_a_hash_is_that_of_the_content_and_waits_for_nothing(tmp_path):
    (tmp_path / "file").write_bytes(b"abc")
    # FIPS 180-2, appendix B.1.
    assert file_sha256(tmp_path / "file") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="no file but a pipe"):
        file_sha256(tmp_path / "pipe")


@pytest.mark.parametrize("name", ["d", "a folder whose path gets too long"])
def test_all_is_found_however_deeply_folders_nest(tmp_path, monkeypatch, nested, name):
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "2").touch()
    (tmp_path / "b" / "1").touch()
    (tmp_path / "b" / "round").symlink_to(tmp_path)
    (tmp_path / "b" / "self").symlink_to("self")
    before = sorted(tmp_path.rglob("*"))
    assert all_below(tmp_path) == before
    monkeypatch.chdir(tmp_path)
    assert all_below(Path("b")) == [Path("b") / each for each in ("1", "2", "round", "self")]
    nested(tmp_path / "b", name)
    found = all_below(tmp_path)
    assert set(before) <= set(found)
    assert len(found) > len(before) + 90
    assert [path for path in found if path.is_file()] == [tmp_path / "b" / "1", tmp_path / "b" / "2"]


def test_json_has_null_for_what_is_not_finite_and_lists_for_arrays():
    value = {"modulus": np.float64(4.6e9), "interval": (0.0, math.inf), "count": np.int64(3), "text": "Infinity"}
    expected = {"modulus": 4.6e9, "interval": [0.0, None], "count": 3, "text": "Infinity"}
    value["covariance"], expected["covariance"] = np.array([[1.0, np.nan], [-np.inf, 2.0]]), [[1.0, None], [None, 2.0]]
    # `fail` ends the test at NaN and Infinity, which are no JSON.
    assert json.loads(as_json(value, indent=1), parse_constant=pytest.fail) == expected


def test_digests_tell_what_is_not_finite_from_nothing():
    assert digest_of({"a": 1, "b": [2]}) == digest_of({"b": [2], "a": 1})
    assert len({digest_of([value]) for value in (None, math.inf, -math.inf, math.nan, 0.0)}) == 5
