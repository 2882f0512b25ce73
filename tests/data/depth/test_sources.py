"""Stored depth in every format, closed forms of each output kind, and what a clip freezes."""

import os
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.data.depth.sources import StoredDepth, from_relative_inverse
from palpate.data.source.frames import Frame
from palpate.data.source.layout import ClipLayout, InputError

HEIGHT, WIDTH = 24, 32
RAMP = np.broadcast_to(np.linspace(0.25, 0.75, WIDTH), (HEIGHT, WIDTH)).astype(np.float32)
NPY = ClipLayout(image="{number}.png", depth="{number}.npy")


def frame_of(folder, number="7") -> Frame:
    path = folder / f"{number}.png"
    return Frame(0, int(number), 0.0, np.zeros((HEIGHT, WIDTH, 3), np.uint8), path)


def stored(folder, array, layout=NPY) -> np.ndarray:
    """Write an array as frame 7's depth and read it through the source."""
    path = folder / layout.depth.replace("{number}", "7")
    if path.suffix == ".npy":
        np.save(path, array)
    elif path.suffix == ".npz":
        np.savez(path, **array)
    else:
        cv2.imwrite(str(path), array)
    return StoredDepth(layout, folder)(frame_of(folder))


# Stored files


@pytest.mark.parametrize("suffix", [".npz", ".npy", ".png"])
def test_a_map_that_unpacks_to_gigabytes_is_refused_by_what_it_declares(tmp_path, suffix):
    """The declared sizes are all there is of them: unpacking would fail in another way."""
    path = tmp_path / f"7{suffix}"
    if suffix == ".png":
        content = cv2.imencode(".png", np.zeros((2, 2), np.uint16))[1].tobytes()
        path.write_bytes(content[:16] + (30_000).to_bytes(4, "big") * 2 + content[24:])
        said = "30000x30000, far larger than its picture"
    elif suffix == ".npy":
        np.lib.format.open_memmap(path, "w+", np.float32, (30_000, 30_000)).flush()  # holes, not data
        said = "unpacks to 3433 MB, more than 16 times its picture's pixels; store depth at the picture's size"
    else:
        np.savez_compressed(path, depth=np.zeros((600, 600)))
        said = "unpacks to 3 MB, more than 16 times"
    with pytest.raises(InputError, match=rf"7\{suffix} .*{said}"):
        StoredDepth(replace(NPY, depth="{number}" + suffix), tmp_path)(frame_of(tmp_path))


def test_a_map_of_four_times_its_pictures_sides_is_read_whatever_lies_beside_it(tmp_path):
    large = np.kron(RAMP, np.ones((4, 4)))
    beside = np.zeros((40 * HEIGHT, 40 * WIDTH))
    layout = replace(NPY, depth="{number}.npz", depth_key="depth")
    assert stored(tmp_path, {"depth": large, "beside": beside}, layout) == pytest.approx(RAMP)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_is_divided_by_its_types_largest_value(tmp_path, dtype):
    largest = np.iinfo(dtype).max
    levels = np.rint(RAMP * largest).astype(dtype)
    levels[0, :5] = 0
    depth = stored(tmp_path, levels, replace(NPY, depth="{number}_depth.png", depth_factor=2.0))
    assert depth == pytest.approx(2.0 * levels / largest, rel=1e-6)
    assert (depth[0, :5] == 0).all()


TWO = {"z": RAMP, "other": RAMP * 2}
NPZ = replace(NPY, depth="{number}.npz")
INVALID = np.repeat([np.nan, np.inf, -1, 0], 2)[:, None] * np.ones(WIDTH)
"""Eight rows of what is no depth."""


@pytest.mark.parametrize(
    ("array", "layout", "expected"),
    [
        (RAMP.astype(np.float64), NPY, RAMP),
        (RAMP[None], NPY, RAMP),
        ((RAMP * 100).astype(np.int16), replace(NPY, depth_factor=0.001), (RAMP * 100).astype(np.int16) / 1000),
        ({"z": RAMP}, NPZ, RAMP),
        (TWO, replace(NPZ, depth_key="other"), RAMP * 2),
        (RAMP * 100, replace(NPY, depth_kind="disparity", depth_factor=10.0), 0.1 / RAMP),
    ],
    ids=["doubles", "one channel", "millimetres", "the only array", "by its key", "disparity"],
)
def test_arrays_are_read_as_the_layout_says_and_invalid_parts_keep_the_rest(tmp_path, array, layout, expected):
    rtol = 0 if layout.depth_factor == 1 else 1e-6
    np.testing.assert_allclose(stored(tmp_path, array, layout), expected, rtol=rtol)
    if isinstance(array, np.ndarray) and array.dtype.kind == "f":
        array = np.concatenate([INVALID, array.reshape(HEIGHT, WIDTH)[8:]])
        depth = stored(tmp_path, array, layout)
        assert (depth[:8] == 0).all()
        np.testing.assert_allclose(depth[8:], expected[8:], rtol=rtol)


def test_depth_of_another_resolution_takes_the_nearest_pixel(tmp_path):
    depth = stored(tmp_path, RAMP[::2, ::2])
    assert (depth.shape, set(np.unique(depth))) == ((HEIGHT, WIDTH), set(np.unique(RAMP[::2, ::2])))
    with pytest.raises(InputError, match=r"7.npy is 16x24 while its frame is 32x24"):
        stored(tmp_path, RAMP[:, ::2])


@pytest.mark.parametrize(
    ("array", "expected"),
    [
        (np.full_like(RAMP, np.nan), "is NaN or infinite everywhere"),
        (np.full_like(RAMP, np.inf), "is NaN or infinite everywhere"),
        (np.zeros_like(RAMP), "is zero everywhere"),
        (np.full_like(RAMP, 0.5), "is the same everywhere"),
        (np.where(RAMP > 0.745, -RAMP, 0), "is valid on 0.0% of its pixels"),
        (np.zeros((2, 3, 4)), "one depth map"),
        (np.full(RAMP.shape, "a"), "one depth map"),
    ],
)
def test_one_unusable_file_is_that_frames_error(tmp_path, array, expected):
    with pytest.raises(InputError, match=r"7\.npy") as caught:
        stored(tmp_path, array)
    assert expected in str(caught.value)
    good = tmp_path / "8.npy"
    np.save(good, RAMP)
    assert np.array_equal(StoredDepth(NPY, tmp_path)(frame_of(tmp_path, "8")), RAMP)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda path: None, "does not exist"),
        (lambda path: path.write_bytes(b""), "can't be read"),
        (lambda path: path.write_bytes(b"PK\x03\x04 not an archive"), "can't be read"),
        (os.mkfifo, "is no file; put the depth itself there"),
    ],
    ids=["missing", "empty", "broken", "pipe"],
)
def test_what_is_no_file_of_depth_is_named(tmp_path, make, said):
    make(tmp_path / "7.npy")
    np.save(tmp_path / "8.npy", RAMP)
    with pytest.raises(InputError, match=rf"7\.npy {said}"):
        StoredDepth(NPY, tmp_path)(frame_of(tmp_path))


def test_broken_and_coloured_pngs_are_named(tmp_path):
    layout = replace(NPY, depth="{number}_depth.png")
    with pytest.raises(InputError, match=r"7_depth.png is a colour picture"):
        stored(tmp_path, np.full((HEIGHT, WIDTH, 3), (0, 0, 9), np.uint8), layout)
    grey = np.repeat(np.rint(RAMP * 255).astype(np.uint8)[..., None], 3, axis=2)
    assert stored(tmp_path, grey, layout) == pytest.approx(grey[..., 0] / 255, rel=1e-6)
    (tmp_path / "7_depth.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"7_depth.png"):
        StoredDepth(layout, tmp_path)(frame_of(tmp_path))


def test_identity_follows_how_files_are_read(tmp_path):
    np.save(tmp_path / "7.npy", RAMP)
    layouts = (NPY, NPY, replace(NPY, depth_factor=2.0))
    first, same, other = (StoredDepth(layout, tmp_path).identity for layout in layouts)
    (tmp_path / "clip.json").write_text('{"depth_scale": 2.0}')
    assert first == same not in (other, StoredDepth(NPY, tmp_path).identity)


@pytest.mark.parametrize("scale", ["0", "-1", '"far"', "true", "NaN"])
def test_impossible_declared_scale_is_named(tmp_path, scale):
    np.save(tmp_path / "7.npy", RAMP)
    (tmp_path / "clip.json").write_text(f'{{"depth_scale": {scale}}}')
    with pytest.raises(InputError, match=r"clip.json gives depth_scale"):
        StoredDepth(NPY, tmp_path)


# Closed forms


def test_relative_inverse_depth_meets_near_and_far():
    values = np.array([[1.0, 3.0, 2.0, 0.0, -9.0, 5.0, np.nan]], np.float32)
    depth = from_relative_inverse(values, (1.0, 3.0), 0.05, 0.2)
    # 1/0.2 = 5, 1/0.05 = 20; the middle is 12.5; below the range it stays far, above it falls further (35).
    assert depth == pytest.approx(np.array([[0.2, 0.05, 0.08, 0.2, 0.2, 1 / 35, 0]]), rel=1e-6)


@settings(max_examples=40)
@given(
    values=st.lists(st.floats(-100, 100), min_size=2, max_size=20),
    low=st.floats(-10, 10),
    width=st.floats(0.01, 50),
    near=st.floats(0.01, 1),
    ratio=st.floats(1.01, 50),
)
def test_relative_inverse_depth_is_positive_bounded_and_falls(values, low, width, near, ratio):
    ordered = np.sort(np.array([values], np.float32))
    depth = from_relative_inverse(ordered, (low, low + width), near, near * ratio)
    assert (depth > 0).all()
    assert (depth <= near * ratio * (1 + 1e-6)).all()
    assert (np.diff(depth) <= 1e-6 * depth[:, :-1]).all()
