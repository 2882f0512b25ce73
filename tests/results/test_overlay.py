"""Drawings on a frame."""

import dataclasses

import numpy as np
import pytest

from palpate.estimators.records import FrameEstimate, Touch
from palpate.results import overlay
from palpate.results.overlay import canvas_size, draw_overlay, panel_corner, text_width, wrap_text
from palpate.results.verdicts import NOTES
from tests.estimators.estimates import frame_in_contact

SIZE = (640, 360)
THETA = (0.5, 0.1, -2.0)
OK = frame_in_contact("undetermined", THETA, contact=True, touch=Touch(contact_u=400.0, contact_v=200.0))


def grey(size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.full((size[1], size[0], 3), 90, np.uint8)


def labels() -> np.ndarray:
    found = np.zeros((180, 320), np.uint8)
    found[80:150, 150:300] = overlay.TISSUE
    found[60:80, 200:220] = overlay.TOOL
    return found


@pytest.mark.parametrize(
    ("size", "expected"), [((854, 480), (854, 480)), ((741, 539), (742, 540)), ((213, 119), (640, 358))]
)
def test_canvas_is_even_and_wide_enough(size: tuple[int, int], expected: tuple[int, int]) -> None:
    assert canvas_size(size) == expected


def test_outlines_lie_where_the_masks_end() -> None:
    plain = draw_overlay(grey(), SIZE, None, FrameEstimate(7, 0.28, "no_contact"))
    drawn = draw_overlay(grey(), SIZE, labels(), FrameEstimate(7, 0.28, "no_contact"))
    changed = (plain != drawn).any(axis=2)
    rows, columns = np.nonzero(changed)
    # Label pixel i covers the picture's pixels 2i and 2i + 1; the smoothed line is a few pixels wide.
    assert abs(columns.min() - 300) <= 6
    assert abs(columns.max() - 599) <= 6
    assert abs(rows.min() - 120) <= 6
    assert abs(rows.max() - 299) <= 6
    assert not changed[180:280, 330:580].any()


def test_contact_ring_and_arrow_are_drawn_there() -> None:
    plain = draw_overlay(grey(), SIZE, None, frame_in_contact("undetermined", THETA))
    drawn = draw_overlay(
        grey(),
        SIZE,
        None,
        dataclasses.replace(OK, touch=dataclasses.replace(OK.touch, arrow=((500.0, 120.0), (400.0, 200.0)))),
    )
    changed = (plain != drawn).any(axis=2)
    rows, columns = np.nonzero(changed)
    assert changed[160, 450]
    assert columns.min() >= 385
    assert columns.max() <= 510
    assert rows.max() <= 235


def test_unreadable_frame_is_black_with_its_status() -> None:
    picture = draw_overlay(None, SIZE, None, FrameEstimate(3, 0.1, "unreadable"))
    assert picture.shape == (360, 640, 3)
    assert picture[150:300].max() < 20
    assert picture[:60, :200].max() > 200


def test_the_second_line_has_numbers_with_units_or_why_there_are_none() -> None:
    line = overlay._second_line(frame_in_contact("determined", THETA, (1.04, 1.04, 1.04)))
    numbers = "k_s 0.500 ± 0.020 f/u   k_d 0.1000 ± 0.0039 f·s/u   |F| 2.000 ± 0.078 f"
    assert line == f"{numbers}   (f, u: scene units)"
    assert overlay._second_line(OK).startswith("k_s — f/u")
    assert overlay._second_line(FrameEstimate(1, 0.0, "no_tool", "0 tool pixels.")) == "0 tool pixels."
    assert overlay._second_line(FrameEstimate(1, 0.0, "no_tool")) == NOTES["no_tool"].text


def test_the_panel_lies_far_from_instruments_and_does_not_jump() -> None:
    seen = np.zeros((120, 200), np.uint8)
    assert panel_corner(None, (1, 1)) == panel_corner(seen, (1, 1)) == (1, 1)
    seen[:40, :30] = overlay.TOOL
    assert panel_corner(seen) == (1, 1)
    assert panel_corner(seen[::-1], (1, 1)) == (0, 1)
    seen[50:70, 80:120] = overlay.TOOL
    seen[:40, :30] = 0
    assert [panel_corner(seen, before) for before in overlay.CORNERS] == overlay.CORNERS


@pytest.mark.parametrize("verdict", ["determined", "ratios", "undetermined", "onset_in_view"])
def test_the_dot_has_the_colour_of_the_verdict(verdict: str) -> None:
    picture = draw_overlay(grey(), SIZE, None, frame_in_contact(verdict, THETA, (2, 2, 2)))
    found = [name for name in NOTES if (picture[:40, :40] == NOTES[name].color).all(axis=2).sum() > 20]
    assert verdict in found
    assert ("determined" in found) == (verdict == "determined")


@pytest.mark.parametrize("alarm", ["below", "above", "unknown"])
def test_the_alarm_is_shown_and_all_but_safety_has_an_edge(alarm: str) -> None:
    plain, warned = (draw_overlay(grey(), SIZE, None, dataclasses.replace(OK, alarm=state)) for state in ("", alarm))
    edges = {"below": plain[180, 639], "above": (220, 38, 38), "unknown": (250, 204, 21)}
    assert tuple(warned[180, 639]) == tuple(edges[alarm])
    assert (plain[:60, :400] != warned[:60, :400]).any()


@pytest.mark.parametrize("size", [(640, 360), (480, 640), (240, 135)])
def test_a_long_remark_is_cut_at_the_panel_s_end(size: tuple[int, int]) -> None:
    detail = "The tissue is pressed at 74° to the line of sight, so its dent may hide its own bottom. " * 3
    plain, remarked = (
        draw_overlay(grey(size), size, None, FrameEstimate(7, 0.28, "no_tool", text)) for text in ("No.", detail)
    )
    rows, columns = np.nonzero((plain != remarked).any(axis=2))
    assert np.ptp(rows) < 3 * 21
    assert columns.max() < plain.shape[1] - 4


@pytest.mark.parametrize("size", [(640, 360), (480, 640), (240, 135)])
def test_the_notice_is_whole_beside_a_long_time(size: tuple[int, int]) -> None:
    picture = draw_overlay(None, size, None, FrameEstimate(999_999, 39999.96, "no_tool"))
    columns = picture[-10:].max(axis=(0, 2)) > 100
    ends = np.flatnonzero(np.diff(columns.astype(int)))
    assert np.diff(ends).max() > 30  # a gap between the two
    assert not columns[:5].any()
    assert not columns[-5:].any()


def test_wrapped_lines_fit_and_lose_nothing() -> None:
    line = "The tissue is pressed at 74° to the line of sight, so its dent may hide its own bottom."
    lines = wrap_text(f"{line} /a/folder/{'name' * 20}.npy", 200, 11)
    assert max(text_width(found, 11) for found in lines) <= 200
    assert " ".join(lines).startswith(line)
    assert "".join(lines).endswith("name" * 3 + ".npy")
