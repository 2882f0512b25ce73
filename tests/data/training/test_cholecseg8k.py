"""Clips, videos, splits and the door."""

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.data.source.layout import ClipLayout, InputError
from palpate.data.training.cholecseg8k import list_clips, main
from palpate.data.training.splits import FRACTIONS, part_sizes, split_by_video, video_of
from tests.conftest import CHECKOUT
from tests.data.clips import write_clip

ANNOTATED = ["data", "--depth", "stored", "--masks", "annotation", "--cache", "cache"]


@pytest.fixture
def narrow(monkeypatch, tmp_path):
    """The door's working folder; its table as wide as a normal terminal's."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    return tmp_path


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


def test_the_door_prepares_and_reports(narrow, capsys):
    write_clip(narrow / "data" / "video01" / "video01_00000")
    assert main(ANNOTATED) == 0
    out = capsys.readouterr().out
    assert [said in out for said in ("video01_00000", "128x96", "7 no_tool")] == [True] * 3
    assert len(list((narrow / "cache").iterdir())) == 1


def test_the_door_goes_on_after_a_bad_clip_and_names_do_nothing_to_the_terminal(narrow, capsys):
    for name in ("video01/good", "video02/bad"):
        write_clip(narrow / "data" / f"{name}\x1b[31m\x07[red]", frames=4)
    for path in (narrow / "data" / "video02").rglob("*_color_mask.png"):
        path.unlink()
    assert main(ANNOTATED) == 1
    captured = capsys.readouterr()
    assert not {letter for letter in captured.out + captured.err if not letter.isprintable()} - {"\n"}
    assert r"good\x1b[31m\x07[red]" in captured.out
    assert r"bad\x1b[31m\x07[red] failed" in captured.err


@pytest.mark.parametrize(
    "arguments",
    [["nowhere"], ["data", "--depth", "none"], ["data", "--masks", "none"], ["data", "--layout", "nowhere.yaml"]],
)
def test_wrong_usage_is_one_sentence(narrow, capsys, arguments):
    write_clip(narrow / "data" / "video01_00000", frames=2, contact=())
    assert main(arguments) == 2
    error = capsys.readouterr().err.strip()
    assert error.endswith(".")
    assert "\n" not in error


def test_without_contact_the_door_says_so(narrow, capsys):
    write_clip(narrow / "data" / "video01_00000", frames=3, contact=())
    assert main(["data", "--cache", "cache"]) == 0
    assert "No frame is in contact" in capsys.readouterr().err


def test_the_module_runs_as_a_program_without_torch(tmp_path):
    write_clip(tmp_path / "video01_00000", frames=3)
    code = f"""
import sys
from palpate.data.training.cholecseg8k import main
status = main([{str(tmp_path)!r}, "--cache", {str(tmp_path / "cache")!r}])
assert not {{"torch", "lightning", "matplotlib", "scipy.stats"}} & set(sys.modules)
sys.exit(status)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=CHECKOUT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
