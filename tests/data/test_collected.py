"""A clip in memory is the twin of the same clip in the cache."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from data.cache_writer import COLUMNS
from data.clip import prepare, stream
from data.collected import CollectedClip
from data.frames import open_source
from data.samples import SampleSettings, contact_cases
from tests.data.clips import GRID, SETTINGS, write_clip

MESH = ("vertices", "triangles", "springs", "rim", "pixels")
TRAJECTORY = SampleSettings(observation="trajectory", geometry=GRID)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("collected") / "clip")


def collect(folder: Path, **options: bool) -> CollectedClip:
    source = open_source(folder, SETTINGS.layout)
    return CollectedClip(source.name, source.fps, stream(source, SETTINGS), **options)


def test_it_holds_what_the_cache_holds(folder: Path, tmp_path: Path) -> None:
    cached, collected = prepare(folder, SETTINGS, tmp_path), collect(folder)
    assert (collected.name, collected.fps, len(collected)) == (cached.name, cached.fps, len(cached))
    assert collected.status == cached.status
    assert collected.details == cached.details
    assert sorted(collected.details) == [0, 1, 2, 8, 9, 10, 11]
    for name in (*COLUMNS, "contact"):
        np.testing.assert_array_equal(getattr(collected, name), getattr(cached, name), err_msg=name)
    for index in range(len(cached)):
        np.testing.assert_array_equal(collected.depth(index), cached.depth(index))
    for index in np.flatnonzero(cached.contact):
        for name in MESH:
            np.testing.assert_array_equal(getattr(collected.mesh(index), name), getattr(cached.mesh(index), name))
    with pytest.raises(IndexError, match="Frame 0 of clip is no_tool"):
        collected.mesh(0)


def test_onsets_alone_give_the_same_contacts(folder: Path) -> None:
    whole, light = collect(folder), collect(folder, onsets_only=True)
    assert len(light) == len(whole) == 12
    first, second = contact_cases(whole, TRAJECTORY), contact_cases(light, TRAJECTORY)
    assert list(first) == list(second) == [3]
    np.testing.assert_array_equal(first[3].displacement, second[3].displacement)
    np.testing.assert_array_equal(first[3].mesh.vertices, second[3].mesh.vertices)
    with pytest.raises(IndexError, match="Frame 4 of clip is ok and has no mesh here"):
        light.mesh(4)


def test_no_frames_make_an_empty_clip() -> None:
    clip = CollectedClip("nothing", 25.0, [])
    assert len(clip) == 0
    assert clip.track_position.shape == (0, 3)
    assert clip.contact.shape == (0,)
