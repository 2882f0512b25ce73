"""Annotation masks: classes by colour, stray formats, and one sentence for what can't be used."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.data.labels import MaskError
from palpate.data.masks import annotation
from palpate.data.masks.annotation import read_class_mask
from palpate.data.masks.automatic import WEIGHTS, AutomaticMasks
from palpate.data.masks.class_table import CLASSES
from palpate.data.masks.request import MaskClasses
from palpate.data.masks.sources import open_masks
from palpate.data.source.frames import Frame, open_source
from palpate.data.source.layout import ClipLayout, InputError, load_layout
from tests.conftest import CHECKOUT

SIZE = (20, 30)


def color_mask() -> np.ndarray:
    """Liver with a gallbladder, a grasper and an L-hook, RGB."""
    mask = np.full((*SIZE, 3), CLASSES["liver"].color, np.uint8)
    mask[5:15, 5:12] = CLASSES["gallbladder"].color
    mask[5:15, 12:18] = CLASSES["grasper"].color
    mask[5:15, 20:25] = CLASSES["l-hook electrocautery"].color
    mask[0] = 255
    return mask


def expected_labels() -> np.ndarray:
    labels = np.zeros(SIZE, np.uint8)
    labels[5:15, 5:12], labels[5:15, 12:18] = 1, 2
    return labels


LAYOUT, CLASSES_USED = ClipLayout(), MaskClasses()


def opened(kind: str, clip: Path, layout: ClipLayout = LAYOUT, classes: MaskClasses = CLASSES_USED):
    return open_masks(kind, layout, classes, clip)


def write(path: Path, image: np.ndarray) -> Path:
    stored = image if image.ndim == 2 else image[..., [2, 1, 0, *range(3, image.shape[2])]]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", np.ascontiguousarray(stored))[1].tobytes())
    return path


def frame_in(folder: Path, number: int = 80) -> Frame:
    return Frame(0, number, 0.0, np.full((*SIZE, 3), 100, np.uint8), folder / f"frame_{number}_endo.png")


def test_class_colours_differ_by_more_than_twice_the_largest_tolerance():
    colors = [np.array(entry.color, int) for entry in CLASSES.values()]
    distances = [np.abs(a - b).sum() for i, a in enumerate(colors) for b in colors[:i]]
    assert min(distances) == 85 > 2 * 42
    assert len({entry.grey for entry in CLASSES.values()}) == len(CLASSES)


@settings(max_examples=40, deadline=None)
@given(st.tuples(*[st.integers(-4, 4)] * 3))
def test_a_pixel_belongs_to_a_class_within_an_l1_distance_of_5(tmp_path_factory, offset):
    mask = color_mask()
    near = np.clip(np.array(CLASSES["gallbladder"].color) + offset, 0, 255)
    mask[10, 8] = near
    path = write(tmp_path_factory.mktemp("m") / "m.png", mask)
    distance = np.abs(near - np.array(CLASSES["gallbladder"].color)).sum()
    assert (read_class_mask(path, SIZE, CLASSES_USED)[10, 8] == 1) == (distance <= 5)


def test_colour_rgba_grey_and_grey_as_rgb_masks_agree(tmp_path):
    mask = color_mask()
    grey = np.full(SIZE, CLASSES["liver"].grey, np.uint8)
    grey[5:15, 5:12], grey[5:15, 12:18] = CLASSES["gallbladder"].grey, CLASSES["grasper"].grey
    grey[5:15, 20:25], grey[0], grey[19] = CLASSES["l-hook electrocautery"].grey, 0, 35
    alpha = np.random.default_rng(0).integers(0, 256, (*SIZE, 1), dtype=np.uint8)
    for image in (mask, np.dstack([mask, alpha]), grey, np.dstack([grey] * 3)):
        path = write(tmp_path / "m.png", image)
        assert np.array_equal(read_class_mask(path, SIZE, CLASSES_USED), expected_labels())


def test_masks_in_another_code_are_no_masks(tmp_path):
    """Colours in the order of OpenCV, or 255 for a tool; nothing at all, and classes nobody asked for, are masks."""
    tool = np.zeros(SIZE, np.uint8)
    tool[5:15, 12:18] = 255
    for other in (color_mask()[..., ::-1], tool):
        with pytest.raises(MaskError, match=r"m\.png holds hardly a class .* give a layout with label_mask"):
            read_class_mask(write(tmp_path / "m.png", other), SIZE, CLASSES_USED)
    hook = np.where(tool == 255, CLASSES["l-hook electrocautery"].grey, 0).astype(np.uint8)
    for nothing in (np.zeros(SIZE, np.uint8), hook):
        assert not read_class_mask(write(tmp_path / "m.png", nothing), SIZE, CLASSES_USED).any()


def test_other_classes_by_configuration(tmp_path):
    path = write(tmp_path / "m.png", color_mask())
    labels = read_class_mask(path, SIZE, MaskClasses(("l-hook electrocautery",), ("liver", "gallbladder")))
    assert (labels[5:15, 20:25] == 2).all()
    assert labels[1, 1] == labels[8, 8] == 1
    assert (labels[5:15, 12:18] == 0).all()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"tool": ("graspr",)}, "'graspr', which is no class; choose from background"),
        ({"tissue": ()}, "names no class"),
        ({"tool": ("liver",), "tissue": ("liver",)}, "both name 'liver'"),
        ({"tolerance": -1}, "give 0 to 42"),
    ],
)
def test_impossible_classes_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        MaskClasses(**values)


def test_brush_strokes_are_never_read_and_watershed_stands_in(tmp_path):
    write(tmp_path / "frame_80_endo_mask.png", color_mask())
    with pytest.raises(InputError, match="holds no annotation masks") as caught:
        opened("annotation", tmp_path)
    assert not isinstance(caught.value, MaskError)
    grey = np.full(SIZE, CLASSES["gallbladder"].grey, np.uint8)
    write(tmp_path / "frame_80_endo_watershed_mask.png", grey)
    masks = opened("annotation", tmp_path)
    assert (masks(frame_in(tmp_path)) == 1).all()
    write(tmp_path / "frame_80_endo_color_mask.png", color_mask())
    assert np.array_equal(masks(frame_in(tmp_path)), expected_labels())


def test_one_frames_bad_mask_is_that_frames_error(tmp_path):
    write(tmp_path / "frame_80_endo_color_mask.png", color_mask())
    masks = opened("auto", tmp_path)
    assert np.array_equal(masks(frame_in(tmp_path)), expected_labels())
    write(tmp_path / "frame_83_endo_color_mask.png", color_mask()[:-2])
    for number, content in ((82, b""), (84, cv2.imencode(".png", np.zeros(SIZE, np.uint16))[1].tobytes())):
        (tmp_path / f"frame_{number}_endo_color_mask.png").write_bytes(content)
    for number, said in {
        81: r"frame_81_endo_color_mask\.png does not exist; add the mask of frame 81",
        82: r"empty file \(0 bytes\)",
        83: "is 30x18 while its frame is 30x20",
        84: "not an 8-bit mask",
    }.items():
        with pytest.raises(MaskError, match=said):
            masks(frame_in(tmp_path, number))


def test_auto_is_annotation_where_the_clip_has_any(tmp_path):
    assert isinstance(opened("auto", tmp_path / "video.mp4"), AutomaticMasks)
    assert isinstance(opened("auto", tmp_path), AutomaticMasks)
    write(tmp_path / "frame_80_endo_color_mask.png", color_mask())
    assert isinstance(opened("auto", tmp_path), annotation.AnnotationMasks)
    assert isinstance(opened("automatic", tmp_path), AutomaticMasks)
    assert opened(str(WEIGHTS), tmp_path).identity == AutomaticMasks().identity
    other = MaskClasses(tool=("l-hook electrocautery",))
    assert opened("auto", tmp_path).identity != opened("auto", tmp_path, classes=other).identity


@pytest.mark.parametrize(
    ("kind", "clip", "layout", "said"),
    [
        ("annotation", "video.mp4", LAYOUT, "use --masks automatic"),
        ("annotation", "", ClipLayout(color_mask=None, class_mask=None), "the layout names no annotation masks"),
        ("watershed", "", LAYOUT, "choose auto, annotation, automatic"),
    ],
)
def test_masks_that_are_not_there_get_a_sentence(tmp_path, kind, clip, layout, said):
    with pytest.raises(InputError, match=said):
        opened(kind, tmp_path / clip, layout)


def test_label_mask_of_inverse_polarity_and_opening(tmp_path):
    layout = ClipLayout(label_mask="m/{number}.png", tool_values=(0,), tissue_values=(1,), mask_opening_px=7)
    mask = np.ones((60, 60), np.uint8)
    mask[20:40, 0:30] = 0
    mask[50:53, 50:53] = 0
    labels = annotation.read_label_mask(write(tmp_path / "m.png", mask), (60, 60), layout)
    assert (labels[22:38, 0:28] == 2).all()
    assert (labels[50:53, 50:53] == 0).all()
    assert (labels[mask == 1] == 1).all()
    with pytest.raises(MaskError, match="not a label mask"):
        annotation.read_label_mask(write(tmp_path / "m.png", color_mask()), SIZE, layout)


def test_real_clip_annotation(real_data):
    source = open_source(real_data / "cholecseg8k" / "video01" / "video01_00080", LAYOUT)
    masks = opened("auto", source.path)
    tool = {frame.number: int((masks(frame) == 2).sum()) for frame in source if frame.number in (80, 148, 149, 159)}
    assert tool == {80: 0, 148: 0, 149: 283, 159: 7059}


def test_real_recover_masks(real_data):
    layout = load_layout(CHECKOUT / "configs" / "layouts" / "recover_tissue.yaml")
    frame = next(iter(open_source(real_data / "recover_tissue", layout)))
    labels = opened("annotation", real_data / "recover_tissue", layout)(frame)
    counts = np.bincount(labels.ravel(), minlength=3)
    assert counts[1] == 303301
    assert 0.99 * 96299 < counts[2] <= 96299
