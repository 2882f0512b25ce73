"""A run of contact from pictures: what a pull tells, what a tool that only passes does not, and what is kept."""

import dataclasses
import functools
import math

import cv2
import numpy as np
import pytest

from palpate.data.labels import TISSUE, TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.tracks.background import without_background
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.grip import recorder as module
from palpate.estimators.grip.grip_estimate import HELD, LEAST_LEAD, PullResult, force_error
from palpate.estimators.grip.lattice import GripFrame, fit_sheets
from palpate.estimators.grip.recorder import GripRecorder, PullMotion
from palpate.estimators.result import LEAST_SKILL
from palpate.physics.mesh import Mesh, grid_mesh
from tests.estimators.sessions import prepared_frame, touched

WIDTH, HEIGHT = 320, 240
TIP = np.array([60.0, 120.0])
"""Middle of a tool of 40×40 px (column, row)."""
DECAY = 40.0
"""Length over which the tissue's motion dies away [px]."""


SIDE = 61
"""Side of the grid that the tissue's depth has [px]."""


def dome() -> Mesh:
    """Tissue that bends away from the camera."""
    row, column = np.mgrid[:SIDE, :SIDE] - SIDE // 2
    depth = 0.5 + 1e-4 * (np.square(row) + np.square(column))
    points = np.stack([column / SIDE * depth, row / SIDE * depth, depth], axis=-1)
    return grid_mesh(points, np.ones((SIDE, SIDE), bool))


DOME = dome()


def texture() -> np.ndarray:
    noise = np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH), np.uint8)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2)
    stretched = cv2.normalize(smooth, None, 60, 250, cv2.NORM_MINMAX)
    return np.repeat(stretched[..., None], 3, axis=2)


def tool_at(place: np.ndarray) -> np.ndarray:
    labels = np.full((HEIGHT, WIDTH), TISSUE, np.uint8)
    column, row = place.astype(int)
    labels[row - 20 : row + 20, column - 20 : column + 20] = TOOL
    return labels


def frame(index: int, picture: np.ndarray, labels: np.ndarray, contact: bool = True) -> PreparedFrame:
    middle = int(np.flatnonzero((DOME.pixels == SIDE // 2).all(axis=1))[0])
    touching = touched(DOME, middle, np.array([0.0, 0.0, -1.0]), math.nan) if contact else None
    return prepared_frame(index, "ok", touching, image=picture, picture_labels=labels)


def run(count: int, pull: float, middle: np.ndarray = TIP, decay: float = DECAY) -> GripRecorder:
    """A tool that moves upwards by `pull` a frame, and tissue around `middle` that does, too.

    Args:
        middle: elsewhere than at the tool's tip the mask doesn't move as well.
        decay: length over which the tissue's motion dies away [px].
    """
    rest, follow = texture(), middle is TIP
    rows, columns = np.indices((HEIGHT, WIDTH), np.float32)
    away = np.maximum(np.hypot(columns - middle[0], rows - middle[1]) - 20, 0)
    found = None
    for index in range(count):
        moved = index * pull
        places = columns, (rows + moved * np.exp(-away / decay)).astype(np.float32)
        picture = cv2.remap(rest, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        seen = frame(index, picture, tool_at(TIP - (0, moved * follow)))
        if found is None:
            found = GripRecorder(seen)
        else:
            found.add(seen)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def pull() -> PullResult:
    return run(12, 1.5).motion().estimate()


def test_the_force_of_a_pull_grows_as_the_grip_moves(pull: PullResult) -> None:
    assert pull.skill > 0.6
    assert (pull.verdict, pull.determined) == ("relative_force", ("relative_force",))
    # The grip moves evenly, and the sheet is linear.
    np.testing.assert_allclose(pull.force, pull.times / pull.times[-1], atol=0.08)
    assert (pull.force[-1], pull.force_sd[-1]) == pytest.approx((1.0, 0.0))
    assert pull.force_sd[:-1].min() > 0.001


def test_tissue_that_moves_elsewhere_is_not_explained_by_the_tool() -> None:
    found = run(12, 1.5, middle=np.array([250.0, 120.0])).motion().estimate()
    assert found.skill < LEAST_SKILL
    assert (found.explained, found.verdict, found.determined) == (False, "undetermined", ())


def test_a_motion_that_spreads_from_elsewhere_is_explained_better_from_there() -> None:
    """A camera that moves over a dome: whatever is far moves less, and no affine background takes it off."""
    points = np.stack(np.meshgrid(np.arange(8.0, 640, 8), np.arange(8.0, 480, 8)), axis=-1).reshape(-1, 2)
    distance = np.linalg.norm(np.maximum(np.abs(points - [320, 400]) - [30, 80], 0), axis=1)
    points, distance = points[distance > 5], distance[distance > 5]
    dome = np.exp(-np.square(points - [320, 240]).sum(axis=1) / (2 * 150.0**2))
    ways = [np.outer(index * (1 + 0.5 * dome), [1.0, 0.0]) for index in range(1, 13)]
    own = np.array([without_background(points, way, distance) for way in ways])
    gripped = distance < module.DRIVEN
    own = own[[GripFrame(frame, gripped).moves for frame in own]]
    skill = fit_sheets(points, 8, gripped, own, np.zeros((len(own), 3, 2))).skill(len(own) // 2)
    motion = PullMotion(points, 8, distance, [], 0, 0)
    rival = functools.partial(motion._rival_skill, count=int(gripped.sum()), own=own)
    assert skill < rival(seen=distance > 0) + LEAST_LEAD
    assert rival(seen=distance < 90) == -math.inf


def test_a_grip_whose_points_are_lost_is_a_sentence() -> None:
    found = run(12, 1.5)
    near = found._follower.distance < module.DRIVEN
    found._kept[3].moved[near] = np.nan
    with pytest.raises(NoEstimate, match=r"^0 points at the tool are seen in all frames; 20 are needed"):
        found.motion().estimate()


def test_a_tool_over_still_tissue_tells_nothing() -> None:
    with pytest.raises(NoEstimate, match=r"^In 0 of 7 frames the tissue moves with the instrument by more than 1 px"):
        run(8, 0.0).motion().estimate()


def test_memory_does_not_grow_with_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_KEPT", 4)
    found = run(24, 0.4)
    times = [kept.time_s for kept in found._kept]
    assert len(times) <= 4
    assert np.ptp(np.diff(times)) == pytest.approx(0.0)
    assert times[-1] > 0.6 * 23 / 25


def test_frames_out_of_contact_and_without_a_picture_are_followed_through() -> None:
    found = run(3, 1.0)
    before = len(found._kept)
    found.add(frame(3, texture(), tool_at(TIP), contact=False))
    unseen = frame(4, texture(), tool_at(TIP))
    unseen.picture_labels = None
    found.add(unseen)
    assert len(found._kept) == before


def test_what_has_too_wide_an_interval_is_not_determined(pull: PullResult) -> None:
    vague = dataclasses.replace(pull, force_sd=np.full_like(pull.force, 1.0))
    assert vague.explained
    assert (vague.verdict, vague.determined) == ("undetermined", ())


def test_the_error_of_a_force_is_a_share_of_what_the_sheet_leaves() -> None:
    force = np.array([0.0, 0.5, 1.0])
    np.testing.assert_allclose(force_error(force, 0.6), 0.4 * np.sqrt([HELD, 0.25 + HELD, HELD]))
    assert (force_error(force, 1.0) == 0).all()
