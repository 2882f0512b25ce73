"""The one normalisation, the resize that never blends, and the scale that is frozen for a clip."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from palpate.data.depth.model import RawDepth
from palpate.data.depth.normalise import (
    ORDER,
    DepthSettings,
    estimate_scale,
    label_areas,
    normalise,
    open_depth,
    resize_depth,
)  # fmt: skip
from palpate.data.depth.sources import DepthSource, StoredDepth, check_map, positive
from palpate.data.source.frames import open_source
from palpate.data.source.layout import ClipLayout, InputError, load_layout
from tests.conftest import CHECKOUT
from tests.data.clips import SLOPE, Pictures, write_clip


def blank(count: int, *, live: bool = False) -> Pictures:
    """A clip of blank pictures; the depth of frame i is what the test's `Planes` says."""
    return Pictures(np.broadcast_to(np.uint8(0), (count, 30, 40, 3)), live=live)


class Planes(DepthSource):
    """Depth maps given as a function of the frame's index."""

    identity = "planes"

    def __init__(self, maps) -> None:
        self.maps, self.seen = maps, []

    def observe(self, frame):
        self.seen.append(frame.index)
        values = np.asarray(self.maps(frame.index), np.float32)
        check_map(values, f"frame {frame.index}", signed=False)
        return RawDepth(values)

    def freeze(self, samples):
        """Nothing to fix."""

    def convert(self, raw):
        return positive(raw.values)


def tilted(far: float) -> np.ndarray:
    """Depth that grows evenly from half of `far` to `far`."""
    return np.broadcast_to(np.linspace(far / 2, far, 40), (30, 40))


# Normalisation


def test_normalise_marks_everything_unusable_as_invalid():
    depth = np.array([np.nan, np.inf, -np.inf, -1.0, 0.0, 1e-9], np.float32)
    assert normalise(depth, 2.0).tolist() == [0, 0, 0, 0, 0, np.float32(1 / 65535)]


@settings(max_examples=40)
@given(
    depth=hnp.arrays(np.float32, (5, 7), elements=st.floats(0, 100, width=32, allow_subnormal=False)),
    scale=st.floats(0.01, 100),
    bits=st.sampled_from([8, 16]),
)
def test_normalise_stays_on_the_levels_and_within_half_a_step(depth, scale, bits):
    z = normalise(depth, scale, bits)
    levels = 2**bits - 1
    assert z.dtype == np.float32
    assert np.array_equal(z > 0, depth > 0)
    assert np.allclose(z * levels, np.rint(z * levels), atol=1e-2)
    exact = np.minimum(depth.astype(np.float64) / scale, 1)
    step = np.where(exact * levels < 0.5, 1, 0.5) / levels  # A valid pixel is never rounded to invalid.
    assert (np.abs(z - exact) <= step + 1e-6)[depth > 0].all()


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf])
def test_normalise_refuses_an_impossible_scale(scale):
    with pytest.raises(ValueError, match="depth scale"):
        normalise(np.ones((2, 2)), scale)


# Resize


@settings(max_examples=30, deadline=None)
@given(
    labels=hnp.arrays(np.uint8, st.tuples(st.integers(8, 40), st.integers(8, 40)), elements=st.sampled_from([0, 1, 2])),
    size=st.tuples(st.integers(3, 45), st.integers(3, 45)),
    levels=st.tuples(*[st.floats(0.125, 1, width=32)] * 3),
)
def test_resize_never_blends_across_labels(labels, size, levels):
    """With one depth a label, every output pixel has exactly the depth of its own label."""
    table = np.array(levels, np.float32)
    depth, grid = resize_depth(table[labels], labels, size)
    assert depth.shape == grid.shape == size
    assert np.allclose(depth, table[grid], rtol=1e-5, atol=0)


@settings(max_examples=30, deadline=None)
@given(valid=hnp.arrays(bool, (24, 32)), size=st.tuples(st.integers(3, 40), st.integers(3, 40)))
def test_resize_never_blends_with_invalid_pixels(valid, size):
    depth, _ = resize_depth(np.where(valid, np.float32(0.7), 0), np.ones((24, 32), np.uint8), size)
    assert np.all((depth == 0) | np.isclose(depth, 0.7, rtol=1e-5))


def test_resize_keeps_a_cell_only_with_half_of_its_label_valid():
    depth = np.full((4, 8), 0.5, np.float32)
    depth[:3, :4] = 0  # a quarter valid
    depth[:2, 4:] = 0  # a half valid
    result, labels = resize_depth(depth, np.ones((4, 8), np.uint8), (1, 2))
    assert (result.tolist(), labels.tolist()) == ([[0, 0.5]], [[1, 1]])


def test_resize_refuses_maps_of_two_sizes():
    with pytest.raises(ValueError, match=r"\(3, 4\) and labels \(4, 3\)"):
        resize_depth(np.ones((3, 4), np.float32), np.ones((4, 3), np.uint8), (2, 2))


# Scale


def test_scale_is_the_far_end_of_a_clip_and_ignores_wild_pixels():
    depth = tilted(2.0).copy()
    depth[0, 0] = 1e6
    scale, focal = estimate_scale(blank(50), Planes(lambda index: depth), DepthSettings())
    assert (scale, focal) == (pytest.approx(2.0, rel=0.03), None)


def test_mismatches_beyond_three_medians_do_not_stretch_the_scale():
    depth = tilted(2.0).copy()
    depth[:2] = 500.0  # A stereo mismatch over 7 % of the picture.
    scale, _ = estimate_scale(blank(5), Planes(lambda index: depth), DepthSettings())
    assert scale == pytest.approx(3 * np.median(depth), rel=1e-6)


@pytest.mark.parametrize(
    ("source", "seconds", "samples", "usable", "seen", "most"),
    [
        (blank(500), 10, 20, lambda index: True, [*range(0, 100, 5)], 101),
        (blank(6), 10, 24, lambda index: True, [*range(6)], 6),
        (blank(10_000, live=True), 2, 4, lambda index: True, [0, 5, 10, 15], 21),
        (blank(60), 1, 2, lambda index: index >= 30 and index % 2 == 0, [*range(31), 35, 36], 60),
    ],
    ids=["the first seconds, evenly", "all of a short clip", "a live camera", "what follows unusable frames"],
)
def test_scale_is_that_of_the_configured_time(source, seconds, samples, usable, seen, most):
    planes = Planes(lambda index: tilted(2.0 if index < 100 else 9.0) if usable(index) else np.zeros((30, 40)))
    scale, _ = estimate_scale(source, planes, DepthSettings(scale_seconds=seconds, scale_samples=samples))
    assert (scale, planes.seen) == (pytest.approx(2.0, rel=0.03), seen)
    assert source.read <= most


def test_a_clip_without_usable_depth_gets_a_sentence():
    with pytest.raises(InputError, match=r"mp4 has no frame with usable depth; frame 0 is zero everywhere; .*choose"):
        estimate_scale(blank(5), Planes(lambda index: np.zeros((30, 40))), DepthSettings())
    with pytest.raises(InputError, match=r"mp4 has no frame with usable depth; choose another .*depth\.source"):
        estimate_scale(blank(0), Planes(lambda index: tilted(2.0)), DepthSettings())


def test_a_given_scale_is_taken_as_it_is_and_nothing_is_read():
    planes = Planes(lambda index: tilted(2.0))
    assert estimate_scale(blank(5), planes, DepthSettings(scale=7.5)) == (7.5, None)
    assert planes.seen == []


# Choice of the source


def test_auto_prefers_stored_depth_and_falls_back_to_photometric(tmp_path):
    layout = ClipLayout()
    stored, bare = (open_source(write_clip(tmp_path / name, frames=3), layout) for name in "ab")
    assert isinstance(open_depth(DepthSettings(), layout, stored), StoredDepth)
    for file in bare.path.glob("*_depth.png"):
        file.unlink()
    assert open_depth(DepthSettings(), layout, bare).identity == "photometric"
    with pytest.raises(InputError, match=r"b has no stored depth \(frame_\{number\}_endo_depth.png\)"):
        open_depth(DepthSettings(source="stored"), layout, bare)
    assert open_depth(DepthSettings(source="photometric"), layout, stored).identity == "photometric"


def test_stored_depth_of_a_video_gets_a_sentence(tmp_path):
    with pytest.raises(InputError, match=r"clip.mp4 is no folder"):
        open_depth(DepthSettings(source="stored"), ClipLayout(), blank(2))


def test_declared_depth_scale_is_honoured_for_stored_depth_only(tmp_path):
    layout, source = ClipLayout(), open_source(write_clip(tmp_path / "a", frames=3), ClipLayout())
    depth = open_depth(DepthSettings(), layout, source)
    scale, _ = estimate_scale(source, depth, DepthSettings())
    assert scale == 1.0
    z = normalise(depth(next(iter(source))), scale)
    expected = np.rint(np.array([0.5, 0.5 + 95 * SLOPE]) * 65535) / 65535
    assert z[[0, -1], 0] == pytest.approx(expected, abs=1e-6)
    settings_ = DepthSettings(source="photometric")
    assert estimate_scale(source, open_depth(settings_, layout, source), settings_)[0] != 1.0


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"near": 0.2, "far": 0.1}, "0 < near < far"),
        ({"near": 0.0}, "0 < near < far"),
        ({"field_of_view_deg": 180}, "field_of_view_deg"),
        ({"scale": 0}, "depth.scale is 0"),
        ({"scale_seconds": 0}, "scale_seconds"),
        ({"scale_samples": 0}, "scale_samples"),
        ({"threads": -1}, "threads"),
    ],
)
def test_impossible_settings_get_a_sentence(changes, expected):
    with pytest.raises(ValueError, match="depth\\.") as caught:
        replace(DepthSettings(), **changes)
    assert expected in str(caught.value)


# Real data


def test_real_sequence_with_stored_disparity(real_data):
    layout = load_layout(CHECKOUT / "configs" / "layouts" / "recover_tissue.yaml")
    source = open_source(real_data / "recover_tissue", layout)
    depth = open_depth(DepthSettings(), layout, source)
    scale, _ = estimate_scale(source, depth, DepthSettings())
    first = depth(next(iter(source)))
    assert first.shape == (540, 740)
    # The tissue lies at about 75 to 120 mm; 3 % of the pixels are mismatches of metres, which must not set the scale.
    assert 150 < scale < 350
    assert 0.2 < np.median(normalise(first, scale)) < 0.6


def test_real_clip_by_the_shipped_model(real_data):
    layout = ClipLayout()
    source = open_source(real_data / "cholecseg8k" / "video01" / "video01_00080", layout)
    settings_ = DepthSettings(scale_samples=4)
    depth = open_depth(settings_, layout, source)
    scale, _ = estimate_scale(source, depth, settings_)
    z = normalise(depth(next(iter(source))), scale)
    assert z.shape == (480, 854)
    # 15 % of the picture is black outside the endoscope's circle.
    assert 0.5 < (z > 0).mean() < 0.97
    assert 0.1 < np.median(z[z > 0]) < 0.9


@pytest.mark.parametrize("size", [(720, 1280), (480, 854), (480, 856), (121, 300), (80, 100)])
def test_areas_are_those_of_opencv_to_the_bit(size: tuple[int, int]) -> None:
    random = np.random.default_rng(5)
    labels = cv2.resize(random.choice(np.uint8([*ORDER, 7]), (9, 16)), size[::-1], interpolation=cv2.INTER_NEAREST)
    depth = np.where(random.random(size) < 0.1, 0, random.random(size)).astype(np.float32)
    how = cv2.INTER_AREA if size[0] >= 120 else cv2.INTER_LINEAR
    for found, label in zip(np.moveaxis(label_areas(depth, labels, (120, 214)), 1, 0), ORDER, strict=True):
        member = (labels == label).astype(np.float32)
        expected = member, member * (depth > 0), member * depth
        assert np.array_equal(found, [cv2.resize(each, (214, 120), interpolation=how) for each in expected])
