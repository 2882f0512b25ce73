"""Outlines: instruments follow what a person has drawn once, and say when they can't be followed."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from palpate.data.labels import MaskError
from palpate.data.masks.annotation import AnnotationMasks
from palpate.data.masks.outlined import OutlinedMasks
from palpate.data.masks.request import MaskClasses, MaskRequest
from palpate.data.masks.sources import open_masks
from palpate.data.source.frames import Frame, open_source
from palpate.data.source.layout import ClipLayout, InputError, load_layout
from tests.conftest import CHECKOUT

WIDTH, HEIGHT = 480, 320
LENGTH, THICK = 500.0, 30.0


def texture(seed: int, shape: tuple[int, int], colour: tuple[float, float, float]) -> np.ndarray:
    values = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=shape), (0, 0), 2.5)
    return np.clip(np.array(colour) * (1 + 0.25 * values / values.std())[..., None], 0, 255)


TISSUE_PICTURE = texture(0, (HEIGHT, WIDTH), (170, 80, 70))
SHAFT = texture(1, (int(THICK), int(LENGTH)), (120, 120, 125))


def corners(tip: tuple[float, float], angle: float, length: float = LENGTH) -> np.ndarray:
    """Corners of a shaft that ends at `tip` and comes from the left, shape [4, 2] [px]."""
    axis = np.array([np.cos(angle), np.sin(angle)])
    across = THICK / 2 * np.array([-axis[1], axis[0]])
    tail = np.array(tip) - length * axis
    return np.array([tail - across, tip - across, tip + across, tail + across])


def picture(*shafts: tuple[tuple[float, float], float]) -> tuple[np.ndarray, np.ndarray]:
    """Shafts over tissue, RGB uint8 [H, W, 3], and their mask."""
    found, mask = TISSUE_PICTURE.copy(), np.zeros((HEIGHT, WIDTH), bool)
    for tip, angle in shafts:
        ends = np.float32([[0, 0], [LENGTH, 0], [LENGTH, THICK]])
        matrix = cv2.getAffineTransform(ends, corners(tip, angle)[:3].astype(np.float32))
        there = cv2.warpAffine(np.ones(SHAFT.shape[:2], np.uint8), matrix, (WIDTH, HEIGHT)) > 0
        found[there] = cv2.warpAffine(SHAFT, matrix, (WIDTH, HEIGHT))[there]
        mask |= there
    return found.astype(np.uint8), mask


def frame(number: int, image: np.ndarray) -> Frame:
    return Frame(number, number, number / 25, image)


def outlines(folder: Path, polygons: dict[int, list[np.ndarray]]) -> Path:
    path = folder / "outlines.yaml"
    path.write_text(json.dumps({number: [each.tolist() for each in found] for number, found in polygons.items()}))
    return path


def visible(tip: tuple[float, float], angle: float) -> np.ndarray:
    """What a person outlines of a shaft: up to the picture's left side."""
    return corners(tip, angle, (tip[0] - 2) / np.cos(angle))


def overlap(labels: np.ndarray, mask: np.ndarray) -> float:
    return ((labels == 2) & mask).sum() / ((labels == 2) | mask).sum()


def test_a_shaft_is_followed_as_it_comes_in_and_turns(tmp_path):
    path = [((110 + 6 * step, 150 + 2 * step), 0.15 + 0.01 * step) for step in range(25)]
    drawn = outlines(tmp_path, {0: [visible(*path[0])]})
    masks = open_masks(str(drawn), ClipLayout(), MaskClasses(), tmp_path / "clip.mp4")
    for number, place in enumerate(path):
        image, mask = picture(place)
        labels = masks(frame(number, image))
        assert overlap(labels, mask) > 0.9
        assert (labels[~mask] == 1).mean() > 0.98
    # A clip that is read again begins anew.
    masks.reset()
    image, mask = picture(path[0])
    assert overlap(masks(frame(0, image)), mask) > 0.95


def test_jagged_sides_of_a_cut_leave_a_shaft_straight(tmp_path):
    """The outline is one that the page cut out of the first picture."""
    upper = [(111, 136), (106, 133), (82, 130), (80, 128), (71, 128), (68, 125), (42, 125), (37, 122), (27, 122),
             (25, 120), (20, 119), (18, 117), (5, 116)]  # fmt: skip
    lower = [(0, 119), (0, 148), (14, 149), (16, 151), (26, 151), (30, 154), (46, 154), (50, 157), (57, 159),
             (83, 160), (91, 165), (95, 165), (107, 163), (110, 159)]  # fmt: skip
    masks = OutlinedMasks(outlines(tmp_path, {0: [np.array(lower + upper)]}))
    for step in range(12):
        image, mask = picture(((110 + 6 * step, 150 + 2 * step), 0.15 + 0.01 * step))
        assert overlap(masks(frame(step, image)), mask) > 0.85


def test_two_shafts_of_which_one_leaves_the_picture(tmp_path):
    masks = OutlinedMasks(outlines(tmp_path, {0: [visible((200, 100), 0.1), visible((150, 250), -0.1)]}))
    for number in range(26):
        shafts = ((200 - 10 * number, 100 - number), 0.1), ((150 + 3 * number, 250), -0.1)
        image, mask = picture(*shafts)
        assert overlap(masks(frame(number, image)), mask) > 0.9


def test_a_shaft_that_is_lost_is_said_until_it_is_outlined_again(tmp_path):
    place, other = ((200, 150), 0.1), ((300, 100), 0.3)
    masks = OutlinedMasks(outlines(tmp_path, {3: [visible(*place)], 6: [visible(*other)], 8: []}))
    with pytest.raises(MaskError, match="outlines no instrument before frame 3; give `2: "):
        masks(frame(2, picture(place)[0]))
    masks(frame(3, picture(place)[0]))
    elsewhere = np.random.default_rng(0).integers(60, 200, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    for number in (4, 5):
        with pytest.raises(MaskError, match="outlined in frame 3 can't be followed here; outline it again in outlines"):
            masks(frame(number, elsewhere))
    # Frame 6 can't be read, so that its outline counts in the next one.
    image, mask = picture(other)
    assert overlap(masks(frame(7, image)), mask) > 0.9
    assert not (masks(frame(8, image)) == 2).any()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{}", "holds no frame"),
        ("- 1", "is not outlines of instruments"),
        ("0: 3", "'0' with what are no polygons"),
        ("first: []", "'first' with what are no polygons"),
        ("0: [[[1, 2], [3, 4]]]", "frame 0 of fewer than three corners"),
        ("0: [[1, 2, 3]]", "frame 0 of fewer than three corners"),
        ("0.5: [[[1, 2], [3, 4], [5, 9]]]", "holds '0.5' with what are no polygons"),
        ("true: [[[1, 2], [3, 4], [5, 9]]]", "holds 'True' with what are no polygons"),
        ("0: [" + "[[1, 2], [3, 4], [5, 9]]," * 51 + "]", "has 51 outlines in frame 0; give 50 at most"),
        ("0: [[[1, 2], [3, 4], [5]]]", "'0' with what are no polygons"),
        ("-1: [[[1, 2], [3, 4], [5, 6]]]", "frame -1 of fewer"),
        ("0: [[[1, 2], [3, 4], [5, .nan]]]", "corner in frame 0 that lies in no picture"),
        ("0: [[[1, 2], [3, 4], [5, 1.0e+9]]]", "corner in frame 0 that lies in no picture"),
    ],
)
def test_what_is_no_outline_is_a_sentence(tmp_path, text, said):
    path = tmp_path / "outlines.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as error:
        OutlinedMasks(path)
    assert str(path) in str(error.value)


def test_a_real_grasper_is_followed_as_docs_masks_reports(real_data):
    outlined = OutlinedMasks(CHECKOUT / "configs" / "outlines" / "video01_00080.yaml")
    source = open_source(real_data / "cholecseg8k" / "video01" / "video01_00080", ClipLayout())
    annotation = AnnotationMasks(MaskRequest(source.path, ClipLayout(), MaskClasses()))
    for each in source:
        number = each.number - 80
        tool = outlined(replace(each, number=number)) == 2
        if number < 70:
            assert not tool.any()
        elif number >= 75:  # both jaws are outlined, with some tissue between and around them
            held = annotation(each) == 2
            assert (tool & held).sum() > 0.98 * held.sum()
            assert (tool & held).sum() > 0.45 * tool.sum()


def test_real_instruments_stay_on_annotated_ones(real_data):
    outlined = OutlinedMasks(CHECKOUT / "configs" / "outlines" / "recover_tissue.yaml")
    layout = load_layout(CHECKOUT / "configs" / "layouts" / "recover_tissue.yaml")
    source = open_source(real_data / "recover_tissue", layout)
    annotation = AnnotationMasks(MaskRequest(source.path, layout, MaskClasses()))
    for index, each in enumerate(source):
        tool = outlined(replace(each, number=index)) == 2
        assert tool.sum() > 50_000
        assert (annotation(each)[tool] == 2).mean() > 0.95
