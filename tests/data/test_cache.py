"""Prepared clips on disk: what they hold, what they depend on, and that nothing half-written is left."""

import os
import pickle
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from palpate.data.cache import cache_key
from palpate.data.clip import ClipStream, prepare
from palpate.data.depth.normalise import DepthSettings
from palpate.data.prepared import PreparedFrame
from palpate.data.source.frames import open_source
from palpate.data.source.layout import InputError
from tests.data.clips import GRID, SETTINGS, write_clip


def test_prepared_clip_equals_the_stream(tmp_path):
    folder = write_clip(tmp_path / "clip", shift=0.5)
    frames = list(ClipStream(open_source(folder, SETTINGS.layout), SETTINGS))
    clip = prepare(folder, SETTINGS, tmp_path / "cache")
    assert (clip.status.tolist(), clip.counts["ok"], len(clip)) == ([frame.status for frame in frames], 5, 12)
    assert np.array_equal(clip.usable, [True] * 12)
    for index, frame in enumerate(frames):
        assert np.array_equal(clip.depth(index), frame.depth)
        assert clip.times[index] == frame.frame.time_s
        for name in ("consecutive", "displacement", "backward", "rigid", "track_start", "track_position"):
            np.testing.assert_array_equal(getattr(clip, name)[index], getattr(frame, name))
        for name in ("vertex", "normal", "noise") if frame.in_contact else ():
            np.testing.assert_array_equal(getattr(clip, name)[index], getattr(frame.geometry, name))
        if frame.geometry is not None:
            mesh, expected = clip.mesh(index), frame.geometry.mesh
            for name in ("vertices", "triangles", "springs", "rim", "pixels"):
                assert np.array_equal(getattr(mesh, name), getattr(expected, name))
            assert mesh.grid_shape == expected.grid_shape
    with pytest.raises(IndexError, match="no_tool"):
        clip.mesh(0)
    assert np.array_equal(pickle.loads(pickle.dumps(clip)).depth(3), clip.depth(3))


def entries(cache: Path) -> set[str]:
    return {path.name for path in cache.iterdir()}


def test_cache_is_reused_and_invalidated_by_files_settings_and_code(tmp_path, monkeypatch):
    folder, cache = write_clip(tmp_path / "clip", frames=5), tmp_path / "cache"
    clip = prepare(folder, SETTINGS, cache)
    before = (clip.folder / "clip.npz").stat().st_mtime_ns
    assert prepare(folder, SETTINGS, cache).folder == clip.folder
    assert (clip.folder / "clip.npz").stat().st_mtime_ns == before
    known = cache_key(folder, SETTINGS)
    # What samples make of the geometry, and where a model runs, leaves the clip as it is.
    same = replace(SETTINGS, geometry=replace(GRID, force_direction="displacement"), depth=DepthSettings(threads=3))
    assert cache_key(folder, same) == known
    changes = [{"geometry": replace(GRID, max_edge=0.04)}, {"masks": "automatic"}, {"track_seconds": 0.5}]
    for changed in [*changes, {"depth": DepthSettings(bits=8)}, {"depth": DepthSettings(source="photometric")}]:
        assert cache_key(folder, replace(SETTINGS, **changed)) != known
    (folder / "sub").mkdir()
    assert cache_key(folder, SETTINGS) == known
    (folder / "sub" / "file").touch()
    assert cache_key(folder, SETTINGS) != known
    (folder / "sub" / "file").unlink()
    os.utime(folder / "frame_2_endo.png", ns=(1, 1))
    assert cache_key(folder, SETTINGS) != known
    monkeypatch.setattr("palpate.data.cache.code_digest", lambda part: "another")
    touched = cache_key(folder, SETTINGS)
    monkeypatch.undo()
    assert cache_key(folder, SETTINGS) != touched
    prepare(folder, SETTINGS, cache)
    assert len(entries(cache)) == 2


def test_interrupted_preparation_leaves_nothing_and_can_go_on(tmp_path):
    folder, cache = write_clip(tmp_path / "clip", frames=6), tmp_path / "cache"

    def interrupt(stream: ClipStream) -> Iterator[PreparedFrame]:
        yield from islice(stream, 3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare(folder, SETTINGS, cache, interrupt)
    assert entries(cache) == set()
    assert len(prepare(folder, SETTINGS, cache)) == 6


def test_a_user_s_file_in_a_damaged_entry_stays(tmp_path):
    folder, cache = write_clip(tmp_path / "clip", frames=3), tmp_path / "cache"
    entry = prepare(folder, SETTINGS, cache).folder
    (entry / "clip.npz").write_bytes(b"cut")
    (entry / "notes.txt").write_text("precious")
    with pytest.raises(InputError, match=rf"{entry} holds files of something else; move it away"):
        prepare(folder, SETTINGS, cache)
    assert (entry / "notes.txt").read_text() == "precious"


def one_byte(path: Path, content: bytes) -> None:
    middle = len(content) // 2
    path.write_bytes(content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :])


def packed(path: Path, _: bytes) -> None:
    """Write a file as small, far larger when unpacked."""
    np.savez_compressed(path, status=np.zeros(10**6), sources=np.zeros(10**6), depth=np.zeros(10**6))


DAMAGES = {
    "one byte": one_byte,
    "packed": packed,
    "cut": lambda path, content: path.write_bytes(content[:-100]),
    "emptied": lambda path, _: path.write_bytes(b""),
    "missing": lambda path, _: None,
    "pipe": lambda path, _: os.mkfifo(path),
    "device": lambda path, _: path.symlink_to("/dev/zero"),
}


@pytest.mark.parametrize("name", ["clip.npz", "2.npz"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_entry_is_made_again(tmp_path, name, damage):
    folder, cache = write_clip(tmp_path / "clip", frames=4), tmp_path / "cache"
    clip = prepare(folder, SETTINGS, cache)
    before = {path.name: path.stat().st_size for path in clip.folder.iterdir()}
    content = (clip.folder / name).read_bytes()
    (clip.folder / name).unlink()
    DAMAGES[damage](clip.folder / name, content)
    again = prepare(folder, SETTINGS, cache)
    assert {path.name: path.stat().st_size for path in again.folder.iterdir()} == before
    assert [again.depth(index).shape for index in range(4)] == [(GRID.height, GRID.width)] * 4
    assert again.counts == clip.counts


def test_an_unwritable_cache_and_a_missing_clip_are_sentences(tmp_path):
    folder = write_clip(tmp_path / "clip", frames=3)
    (tmp_path / "file").write_text("")
    for asked, said in (
        ((folder, SETTINGS, tmp_path / "file" / "cache"), "change the cache"),
        ((tmp_path / "nowhere", SETTINGS, tmp_path / "cache"), "nowhere"),
        ((folder, replace(SETTINGS, masks="guess"), tmp_path / "cache"), "masks 'guess' is unknown"),
    ):
        with pytest.raises(InputError, match=said):
            prepare(*asked)
