"""Clips, videos and splits."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.data.source.layout import ClipLayout, InputError
from palpate.data.training.preparation import list_clips
from palpate.data.training.splits import FRACTIONS, part_sizes, split_by_video, video_of
from tests.data.clips import write_clip


def test_clips_are_found_at_any_depth_and_a_video_beside_its_folder_is_the_same_clip(tmp_path):
    for name in ("a/video01/video01_00080", "a/video01/video01_00000", "video02/video02_00000"):
        write_clip(tmp_path / name, frames=3)
    (tmp_path / "video02" / "video02_00000.mp4").write_bytes(b"depth-change sequence")
    found = list_clips(tmp_path, ClipLayout())
    assert [path.name for path in found] == ["video01_00000", "video01_00080", "video02_00000"]
    assert [video_of(path) for path in found] == ["video01", "video01", "video02"]
    assert video_of(Path("depth-change sequences/gallbladder.mp4")) == "gallbladder"
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty"):
        list_clips(tmp_path / "empty", ClipLayout())


@given(
    total=st.integers(0, 500), fractions=st.sampled_from([FRACTIONS, (0.8, 0.1, 0.1), (1.0, 1.0, 1.0), (0.9, 0.1, 0.0)])
)
def test_part_sizes_add_up_and_leave_no_part_empty_needlessly(total, fractions):
    sizes = part_sizes(total, fractions)
    assert sum(sizes) == total
    assert min(sizes) >= 0
    wanted = sum(fraction > 0 for fraction in fractions)
    assert sum(size > 0 for size in sizes) == min(total, wanted)
    for size, fraction in zip(sizes, fractions, strict=True):
        assert abs(size - total * fraction / sum(fractions)) <= 2
        assert size == 0 or fraction > 0


def test_the_papers_split_is_seven_two_one():
    assert [part_sizes(total, FRACTIONS) for total in (10, 3, 2)] == [[7, 2, 1], [1, 1, 1], [1, 1, 0]]


def test_splits_by_video_are_disjoint_complete_and_repeatable():
    videos = [f"video{number:02d}" for number in range(10)]
    split = split_by_video([*videos, *videos[::-1]], FRACTIONS, seed=3)
    assert [len(split[name]) for name in ("train", "val", "test")] == [7, 2, 1]
    assert sorted(video for part in split.values() for video in part) == videos
    assert split == split_by_video(reversed(videos), FRACTIONS, seed=3)
    assert split != split_by_video(videos, FRACTIONS, seed=4)
