"""Which folder is whose, which clips are done, and what is said when nothing can be written."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation import result_store
from evaluation.result_store import OVERLAY, RECORD, SUMMARY, TABLE, OutputError, ResultStore, safe_name

FILES = (TABLE, SUMMARY, RECORD)


def write_results(folder: Path, fingerprint: str = "abc", origin: str = "clip.mp4", *, overlay: bool = True) -> None:
    folder.mkdir(parents=True)
    for name in (TABLE, SUMMARY) + ((OVERLAY,) if overlay else ()):
        (folder / name).write_text("")
    record = {"program": "infer.py", "fingerprint": fingerprint, "input": {"path": origin}}
    (folder / RECORD).write_text(json.dumps(record))


@given(st.text(max_size=300))
def test_safe_names_fit_every_file_system(name: str) -> None:
    safe = safe_name(name)
    assert 0 < len(safe.encode()) <= 120
    assert not set(safe) & set('<>:"/\\|?*\0')
    assert safe not in (".", "..")
    assert safe == safe_name(safe)


def test_long_names_stay_apart_and_other_scripts_stay_readable() -> None:
    assert safe_name("é" * 200 + "a") != safe_name("é" * 200 + "b")
    assert safe_name("肝臓 vidéo 1") == "肝臓 vidéo 1"


def test_completeness_asks_for_the_same_fingerprint_and_files(tmp_path: Path) -> None:
    store = ResultStore(tmp_path, "infer.py")
    folder = store.folder("clip", tmp_path / "in" / "clip.mp4")
    assert not store.is_complete(folder, "abc", FILES)
    write_results(folder, "abc", overlay=False)
    assert store.is_complete(folder, "abc", FILES)
    assert not store.is_complete(folder, "abc", (*FILES, OVERLAY))
    assert not store.is_complete(folder, "other", FILES)
    (folder / "run.json").write_text("{")
    assert not store.is_complete(folder, "abc", FILES)


def test_clips_of_one_name_get_folders_of_their_own(tmp_path: Path) -> None:
    store = ResultStore(tmp_path / "out", "infer.py")
    first, second = tmp_path / "a" / "clip.mp4", tmp_path / "b" / "Clip.mp4"
    assert store.folder("clip", first).name == "clip"
    marked = store.folder("Clip", second).name
    assert marked.startswith("Clip-")
    write_results(tmp_path / "out" / "clip", origin=str(first.resolve()))
    write_results(tmp_path / "out" / marked, origin=str(second.resolve()))
    # A later run in another order finds each clip's own folder again.
    later = ResultStore(tmp_path / "out", "infer.py")
    assert later.folder("Clip", second).name == marked
    assert later.folder("clip", first).name == "clip"


def test_a_folder_that_is_not_ours_is_never_replaced(tmp_path: Path) -> None:
    frames = tmp_path / "clip"
    frames.mkdir()
    (frames / "frame_1.png").write_bytes(b"precious")
    folder = ResultStore(tmp_path, "infer.py").folder("clip", frames)
    assert folder != frames
    folder.mkdir()
    (folder / "mine.txt").write_text("precious")
    with pytest.raises(OutputError, match="holds something else"):
        ResultStore(tmp_path, "infer.py").folder("clip", frames)


def test_results_of_another_program_are_never_replaced(tmp_path: Path) -> None:
    clip = tmp_path / "clip.mp4"
    write_results(tmp_path / "out" / "clip", origin=str(clip.resolve()))
    assert ResultStore(tmp_path / "out", "infer.py").folder("clip", clip).name == "clip"
    marked = ResultStore(tmp_path / "out", "estimate.py").folder("clip", clip).name
    assert marked.startswith("clip-")
    # A later run finds its own again.
    write_results(tmp_path / "out" / marked, origin=str(clip.resolve()))
    (tmp_path / "out" / marked / RECORD).write_text(
        json.dumps({"program": "estimate.py", "input": {"path": str(clip.resolve())}})
    )
    assert ResultStore(tmp_path / "out", "estimate.py").folder("clip", clip).name == marked
    assert ResultStore(tmp_path / "out", "infer.py").folder("clip", clip).name == "clip"


def test_output_that_is_a_file_or_cannot_be_written(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(OutputError, match="is a file; give a folder"):
        ResultStore(file, "infer.py")
    with pytest.raises(OutputError, match="choose another --output"):
        ResultStore(file / "below", "infer.py")


@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.ENOSPC, "is full; free"), (errno.EROFS, "change its permissions"), (errno.EIO, "writing failed")],
)
def test_file_system_errors_become_one_sentence(tmp_path: Path, number: int, words: str) -> None:
    with pytest.raises(OutputError, match=words) as caught, result_store.writing(tmp_path):
        raise OSError(number, os.strerror(number))
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)
