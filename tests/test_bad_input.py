"""Bad input at infer.py's door: one sentence that names the file, no traceback, and the rest of the batch goes on."""

import dataclasses
import os
import resource
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.cli import infer
from palpate.common.output import LIST
from palpate.data.contact.geometry import GeometrySettings
from tests import inference_inputs as inputs
from tests.tables import read_rows

pytestmark = pytest.mark.usefixtures("blank_pictures")
ROOT = Path(__file__).resolve().parents[1]
FRAMES = 6
"""Frames of every clip here; contact from the third on, the tool in view from the start."""


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return inputs.write_model(tmp_path / "parameters.onnx")


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """A folder with one good clip; a test puts a bad one beside it."""
    inputs.write_clip(tmp_path / "clips" / "good", FRAMES, 2)
    return tmp_path / "clips"


def call(clips: Path, *options: str) -> int:
    base = ["--output", str(clips.parent / "out"), "--model", str(clips.parent / "parameters.onnx"), "--no-overlay"]
    return infer.main([str(clips), *base, *options])


def rows(clips: Path, name: str) -> list[dict[str, str]]:
    return read_rows(clips.parent / "out" / name / "parameters.csv")


def statuses(clips: Path, name: str) -> list[str]:
    return [row["status"] for row in rows(clips, name)]


def is_plain(said: str) -> bool:
    return "Traceback" not in said and "Error:" not in said


# --- clips that can't be opened: the clip fails by name, the others complete ---


def frames_of(folder: Path) -> Path:
    return inputs.write_clip(folder / "bad", FRAMES, 2)


def headless_video(folder: Path) -> None:
    whole = inputs.write_video(folder / "bad.mp4", 30).read_bytes()
    (folder / "bad.mp4").write_bytes(whole[: len(whole) // 2])


def broken_images(folder: Path) -> None:
    for path in frames_of(folder).glob("*_endo.png"):
        path.write_bytes(b"")


def strip(folder: Path) -> None:
    write_pictures(folder / "bad", inputs.encode(np.full((40, 400, 3), 90, np.uint8)))


def pictures_that_unpack_to_gigabytes(folder: Path) -> None:
    content = inputs.encode(np.zeros((40, 40), np.uint8))
    write_pictures(folder / "bad", content[:16] + (30_000).to_bytes(4, "big") * 2 + content[24:])


def write_pictures(folder: Path, content: bytes) -> None:
    folder.mkdir()
    for index in range(3):
        (folder / f"{index}.png").write_bytes(content)


def clip_file(text: str) -> Callable[[Path], object]:
    return lambda folder: (frames_of(folder) / "clip.json").write_text(text)


UNUSABLE: tuple[Callable[[Path], object], ...] = (
    lambda folder: (folder / "bad.mp4").write_bytes(b""),
    lambda folder: (folder / "bad.mp4").write_bytes(os.urandom(4000)),
    lambda folder: (folder / "bad.mp4").symlink_to("/dev/zero"),
    lambda folder: (folder / "bad.mp4").symlink_to("bad.mp4"),
    lambda folder: os.mkfifo(folder / "bad.mp4"),
    lambda folder: os.mkfifo(frames_of(folder) / "clip.json"),
    lambda folder: shutil.copy(frames_of(folder) / "frame_12_endo.png", folder / "bad" / "frame_012_endo.png"),
    *(headless_video, broken_images, strip, pictures_that_unpack_to_gigabytes),
    clip_file("{"),
    *(
        clip_file(f'{{"camera": {{"fx": {text}}}}}')
        for text in ("[" * 900 + "]" * 900, "9" * 400, "1e308", "-1", "NaN")
    ),
    *(clip_file(f'{{"fps": {text}}}') for text in ("1e308", "1e-320", "9" * 400, "[" * 5000)),
)
"""What makes the one clip of a folder, which can't be opened."""


def test_unusable_clips_are_named_and_the_rest_goes_on(clips, model, capsys):
    bad = []
    for index, make in enumerate(UNUSABLE):
        (clips / str(index)).mkdir()
        make(clips / str(index))
        bad += (clips / str(index)).iterdir()
    assert call(clips) == 1
    said = capsys.readouterr()
    failures = [line for line in said.err.splitlines() if line.startswith("failed: ")]
    for path in bad:
        named = [line for line in failures if str(path) in line]
        assert len(named) == 1
        assert named[0].endswith(".")
        assert len(named[0]) < 2 * len(str(path)) + 300
    assert len(failures) == said.out.count(" failed") == len(UNUSABLE)
    assert is_plain(said.err + said.out)
    assert "unexpected" not in said.err
    assert statuses(clips, "good") == ["no_contact"] * 2 + ["ok"] * 4
    assert sorted(path.name for path in (clips.parent / "out").iterdir()) == [LIST, "good", "index.html"]


# --- frames that can't be used: their rows say why, the clip's other frames are estimated ---


Change = Callable[[bytes], bytes | None]
"""From a file's content to another; None where the file is to be gone."""


def put(content: bytes | None) -> Change:
    return lambda _: content


def without(color: tuple[int, int, int], left: int = 0) -> Change:
    """A mask without a class, but for some pixels of it."""

    def change(content: bytes) -> bytes:
        mask = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR_RGB)
        mask[(mask == color).all(axis=2)] = 127
        mask[60, 80 : 80 + left] = color
        return inputs.encode(mask[..., ::-1])

    return change


OTHER_SIZE = inputs.encode(np.zeros((50, 70, 3), np.uint8))
SPOILT: dict[str, tuple[str, Change, str]] = {
    "empty frame": ("", put(b""), "unreadable"),
    "cut frame": ("", lambda content: content[:900], "unreadable"),
    "frame of another size": ("", put(OTHER_SIZE), "unreadable"),
    "no mask": ("_color_mask", put(None), "no_mask"),
    "mask of another size": ("_color_mask", put(OTHER_SIZE), "no_mask"),
    "empty mask": ("_color_mask", put(b""), "no_mask"),
    "zero depth": ("_depth", put(inputs.encode(np.zeros(inputs.SIZE[::-1], np.uint16))), "bad_depth"),
    "constant depth": ("_depth", put(inputs.encode(np.full(inputs.SIZE[::-1], 20000, np.uint16))), "bad_depth"),
    "no depth": ("_depth", put(None), "bad_depth"),
    "no tool": ("_color_mask", without(inputs.TOOL_COLOR), "no_tool"),
    "no tissue": ("_color_mask", without(inputs.TISSUE_COLOR), "no_tissue"),
    "three pixels of tissue": ("_color_mask", without(inputs.TISSUE_COLOR, 3), "no_tissue"),
}
"""Changes of frame 13's files, and the frame's status then."""


def test_unusable_frame_costs_only_its_own_row(clips, model, capsys):
    for name, (suffix, change, _) in SPOILT.items():
        path = inputs.write_clip(clips / name, FRAMES, 2) / f"frame_13_endo{suffix}.png"
        content = change(path.read_bytes())
        path.unlink() if content is None else path.write_bytes(content)
    assert call(clips) == 0
    said = capsys.readouterr().err
    assert is_plain(said)
    for name, (_, _, status) in SPOILT.items():
        assert statuses(clips, name) == ["no_contact"] * 2 + ["ok", status, "ok", "ok"], name
        row = rows(clips, name)[3]
        assert row["frame"] == "13"
        assert row["stiffness"] == row["damping"] == row["force"] == row["simulated_displacement"] == ""
        assert row["detail"], name
        # Broken files are reported on the screen too; an empty scene is no fault.
        warned = f"{name}: 1 of 6 frames are {status}, the first is 13" in said
        assert warned == (status in ("unreadable", "no_mask", "bad_depth")), name


def rewrite(clip: Path, suffix: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for path in clip.glob(f"*{suffix}.png"):
        path.write_bytes(inputs.encode(change(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))))


def classes(mask: np.ndarray) -> np.ndarray:
    """Grey values of a colour mask (BGR)."""
    values = np.full(mask.shape[:2], 50, np.uint8)
    for color, value in ((inputs.TISSUE_COLOR, 22), (inputs.TOOL_COLOR, 31)):
        values[(mask[..., ::-1] == color).all(axis=2)] = value
    return values


def test_masks_of_other_formats_and_a_covered_lens(clips, model, capsys):
    rewrite(
        inputs.write_clip(clips / "rgba", FRAMES, 2), "_color_mask", lambda mask: cv2.cvtColor(mask, cv2.COLOR_BGR2BGRA)
    )
    rewrite(inputs.write_clip(clips / "grey", FRAMES, 2), "_color_mask", classes)
    write_pictures(clips / "black", inputs.encode(np.zeros((*inputs.SIZE[::-1], 3), np.uint8)))
    assert call(clips) == 0
    said = capsys.readouterr().err
    assert is_plain(said)
    assert statuses(clips, "rgba") == statuses(clips, "grey") == statuses(clips, "good")
    assert statuses(clips, "good") == ["no_contact"] * 2 + ["ok"] * 4
    assert [(row["status"], row["detail"]) for row in rows(clips, "black")] == [
        ("no_tool", "0 tool pixels, fewer than 8.")
    ] * 3


def test_stored_depth_that_is_no_depth(clips, model, capsys):
    """In one frame, or in all; the good clip lacks the files of the layout, and that is its failure."""
    kinds = {"nan": np.nan, "inf": np.inf, "zero": 0.0, "constant": 1.0, "all nan": np.nan, "all zero": 0.0}
    for name, value in kinds.items():
        clip = inputs.write_clip(clips / name, FRAMES, 2)
        for number in range(10, 10 + FRAMES):
            depth = cv2.imread(str(clip / f"frame_{number}_endo_depth.png"), cv2.IMREAD_UNCHANGED).astype(np.float32)
            bad = number == 13 or name.startswith("all")
            np.save(clip / f"depth_{number}.npy", np.full_like(depth, value) if bad else depth)
    (clips.parent / "layout.yaml").write_text("depth: 'depth_{number}.npy'\n")
    assert call(clips, "--layout", str(clips.parent / "layout.yaml"), "--depth", "stored") == 1
    said = capsys.readouterr().err
    assert is_plain(said)
    assert f"{clips / 'good'} has no stored depth (depth_{{number}}.npy); choose a depth model with --depth." in said
    for name, value in kinds.items():
        what = {0.0: "zero everywhere", 1.0: "the same everywhere (1)"}.get(value, "NaN or infinite everywhere")
        if name.startswith("all"):
            assert statuses(clips, name) == ["bad_depth"] * FRAMES
            assert f"{clips / name} has no frame with usable depth; {clips / name / 'depth_10.npy'} is {what}" in said
        else:
            assert statuses(clips, name) == ["no_contact"] * 2 + ["ok", "bad_depth", "ok", "ok"], name
        assert rows(clips, name)[3]["detail"].endswith("; check the depth source or choose another.")
        assert f"{what}; the frame is left out" in rows(clips, name)[3]["detail"]


def test_gap_in_the_frame_numbers_keeps_numbers_times_and_warns(clips, model, capsys):
    clip = inputs.write_clip(clips / "gap", FRAMES, 2)
    for path in clip.glob("frame_13_*"):
        path.unlink()
    assert call(clips) == 0
    found = rows(clips, "gap")
    assert [row["frame"] for row in found] == ["10", "11", "12", "14", "15"]
    assert float(found[3]["time_s"]) == pytest.approx(0.16)
    # Nothing is compared across the gap.
    assert found[2]["observed_displacement"] == ""
    assert "gap: 1 frame numbers are missing between 10 and 15" in capsys.readouterr().err


def test_folders_nest_and_links_lead_in_circles(clips, model, nested, capsys):
    """In a clip, whose results they leave up to date, and beside one; where a path gets too long, that one fails."""
    assert call(clips) == 0
    for folder in (clips, clips / "good"):
        (folder / "round").symlink_to(clips)
        (folder / "self").symlink_to("self")
        nested(folder, "d")
    assert call(clips) == 0
    nested(clips, "long")
    assert call(clips) == 1
    said = capsys.readouterr()
    [failure] = [line for line in said.err.splitlines() if line.startswith("failed: ")]
    assert f"{clips}/long/long/" in failure
    assert len(failure) < 1000
    assert is_plain(said.err)
    assert "unexpected" not in said.err
    assert statuses(clips, "good") == ["no_contact"] * 2 + ["ok"] * 4


def test_names_of_any_script_and_length(clips, model):
    long = "é" * 100
    inputs.write_clip(clips / "肝臓 [1] {x} vidéo", FRAMES, 2)
    inputs.write_clip(clips / "sub" / long, FRAMES, 2)
    assert call(clips) == 0
    assert len(rows(clips, "肝臓 [1] {x} vidéo")) == FRAMES
    made = [path for path in (clips.parent / "out").iterdir() if path.name.startswith("é")]
    assert len(made) == 1
    assert len(made[0].name.encode()) <= 120


def test_name_that_is_not_utf8(clips, model, capsys):
    clip = clips / os.fsdecode(b"clip\xff")
    try:
        inputs.write_clip(clips / "plain", FRAMES, 2).rename(clip)
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")
    (clip / "frame_13_endo_color_mask.png").write_bytes(b"")
    assert call(clips) == 0
    assert statuses(clips, "clip_") == ["no_contact"] * 2 + ["ok", "no_mask", "ok", "ok"]
    assert is_plain(capsys.readouterr().err)
    # A second run knows whose folder it is.
    assert call(clips) == 0
    assert sorted(path.name for path in (clips.parent / "out").iterdir()) == [LIST, "clip_", "good", "index.html"]


def test_names_do_nothing_to_the_terminal(clips, model, capsys):
    evil = "\x1b]0;title\x07\x1b[31m\x9b2J\u202e[red]"
    inputs.write_clip(clips / f"good{evil}", FRAMES, 2)
    (clips / f"good{evil}" / "frame_13_endo.png").write_bytes(b"")  # warned of
    (clips / f"bad{evil}.mp4").write_bytes(b"no video")
    for status in (1, 1):  # done, then up to date
        assert call(clips) == status
        said = capsys.readouterr()
        assert not {letter for letter in said.out + said.err if not letter.isprintable()} - {"\n"}
        for name in ("good", "bad"):
            assert name + r"\x1b]0;title\x07\x1b[31m\x9b2J\u202e[red]" in said.err
        assert r"good\x1b]0;title\x07" in said.out


def test_missing_annotation_of_a_whole_clip(clips, model, capsys):
    inputs.write_video(clips / "video.mp4", FRAMES)
    assert call(clips, "--masks", "annotation") == 1
    assert "video.mp4: a video has no annotation masks; use --masks automatic" in capsys.readouterr().err
    assert statuses(clips, "good")[-1] == "ok"


# --- wrong usage: exit status 2 and one sentence, before anything is written ---


def holding(content: str | bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(content if isinstance(content, bytes) else content.encode())


def model_of(document: dict | None = None, **options: object) -> Callable[[Path], object]:
    return lambda path: inputs.write_model(path, document, **options)


def linked_to_a_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def grid_of(**size: int) -> dict:
    return inputs.metadata() | {
        "geometry": dataclasses.asdict(GeometrySettings(height=inputs.GRID[0], width=inputs.GRID[1])) | size
    }


@pytest.mark.parametrize(
    ("options", "make"),
    [
        *(
            ("--model bad.onnx", make)
            for make in (
                holding("this is not a network"),
                os.mkfifo,
                lambda path: None,
                model_of({"input": {"window": 1, "height": 48, "width": 80}}),
                model_of(inputs=("picture",)),
                model_of(grid_of(height=inputs.GRID[0] + 1)),
                model_of(grid_of(height=100_000)),
            )
        ),
        ("--depth bad.onnx --depth-preset midas-small", holding("no depth")),
        ("--depth depthpro --depth-model bad.onnx", model_of()),
        ("--masks bad.onnx", holding("no masks")),
        ("--layout bad.yaml", holding("imagee: x_{number}.png\n")),
        ("--layout bad.yaml", os.mkfifo),
        ("--camera bad.yaml", holding("cx: 1\ncy: 1\nwidth: 2\nheight: 2\n")),
        ("--camera bad.yaml", linked_to_a_device),
        ("--depth parameters.onnx --depth-preset bad.yaml", os.mkfifo),
        ("--depth parameters.onnx --depth-preset bad.yaml", holding("kind: metric\nsize: [100000, 100000]\n")),
        ("--output bad.txt", holding("")),
    ],
)
def test_wrong_usage_is_one_sentence_with_the_file(options, make, clips, model, monkeypatch, capsys):
    monkeypatch.chdir(clips.parent)
    make(clips.parent / next(part for part in options.split() if part.startswith("bad.")))
    assert call(clips, *options.split()) == 2
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    assert "bad." in said
    assert said.endswith(".")
    assert is_plain(said)
    assert "depth.model" not in said
    assert "depth.preset" not in said
    assert not (clips.parent / "out").exists()


@pytest.mark.parametrize("threads", ["100000", "-1", "1e5", "9" * 5000])
def test_threads_that_no_machine_has_are_wrong_usage(clips, model, capsys, threads):
    with pytest.raises(SystemExit, match=r"^2$"):
        call(clips, f"--threads={threads}")
    assert "error: argument --threads: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value", "what", "give", "depths"),
    [
        ("preset", "banana", "says how to read an .onnx file", "that file", ("auto", "stored", "photometric")),
        ("model", "banana.onnx", "belongs to a preset", "that preset", ("auto", "stored", "network.onnx")),
    ],
)
def test_a_depth_option_that_nothing_reads_is_refused(name, value, what, give, depths, clips, model, capsys):
    output = ["--output", str(clips.parent / "out"), "--estimator", "direct"]
    for depth in depths:
        asked = [f"--depth-{name}", value, *(["--depth", depth] if depth != "auto" else [])]
        said = f"infer.py: --depth-{name} is '{value}' and {what}, while --depth is {depth}; give {give} as --depth, "
        assert call(clips, *asked) == infer.main([str(clips), *output, *asked]) == 2
        assert capsys.readouterr().err == 2 * f"{said}or leave --depth-{name} out.\n"


def test_input_that_is_not_there_or_holds_nothing(clips, model, capsys):
    (clips / "nothing").mkdir()
    assert call(clips.parent / "nowhere.mp4", "--output", str(clips.parent / "out")) == 2
    assert call(clips / "nothing", "--model", str(model)) == 2
    said = capsys.readouterr().err.splitlines()
    assert "nowhere.mp4" in said[0]
    assert "holds no video, bag or folder of frames" in said[1]
    output = ["--output", str(clips.parent / "out"), "--model", str(model), "--no-overlay"]
    with pytest.raises(SystemExit, match=r"^2$"):
        infer.main(["", *output])
    assert "an option is empty, as of an unset variable of the shell" in capsys.readouterr().err
    # Beside a usable input it is a failure of its own.
    assert infer.main([str(clips / "nowhere"), str(clips / "good"), *output]) == 1
    assert statuses(clips, "good")[-1] == "ok"


def test_decoders_say_nothing_of_their_own(clips, model, capfd):
    image = clips / "good" / "frame_12_endo.png"
    image.write_bytes(image.read_bytes()[:500])
    (clips / "bad.mp4").write_bytes(b"no video")
    assert call(clips) == 1
    said = capfd.readouterr().err
    assert "bad.mp4" in said
    assert "WARN" not in said
    assert "libpng" not in said


# --- the output folder ---


def test_files_that_may_not_grow(clips, model, capsys):
    """The real thing: files may not exceed 8 kB, so overlay and summary can't be written."""
    arguments = [str(clips), "--output", str(clips.parent / "out"), "--model", str(model)]
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, most))
    try:
        assert infer.main(arguments) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    said = capsys.readouterr()
    assert "writing failed" in said.err
    assert is_plain(said.err + said.out)
    assert list((clips.parent / "out").iterdir()) == []
    assert infer.main(arguments) == 0
