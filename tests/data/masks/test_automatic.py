"""The automatic mode finds instruments by the network that ships and abstains on tissue."""

import cv2
import numpy as np
import pytest

from palpate.data.labels import TISSUE, TOOL, UNSURE
from palpate.data.masks.annotation import AnnotationMasks
from palpate.data.masks.automatic import AutomaticMasks, instrument_parts
from palpate.data.masks.lit import lit_picture, picture_field
from palpate.data.masks.request import MaskClasses, MaskRequest
from palpate.data.source.frames import Frame, open_source
from palpate.data.source.layout import ClipLayout, load_layout
from tests.conftest import CHECKOUT

HEIGHT, WIDTH = 360, 640
REAL_IOU, REAL_FALSE = 0.1, 2
"""Least mean IoU, and tool-free frames in which a tool is found at most, on the real clip."""


def tissue(seed: int = 0) -> np.ndarray:
    """Reddish texture with a pale organ and a few vessels, RGB float [H, W, 3]."""
    rng = np.random.default_rng(seed)
    texture = sum(cv2.GaussianBlur(rng.normal(size=(HEIGHT, WIDTH)), (0, 0), s) * s for s in (3, 9, 27))
    shade = 0.6 + 0.1 * texture / texture.std()
    image = np.dstack([220 * shade, 95 * shade, 85 * shade])
    organ = np.zeros((HEIGHT, WIDTH), np.float32)
    cv2.ellipse(organ, (250, 160), (60, 120), 20, 0, 360, 1.0, -1)
    organ = cv2.GaussianBlur(organ, (0, 0), 2)[..., None]
    image = image * (1 - organ) + np.dstack([250 * shade, 200 * shade, 160 * shade]) * organ
    for _ in range(4):
        knots = rng.uniform((0, 0), (WIDTH, HEIGHT), (6, 2)).cumsum(axis=0) / np.arange(1, 7)[:, None]
        cv2.polylines(image, [np.int32(knots)], False, (150.0, 30.0, 40.0), 2, cv2.LINE_AA)
    return image


def draw_shaft(image: np.ndarray, tip: tuple[float, float], angle: float, width: float) -> np.ndarray:
    """Draw a grey cylinder from the tip outwards along an angle [rad]; returns its mask [H, W]."""
    axis = np.array([np.cos(angle), np.sin(angle)])
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    along, across = (u - tip[0]) * axis[0] + (v - tip[1]) * axis[1], (v - tip[1]) * axis[0] - (u - tip[0]) * axis[1]
    mask = (along > 0) & (np.abs(across) < width / 2)
    shade = 60 + 120 * np.sqrt(np.clip(1 - (2 * across / width) ** 2, 0, 1))
    image[mask] = shade[mask, None] * np.array([1.0, 1.0, 1.03])
    return mask


def as_frame(image: np.ndarray, index: int = 0) -> Frame:
    noise = np.random.default_rng(index).normal(0, 2, image.shape)
    return Frame(index, index, index / 25, np.clip(image + noise, 0, 255).astype(np.uint8))


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return (a & b).sum() / (a | b).sum()


@pytest.mark.parametrize(
    ("angle", "width", "size"),
    [(0.4, 30, (640, 360)), (-0.5, 45, (640, 360)), (np.pi / 2, 26, (854, 480)), (2.7, 36, (214, 120))],
)
def test_shaft_from_the_border_is_found(angle, width, size):
    image = tissue()
    mask = draw_shaft(image, (330, 180), angle, width)
    frame = as_frame(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    labels = AutomaticMasks()(frame)
    truth = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(bool)
    assert overlap(labels == 2, truth) > 0.75
    assert (labels[~cv2.dilate(truth.astype(np.uint8), np.ones((9, 9))).astype(bool)] == 1).mean() > 0.99


@pytest.mark.parametrize("seed", range(3))
def test_tissue_without_instrument_is_left_alone(seed):
    masks = AutomaticMasks()
    for index in range(2):
        labels = masks(as_frame(np.roll(tissue(seed), 3 * index, axis=1), index))
        assert not (labels == 2).any()
        assert (labels == 1).mean() > 0.99


def test_unlit_pixels_are_neither_and_the_circle_is_no_edge():
    image = tissue()
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    outside = np.hypot(u - 320, v - 180) > 200
    image[outside] = 4
    image[250:300, 300:360] = 3
    labels = AutomaticMasks()(as_frame(image))
    assert (labels[outside & (np.hypot(u - 320, v - 180) > 205)] == 0).all()
    assert (labels[255:295, 305:355] == 0).all()
    assert not (labels == 2).any()
    field = picture_field(lit_picture(as_frame(image).image))
    assert field[275, 330]
    assert not field[5, 5]


@pytest.mark.parametrize("value", [0, 255])
def test_black_and_white_pictures(value):
    """A covered lens shows neither tool nor tissue."""
    masks = AutomaticMasks()
    for index in range(3):
        labels = masks(Frame(index, index, index / 25, np.full((48, 64, 3), value, np.uint8)))
        assert (labels == (1 if value else 0)).all()


def test_result_depends_on_the_clip_only_through_reset_state():
    image = tissue()
    draw_shaft(image, (330, 180), 0.4, 30)
    masks = AutomaticMasks()
    first = masks(as_frame(image))
    masks(as_frame(tissue(3), 1))
    masks.reset()
    assert np.array_equal(masks(as_frame(image)), first)


def test_small_unsure_new_or_enclosed_parts_are_no_instrument():
    probability, view = np.zeros((112, 192), np.float32), np.ones((112, 192), bool)
    probability[10:40, :60] = 0.95
    expected = probability > 0
    probability[0:4, 100:104], probability[80:, 150:], probability[90:, :40] = 0.99, 0.55, 0.9
    probability[50:62, 90:110] = 0.95  # far from where anything enters
    probability[0:5, 120:190] = 0.95  # along the rim
    before = np.where(np.arange(112)[:, None] < 80, probability, 0.1)
    np.testing.assert_array_equal(instrument_parts(probability, view, before), expected)
    view[:, :50] = False  # cut off by the view, it still enters
    np.testing.assert_array_equal(instrument_parts(probability, view, before), expected & view)


def moving(step: int) -> tuple[np.ndarray, np.ndarray]:
    """A shaft that goes to the left, and its mask."""
    image = tissue()
    mask = draw_shaft(image, (330 - 5 * step, 180 + step), 0.4, 30)
    return image, mask


def test_where_the_network_runs_in_one_frame_of_three_instruments_are_carried_along(monkeypatch):
    masks = AutomaticMasks(every=3)
    ran, run = [], masks.network.run
    monkeypatch.setattr(masks.network, "run", lambda *asked: ran.append(1) or run(*asked))
    for step in range(7):
        image, mask = moving(step)
        assert overlap(masks(as_frame(image, step)) == 2, mask) > 0.7
    assert len(ran) == 3
    assert masks.identity == AutomaticMasks().identity + ":3"


@pytest.mark.acceptance
def test_real_clip_keeps_what_docs_masks_reports(real_data):
    layout = ClipLayout()
    clip = real_data / "cholecseg8k" / "video01" / "video01_00080"
    annotation, automatic = AnnotationMasks(MaskRequest(clip, layout, MaskClasses())), AutomaticMasks()
    false, scores = [], {}
    for frame in open_source(clip, layout):
        truth, found = annotation(frame) == 2, automatic(frame) == 2
        if truth.any():
            scores[frame.number] = overlap(truth, found)
        elif found.any():
            false.append(frame.number)
    assert len(scores) == 11
    assert np.mean(list(scores.values())) > REAL_IOU
    assert len(false) <= REAL_FALSE


@pytest.mark.slow
def test_in_a_real_pull_an_instrument_is_found_in_every_frame(real_data):
    layout = load_layout(CHECKOUT / "configs" / "layouts" / "recover_tissue.yaml")
    source, automatic = open_source(real_data / "recover_tissue", layout), AutomaticMasks()
    annotation = AnnotationMasks(MaskRequest(source.path, layout, MaskClasses()))
    for frame in source:
        found = automatic(frame) == 2
        assert found.any()
        assert (annotation(frame) == 2)[found].mean() > 0.98


def test_pixels_that_may_be_an_instrument_are_marked(monkeypatch):
    likely = np.zeros((96, 160), np.float32)
    likely[:60, 60:100], likely[:50, 70:90] = 0.3, 0.9
    monkeypatch.setattr(AutomaticMasks, "_averaged", lambda *_: (likely, likely))
    labels = AutomaticMasks()(as_frame(tissue()))
    assert [labels[row, 320] for row in (100, 215, 300)] == [TOOL, UNSURE, TISSUE]
    assert [(labels == value).mean() for value in (TOOL, UNSURE)] == pytest.approx([50 / 768, 70 / 768], rel=0.05)
