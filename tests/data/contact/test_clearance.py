"""Contact by measured depth: an instrument that is in front of tissue in every frame hovers, presses and withdraws."""

import math

import cv2
import numpy as np
import pytest

from palpate.data.contact.clearance import MeasuredContacts, end_clearance
from palpate.data.contact.geometry import GeometrySettings, frame_geometry
from palpate.data.labels import TISSUE, TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.source.camera import Camera
from palpate.data.source.frames import Frame

SHAPE = 60, 100
CAMERA = Camera(fx=185.0, fy=185.0, cx=49.5, cy=29.5, width=100, height=60)
SETTINGS = GeometrySettings(height=60, width=100, smoothing=3.0)
THICK = 0.0135
"""Thickness of the instrument, five cells of the grid wide [scene units]."""
CLEAR = (0.12, 0.09, 0.06, 0.035), (0.0, -0.004, -0.008, -0.01), (0.025, 0.05, 0.1)
"""Distance of its lower side from tissue at rest while it comes, presses and withdraws [scene units]."""


def frame(number: int, clear: float, noise: float = 0.0, tool_depth: float = 1.0) -> PreparedFrame:
    """Sloping tissue that fills the view, and in front of it an instrument that enters from the right."""
    random = np.random.default_rng(number)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    tip = 40 + 150 * max(clear, 0)
    tool = (abs(row - 30) <= 2) & (column >= tip)
    rest = 0.5 + 0.001 * (column - 50)
    dent = max(-clear, 0) * np.exp(-np.hypot(column - tip, row - 30) / 3)
    above = (rest - clear - THICK - 0.002 * (column - tip)) * tool_depth
    depth = np.where(tool, above, rest + dent) + random.normal(0, noise, SHAPE) * (tool_depth > 0)
    labels = np.where(tool, TOOL, TISSUE).astype(np.uint8)
    picture = cv2.GaussianBlur(np.random.default_rng(9).integers(40, 250, (*SHAPE, 3)).astype(np.uint8), (0, 0), 1)
    made = PreparedFrame(
        Frame(number, number, number / 25, picture), "ok", "", depth.astype(np.float32), labels, labels
    )
    made.geometry = frame_geometry(made.depth, labels, CAMERA, SETTINGS, ends=made.ends)
    return made


@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_contact_is_where_the_end_meets_the_tissue_whatever_outlines_say(noise: float) -> None:
    frames = [frame(number, clear, noise) for number, clear in enumerate(sum(CLEAR, ()))]
    assert all(made.contact.touching for made in frames)
    contacts = MeasuredContacts(0.02, CAMERA)
    decided = [done for made in frames for done in contacts.push(made)] + contacts.finish()
    assert [made.in_contact for made in decided] == [False] * 4 + [True] * 4 + [False] * 3
    assert all(made.out_of_contact and "by measured depth" in made.detail for made in decided[:4])
    assert decided[2].distance == pytest.approx(0.06, abs=0.004)
    assert all(math.isnan(made.contact_probability) for made in decided)


THICKER = 0.005
"""How much thicker an instrument is than it is wide: its distance seems larger by that [scene units]."""


@pytest.mark.parametrize(("dents", "touches"), [((0, 0, 0.002, 0.004, 0.004), True), ((0, 0, 0, 0, 0), False)])
def test_tissue_that_sinks_around_an_instrument_is_touched_from_when_it_stood_there(dents, touches) -> None:
    """One that stands as far from tissue, or leaves its dent behind, touches nothing."""
    frames = [frame(number, clear) for number, clear in enumerate((0.12, 0.09, 0.06, *[THICKER] * 5, 0.06, 0.12))]
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    for made, dent in zip(frames[3:], (*dents, dents[-1], dents[-1]), strict=True):
        tissue = made.labels == TISSUE
        made.depth[tissue] += (dent * np.exp(-np.hypot(column - 41, row - 30) / 6))[tissue]
    contacts = MeasuredContacts(0.02, CAMERA)
    decided = [done for made in frames for done in contacts.push(made)] + contacts.finish()
    assert [made.frame.number for made in decided] == list(range(10))
    assert [made.in_contact for made in decided] == [False] * 3 + [touches] * 5 + [False] * 2


@pytest.mark.parametrize("tool_depth", [0.0, 1.2])
def test_an_instrument_without_usable_depth_is_judged_by_evidence(tool_depth: float) -> None:
    """It has none, or one behind the tissue."""
    made = frame(0, 0.06, tool_depth=tool_depth)
    assert end_clearance(made, CAMERA) is None
    MeasuredContacts(0.02, CAMERA).judge(made)
    assert made.contact_probability > 0
