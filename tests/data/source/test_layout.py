"""Layouts name files rightly and refuse what they can't mean."""

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.data.source import layout as layouts
from palpate.data.source.camera import Rig, clip_camera, load_camera
from palpate.data.source.layout import ClipLayout, InputError, load_layout, read_mapping

LAYOUTS = Path(__file__).resolve().parents[3] / "configs" / "layouts"


def test_shipped_cholecseg8k_layout_is_the_default():
    assert load_layout(LAYOUTS / "cholecseg8k.yaml") == ClipLayout()
    with pytest.raises(InputError, match=r"nowhere\.yaml can't be read"):
        load_layout(LAYOUTS / "nowhere.yaml")


def test_shipped_recover_layout_means_what_the_sequence_stores():
    layout = load_layout(LAYOUTS / "recover_tissue.yaml")
    assert (layout.tool_values, layout.tissue_values) == ((0,), (1,))
    assert (layout.depth_kind, layout.depth_key) == ("disparity", "disparity")
    assert layout.depth_factor == pytest.approx(732.25 * 4.552)
    assert layout.camera == str((LAYOUTS / "recover_tissue_camera.yaml").resolve())


@settings(max_examples=30)
@given(st.text("0123456789", min_size=1, max_size=12))
def test_companion_keeps_the_zero_padding(digits):
    layout = ClipLayout()
    frame = Path("clip") / f"frame_{digits}_endo.png"
    assert layouts.companion(layout, frame, layout.color_mask) == Path("clip") / f"frame_{digits}_endo_color_mask.png"


def test_companion_and_clip_folder_with_subfolders():
    layout = ClipLayout(image="img_left/{number}.jpg", depth="disp/{number}.npz")
    frame = Path("/a/clip/img_left/0012.jpg")
    assert layouts.clip_folder(layout, frame) == Path("/a/clip")
    assert layouts.companion(layout, frame, layout.depth) == Path("/a/clip/disp/0012.npz")
    layout = ClipLayout()  # that of a plain image lies beside it
    assert layouts.companion(layout, Path("clip/shot 7.png"), layout.depth) == Path("clip/frame_7_endo_depth.png")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"image": "frame.png"}, "write {number} once"),
        ({"color_mask": "a\0/{number}.png"}, "layout.color_mask holds a NUL"),
        ({"camera": "a\0b"}, "layout.camera holds a NUL"),
        ({"fps": 0.0}, "give 1e-06 to 10000"),
        ({"depth_factor": float("nan")}, "positive number"),
        ({"label_mask": "m/{number}.png"}, "needs layout.tool_values"),
        ({"mask_opening_px": -1}, "give 0 to 1001"),
    ],
)
def test_impossible_values_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        ClipLayout(**values)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("imagge: x", "unknown key 'imagge'; known are image"),
        ("fps: [", "is not a clip layout"),
        ("depth_kind: inverse", "gives depth_kind 'inverse'; give one of depth, disparity"),
        ("- a\n- b", "write a mapping"),
        ("fps: fast", "gives fps 'fast'; give a number"),
        ("fps: -1", "can't be used: layout.fps is -1; give 1e-06 to 10000"),
        ("image: 3", "gives image 3; give text"),
        ("tool_values: 3", r"gives tool_values 3; give \[a whole number, …\]"),
        ("fps: " + "[" * 5000, "nests too deeply"),
        ("fps: " + "[" * 400 + "]" * 400, r"nests too deeply|gives fps \[.{,60}; give a number"),
        ("fps: 25\nimage: a\nfps: 30", "is not a clip layout \\(it gives fps twice\\); correct the file"),
        (
            "fps: &a [*a]",
            "is not a clip layout \\(it refers to an anchor; write out what that stands for\\); correct the file",
        ),
        ("fps: 0x" + "f" * 5000, "gives fps a number beyond ±1e\\+15; give a number"),
        ("fps: " + "9" * 5000, "is not a clip layout"),
        ("fps: 2000000000", "layout.fps is 2000000000; give"),
        ("fps: 1.0e-300", "layout.fps is 1e-300; give"),
        ("fps: !!timestamp x", "is not a clip layout"),
        ("mask_opening_px: 100000", "layout.mask_opening_px is 100000; give 0 to 1001"),
        ("? 0x" + "f" * 5000 + "\n: 1", "has the unknown key a number beyond"),
        ("fps: [" + "1," * 2**16 + "1]", "larger than 128 kB"),
    ],
)
def test_bad_layout_files_get_one_sentence(tmp_path, text, message):
    path = tmp_path / "layout.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_layout(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_camera_beside_the_clip_must_exist(tmp_path):
    layout = ClipLayout(camera="camera.json")
    with pytest.raises(InputError, match=r"camera\.json can't be read as a camera file"):
        clip_camera(tmp_path, layout)
    entries = {"fx": 10, "fy": 10.5, "cx": 1, "cy": 1, "width": 4, "height": 3}
    (tmp_path / "camera.json").write_text(json.dumps(entries))
    assert clip_camera(tmp_path, layout) == Rig(10, 10.5, 1, 1, 4, 3)
    assert clip_camera(tmp_path, ClipLayout()) is None
    (tmp_path / "clip.json").write_text(json.dumps({"camera": [1]}))
    with pytest.raises(InputError, match=r"clip\.json\) has a camera that is not a mapping"):
        clip_camera(tmp_path, layout)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        *(("fx", value, "gives fx .{,60}; give a number") for value in ("1e308", "9" * 300, "NaN", '"1e999"')),
        *(("fx", "[" * levels + "]" * levels, "gives fx .{,60}; give a number") for levels in (400, 900)),
        ("fx", "1e-320", r"length \(9.*e-321, 10\) or centre .* is none of a picture of 4x3; give all in its pixels"),
        ("fx", "0.0625", "none of a picture of 4x3; give all in its pixels"),  # millimetres of a lens
        ("cx", "-1e12", "give all in its pixels"),
        ("width", "1e12", "give all in its pixels"),
        ("height", "9" * 400, "gives height a number beyond .*; give a whole number"),
        ("width", "-1e9", "give its size in pixels"),
        ("distortion", "[1e308, 0, 0, 0]", r"gives distortion \[.*; give \[a number"),
    ],
)
def test_cameras_that_nobody_has_are_one_sentence(tmp_path, name, text, message):
    entries = {"fx": "10", "fy": "10", "cx": "1", "cy": "1", "width": "4", "height": "3"} | {name: text}
    camera = "{" + ", ".join(f'"{key}": {value}' for key, value in entries.items()) + "}"
    (tmp_path / "camera.json").write_text(camera)
    (tmp_path / "clip.json").write_text(f'{{"camera": {camera}}}')
    for read in (lambda: load_camera(tmp_path / "camera.json"), lambda: clip_camera(tmp_path, ClipLayout())):
        with pytest.raises(InputError, match=message) as caught:
            read()
        assert str(tmp_path) in str(caught.value)
        assert len(str(caught.value)) < len(str(tmp_path)) + 300


def test_plain_images_without_masks_and_their_numbers(tmp_path):
    for name in ("im8.png", "im9.png", "im10.png", "im9_mask.png", "frame_9_endo_depth.png", ".im3.png", "notes.txt"):
        (tmp_path / name).write_bytes(b"x")
    found = [(number, path.name) for number, path in layouts.frame_files(tmp_path, ClipLayout())]
    assert found == [(8, "im8.png"), (9, "im9.png"), (10, "im10.png")]


def test_time_stamps_in_names_are_not_frame_numbers(tmp_path):
    for stamp in (1700000000040, 1700000000080, 1700000000120):
        (tmp_path / f"{stamp}.jpg").write_bytes(b"x")
    assert [number for number, _ in layouts.frame_files(tmp_path, ClipLayout())] == [0, 1, 2]


@pytest.mark.parametrize("content", ["one: &one {x: 1}\ntwo: {<<: *one}\n", "a: &a [x]\nb: [*a]\n", "fx: &a [*a]\n"])
def test_references_which_may_unfold_without_end_are_refused(tmp_path, content):
    (tmp_path / "a.yaml").write_text(content)
    with pytest.raises(InputError, match=r"a\.yaml is not a file \(it refers to an anchor; write out what that"):
        read_mapping(tmp_path / "a.yaml", "a file")


@pytest.mark.parametrize("content", [b"\x7fELF\x02\x01\x00\x00", b"\x00" * 100, "width: 4".encode("utf-16")])
def test_what_is_no_text_is_refused(tmp_path, content):
    (tmp_path / "a.yaml").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.yaml is not a file"):
        read_mapping(tmp_path / "a.yaml", "a file")
