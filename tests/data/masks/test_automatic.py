"""The automatic mode finds instruments by shape and abstains on tissue."""

import cv2
import numpy as np
import pytest

from palpate.data.masks import automatic as module
from palpate.data.masks.automatic import AutomaticMasks, brightest_channel, pallor
from palpate.data.masks.instrument_bands import Band, find_bands, straight_edges
from palpate.data.masks.sources import AnnotationMasks, MaskClasses
from palpate.data.source.frames import Frame, open_source
from palpate.data.source.layout import ClipLayout, load_layout
from tests.conftest import CHECKOUT

HEIGHT, WIDTH = 360, 640


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
    # A quarter of the small picture's tool pixels lie on the outline.
    assert overlap(labels == 2, truth) > (0.9 if size[0] > 300 else 0.75)
    assert (labels[~cv2.dilate(truth.astype(np.uint8), np.ones((9, 9))).astype(bool)] == 1).mean() > 0.99


@pytest.mark.parametrize("seed", range(3))
def test_tissue_without_instrument_is_left_alone(seed):
    masks = AutomaticMasks()
    for index in range(2):
        labels = masks(as_frame(np.roll(tissue(seed), 3 * index, axis=1), index))
        assert not (labels == 2).any()
        assert (labels == 1).mean() > 0.99


def test_grey_bar_that_reaches_no_border_is_not_an_instrument():
    image = tissue()
    cv2.line(image, (280, 190), (340, 200), (120.0, 120.0, 124.0), 16)
    assert not (AutomaticMasks()(as_frame(image)) == 2).any()


def test_two_instruments():
    image = tissue()
    mask = draw_shaft(image, (420, 200), 0.3, 30) | draw_shaft(image, (200, 220), np.pi - 0.3, 30)
    assert overlap(AutomaticMasks()(as_frame(image)) == 2, mask) > 0.85


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
    field = module.picture_field(module.lit_picture(as_frame(image).image))
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


def test_edges_of_a_bar_are_found_where_they_are():
    gray = np.full((200, 300), 100, np.uint8)
    gray[80:120] = 180
    edges = straight_edges(gray, np.ones_like(gray, bool))
    assert sorted(np.round(edges[:, 1]).tolist()) == pytest.approx([80, 120], abs=1)
    assert np.abs(edges[:, 2] - edges[:, 0]).min() > 280
    band = find_bands(gray, np.ones_like(gray, bool))[0]
    assert (band.width, band.gap, band.edges) == (pytest.approx(40, abs=1), pytest.approx(0, abs=8), 2)


def test_captions_along_the_image_side_are_skipped():
    gray = np.full((200, 300), 100, np.uint8)
    gray[170:190, :120] = 20
    assert not find_bands(gray, np.ones_like(gray, bool))


def test_band_samples_lie_inside_it():
    band = Band(np.array([10.0, 20.0]), np.array([1.0, 0.0]), 30.0, 8.0, 10.0, 2, 60.0)
    values = np.zeros((50, 60), np.float32)
    values[16:25, 10:41] = 1
    assert (module.band_values(band, values) == 1).all()
    assert sorted(map(tuple, band.outline(0, 30).tolist())) == [(10, 16), (10, 24), (40, 16), (40, 24)]


def test_pallor_compares_equal_brightness():
    image = np.zeros((40, 40, 3), np.float32)
    image[:20] = (200, 150, 140)
    image[20:] = (100, 40, 40)
    image[25:30, 10:15] = (100, 100, 100)
    red, bright = module.redness(image), brightest_channel(image)
    pale = pallor(red, bright, np.ones((40, 40), bool))
    # Redness is 55/208 and 60/108 of the two tissues and 0 of the patch; it is told to half a level.
    level = 2 / module.LEVELS
    assert (red[5, 5], pale[27, 12]) == (pytest.approx(55 / 208), pytest.approx(60 / 108, abs=level))
    assert (pale[5, 5], pale[36, 36]) == (pytest.approx(0, abs=level), pytest.approx(0, abs=level))
    assert (pallor(red, bright, np.zeros((40, 40), bool)) == 0).all()


def test_pallor_is_against_a_quantile_at_equal_brightness():
    rng = np.random.default_rng(1)
    red, bright = rng.uniform(0.1, 0.6, (60, 80)).astype(np.float32), rng.uniform(0, 255, (60, 80)).astype(np.float32)
    lit = rng.random((60, 80)) < 0.8
    pale, least = pallor(red, bright, lit), 0.45 * np.median(red[lit])
    for level in range(16):
        here = lit & (bright // 16 == level)
        expected = max(np.quantile(red[here], 0.2), least) - red[here]
        assert pale[here] == pytest.approx(expected, abs=0.01)  # neighbouring values lie so far apart
    assert (pale[~lit] == 0).all()


def test_brightest_channel_is_the_maximum():
    image = np.random.default_rng(0).integers(0, 256, (9, 11, 3), dtype=np.uint8)
    assert np.array_equal(brightest_channel(image), image.max(axis=2))


@pytest.mark.slow
def test_real_clip_keeps_what_docs_masks_reports(real_data):
    layout = ClipLayout()
    clip = real_data / "cholecseg8k" / "video01" / "video01_00080"
    annotation, automatic = AnnotationMasks(layout, MaskClasses(), clip), AutomaticMasks()
    false, scores = [], {}
    for frame in open_source(clip, layout):
        truth, found = annotation(frame) == 2, automatic(frame) == 2
        if truth.any():
            scores[frame.number] = overlap(truth, found)
        elif found.any():
            false.append(frame.number)
    assert false == []
    assert len(scores) == 11
    assert np.mean(list(scores.values())) > 0.25
    assert min(scores[number] for number in range(155, 160)) > 0.4


@pytest.mark.slow
def test_in_a_real_pull_an_instrument_is_found_in_every_frame(real_data):
    layout = load_layout(CHECKOUT / "configs" / "layouts" / "recover_tissue.yaml")
    source, automatic = open_source(real_data / "recover_tissue", layout), AutomaticMasks()
    annotation = AnnotationMasks(layout, MaskClasses(), source.path)
    for frame in source:
        found = automatic(frame) == 2
        assert found.any()
        assert (annotation(frame) == 2)[found].mean() > 0.98


def moving(step: int) -> tuple[np.ndarray, np.ndarray]:
    """A shaft that goes to the left, and its mask."""
    image = tissue()
    mask = draw_shaft(image, (330 - 5 * step, 180 + step), 0.4, 30)
    return image, mask


def test_an_instrument_that_was_found_twice_is_followed_where_it_is_not_found(monkeypatch):
    masks, missed = AutomaticMasks(), []
    for step in range(2 + module.MOST_MISSED + 1):
        image, mask = moving(step)
        if step == 2:
            monkeypatch.setattr(AutomaticMasks, "_is_instrument", lambda *_: False)
        labels = masks(as_frame(image, step))
        missed.append(not (labels == 2).any())
        if not missed[-1]:
            assert overlap(labels == 2, mask) > 0.8  # more of it comes in from the edge
    assert missed == [False] * (2 + module.MOST_MISSED) + [True]


def test_where_instruments_are_sought_in_one_frame_of_three_they_are_followed_in_the_others(monkeypatch):
    sought, find = [], AutomaticMasks._find_tool
    monkeypatch.setattr(AutomaticMasks, "_find_tool", lambda *asked: sought.append(1) or find(*asked))
    masks = AutomaticMasks(3)
    for step in range(8):
        image, mask = moving(step)
        assert overlap(masks(as_frame(image, step)) == 2, mask) > 0.8
    assert len(sought) == 3
    assert masks.identity != AutomaticMasks().identity


def test_an_instrument_that_comes_into_view_is_sought_at_once(monkeypatch):
    sought, find = [], AutomaticMasks._find_tool
    monkeypatch.setattr(AutomaticMasks, "_find_tool", lambda *asked: sought.append(1) or find(*asked))
    masks = AutomaticMasks(5)
    for index in range(2):
        assert not (masks(as_frame(tissue(), index)) == 2).any()
    assert len(sought) == 1  # noise is no change
    image, mask = moving(0)
    assert overlap(masks(as_frame(image, 2)) == 2, mask) > 0.8
    assert len(sought) == 2


def test_what_was_found_once_is_not_followed(monkeypatch):
    masks = AutomaticMasks()
    assert (masks(as_frame(moving(0)[0])) == 2).any()
    monkeypatch.setattr(AutomaticMasks, "_is_instrument", lambda *_: False)
    assert not (masks(as_frame(moving(1)[0], 1)) == 2).any()
