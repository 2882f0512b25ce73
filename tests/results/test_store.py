"""Which folder is whose, which clips are done, and what is said when nothing can be written."""

import errno
import itertools
import json
import os
import tempfile
from collections.abc import Callable, Container, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.results import store as results

FILES = (results.TABLE, results.FIT, results.RECORD)


def write_results(folder: Path, fingerprint: str = "abc", origin: str = "clip.mp4", *, overlay: bool = True) -> None:
    folder.mkdir(parents=True)
    for name in (results.TABLE, results.FIT) + ((results.OVERLAY,) if overlay else ()):
        (folder / name).write_text(f"{name} of {fingerprint}")
    results.write_record(folder, {"program": "infer.py", "fingerprint": fingerprint, "input": {"path": origin}})


@settings(max_examples=40)
@given(st.text(max_size=300))
def test_safe_names_fit_every_file_system(name: str) -> None:
    safe = results.safe_name(name)
    assert 0 < len(safe.encode()) <= 120
    assert not set(safe) & set('<>:"/\\|?*\0')
    assert safe not in (".", "..")
    assert safe == results.safe_name(safe)


def test_long_names_stay_apart_and_other_scripts_stay_readable() -> None:
    assert results.safe_name("é" * 200 + "a") != results.safe_name("é" * 200 + "b")
    assert results.safe_name("肝臓 vidéo 1") == "肝臓 vidéo 1"


def is_complete(folder: Path, fingerprint: str = "abc", files: tuple[str, ...] = FILES) -> bool:
    return results.is_up_to_date(folder, fingerprint, files, overwrite=False)


def test_completeness_asks_for_the_same_fingerprint_and_files(tmp_path: Path) -> None:
    folder = results.ResultStore(tmp_path).folder("clip", tmp_path / "in" / "clip.mp4")
    assert not is_complete(folder)
    write_results(folder, "abc", overlay=False)
    assert is_complete(folder)
    assert not results.is_up_to_date(folder, "abc", FILES, overwrite=True)
    assert not is_complete(folder, files=(*FILES, results.OVERLAY))


def test_an_emptied_table_is_not_complete_and_may_be_written_again(tmp_path: Path) -> None:
    folder = tmp_path / "clip"
    write_results(folder)
    (folder / results.TABLE).write_text("")
    assert not is_complete(folder)
    (folder / results.TABLE).write_text("edited")
    for overwrite in (False, True):
        with pytest.raises(results.OutputError, match=r"parameters.csv: is not as this program wrote it; move it away"):
            results.is_up_to_date(folder, "abc", FILES, overwrite=overwrite)


def test_other_results_are_replaced_only_when_asked(tmp_path: Path) -> None:
    folder = tmp_path / "clip"
    write_results(folder)
    assert not results.is_up_to_date(folder, "other", FILES, overwrite=True)
    with pytest.raises(results.OutputError, match=r"holds results of other settings.*--overwrite replaces them"):
        is_complete(folder, "other")


@pytest.mark.parametrize(
    "change",
    [
        {"input": ["clip.mp4"]},
        {"input": "clip.mp4"},
        {"program": 1},
        {"program": "estimate.py"},
        {"fingerprint": ["abc"]},
        {"files": 3},
        {"statuses": [1]},
        {"contacts": "many"},
    ],
)
def test_a_record_of_odd_types_is_nobody_s(tmp_path: Path, change: dict[str, Any]) -> None:
    clip = tmp_path / "clip.mp4"
    folder = tmp_path / "out" / "clip"
    write_results(folder, origin=str(clip.resolve()))
    (folder / results.RECORD).write_text(json.dumps(results.read_record(folder) | change))
    assert results.read_record(folder) == {}
    with pytest.raises(results.OutputError, match="is not as this program wrote it"):
        is_complete(folder)
    assert results.ResultStore(tmp_path / "out").folder("clip", clip).name.startswith("clip-")


# --- whatever happens, what a user put there stays ---

DEAD = 2**22 + 1
"""Above the largest process id of Linux."""
SCENE = "scene_4.vtp"
PLACES = ("clip", ".", f".clip.partial-{DEAD}", f".clip.partial-{os.getpid()}", ".clip.old-1", "clip/sub")
NAMES = (results.TABLE, results.OVERLAY, results.RECORD, results.FIT, "notes.txt", ".a", SCENE)
RUNS = st.tuples(
    st.just("run"),
    st.sampled_from(("first", "second")),  # settings
    st.booleans(),  # with an overlay
    st.booleans(),  # --overwrite
    st.sampled_from((None, *range(12))),  # which step is interrupted
    st.booleans(),  # by a kill, which cleans nothing up
)
PUTS = st.tuples(st.just("put"), st.sampled_from(PLACES), st.sampled_from(NAMES), st.sampled_from(("mine", "{}")))


class Interrupted(BaseException):
    """Ctrl-C or a kill."""


def interrupted_at(step: int | None) -> Iterator[None]:
    """Every `next` is a step of a run, and this one raises."""
    for number in itertools.count():
        if number == step:
            raise Interrupted
        yield


def run_once(output: Path, clip: Path, fingerprint: str, overlay: bool, overwrite: bool, steps: Iterator[None]) -> Path:
    """What a door does with a clip, with files that tell their settings."""
    names = (SCENE, results.TABLE, results.FIT, *((results.OVERLAY,) if overlay else ()))
    folder = results.ResultStore(output).folder("clip", clip)
    if results.is_up_to_date(folder, fingerprint, (*names, results.RECORD), overwrite=overwrite):
        return folder
    with results.writing(output):
        partial = results.partial_folder(folder)
        for name in names:
            next(steps)
            (partial / name).write_text(f"{name} of {fingerprint}")
        results.write_record(partial, {"program": "infer.py", "fingerprint": fingerprint, "input": {"path": str(clip)}})
        next(steps)
        results.publish(partial, folder)
    return folder


def is_whole(folder: Path, theirs: Container[Path]) -> bool:
    """Whether every file that is not the user's is of the record's settings."""
    record = results.read_record(folder)
    made = [name for name in results.own_files(folder) if name != results.RECORD and folder / name not in theirs]
    return all((folder / name).read_text() == f"{name} of {record['fingerprint']}" for name in made)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.one_of(RUNS, PUTS), min_size=2, max_size=8))
def test_no_order_of_runs_interruptions_and_foreign_files_changes_a_user_s_file(events: list[tuple]) -> None:
    replace, unlink = os.replace, Path.unlink
    with tempfile.TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        output, clip = Path(name).resolve() / "out", Path(name).resolve() / "clip.mp4"
        theirs: dict[Path, bytes] = {}
        steps = interrupted_at(None)
        # Every change on the disk is a step, too.
        patch.setattr(results.os, "replace", lambda *paths: (next(steps, None), replace(*paths)))
        patch.setattr(Path, "unlink", lambda path, **options: (next(steps, None), unlink(path, **options)))
        for kind, *event in events:
            if kind == "put":
                place, file, content = event
                path = output / place / file
                if (path.parent / results.MARKER).exists():
                    continue  # all in a hidden folder is this program's
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(content)
                theirs[path] = content.encode()
            else:
                fingerprint, overlay, overwrite, step, killed = event
                steps = interrupted_at(step)
                folder = None
                with suppress(results.OutputError, Interrupted):
                    folder = run_once(output, clip, fingerprint, overlay, overwrite, steps)
                steps = interrupted_at(None)
                own = output / f".clip.partial-{os.getpid()}"
                if killed and (own / results.MARKER).exists() and not (output / f".clip.partial-{DEAD}").exists():
                    replace(own, output / f".clip.partial-{DEAD}")
                    for path in [path for path in theirs if path.parent == own]:
                        theirs[output / f".clip.partial-{DEAD}" / path.name] = theirs.pop(path)
                elif output.exists():
                    with suppress(results.OutputError):
                        results.settle(output / "clip")
                    assert is_whole(output / "clip", theirs)
                if folder is not None:
                    assert results.read_record(folder)["fingerprint"] == fingerprint
                    assert is_whole(folder, theirs)
            assert {path: path.read_bytes() for path in theirs if path.exists()} == theirs


def test_clips_of_one_name_get_folders_of_their_own(tmp_path: Path) -> None:
    store = results.ResultStore(tmp_path / "out")
    first, second = tmp_path / "a" / "clip.mp4", tmp_path / "b" / "Clip.mp4"
    assert store.folder("clip", first).name == "clip"
    marked = store.folder("Clip", second).name
    assert marked.startswith("Clip-")
    write_results(tmp_path / "out" / "clip", origin=str(first.resolve()))
    write_results(tmp_path / "out" / marked, origin=str(second.resolve()))
    # A later run in another order finds each clip's own folder again.
    later = results.ResultStore(tmp_path / "out")
    assert later.folder("Clip", second).name == marked
    assert later.folder("clip", first).name == "clip"


def test_a_folder_that_is_not_ours_is_never_replaced(tmp_path: Path) -> None:
    frames = tmp_path / "clip"
    frames.mkdir()
    (frames / "frame_1.png").write_bytes(b"precious")
    folder = results.ResultStore(tmp_path).folder("clip", frames)
    assert folder != frames
    folder.mkdir()
    (folder / "mine.txt").write_text("precious")
    with pytest.raises(results.OutputError, match="holds something else"):
        results.ResultStore(tmp_path).folder("clip", frames)


def test_output_that_is_a_file_or_cannot_be_written(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(results.OutputError, match="is a file; give a folder"):
        results.ResultStore(file)
    with pytest.raises(results.OutputError, match="choose another --output"):
        results.ResultStore(file / "below")


@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.ENOSPC, "is full; free"), (errno.EROFS, "change its permissions"), (errno.EIO, "writing failed")],
)
def test_file_system_errors_become_one_sentence(tmp_path: Path, number: int, words: str) -> None:
    with pytest.raises(results.OutputError, match=words) as caught, results.writing(tmp_path):
        raise OSError(number, os.strerror(number))
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), lambda path: path.write_text("[1]")]
)
def test_a_record_that_is_no_file_is_not_read(tmp_path: Path, make: Callable[[Path], None]) -> None:
    (tmp_path / "clip").mkdir()
    make(tmp_path / "clip" / results.RECORD)
    assert results.read_record(tmp_path / "clip") == {}
    taken = results.ResultStore(tmp_path).folder("clip", tmp_path / "video.mp4")
    assert taken.name.startswith("clip-")  # what is there belongs to somebody else
