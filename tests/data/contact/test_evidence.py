"""Contact by evidence, on drawn clips and real ones: tools that hold tissue, that pass over it, or stand still."""

import math
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from palpate.data.clip import ClipStream
from palpate.data.contact.evidence import CERTAIN, PRIOR, THRESHOLD, ContactEvidence
from palpate.data.labels import TISSUE, TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.frames import Frame, open_source
from palpate.data.synthetic.clip import clip_seed, write_clip
from palpate.data.synthetic.settings import SceneSettings

HEIGHT, WIDTH = 280, 440
TIP = np.array([160.0, 140.0])
"""Where the tool ends at first (column, row) [px]."""
REACH = 50.0
"""Over which the motion of held tissue dies away [px]."""
View = tuple[np.ndarray, np.ndarray]


def texture(seed: int, size: tuple[int, int] = (HEIGHT, WIDTH)) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(*size, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2)
    return np.clip(130 + 40 * smooth / smooth.std(), 40, 250).astype(np.uint8)


def drawn(
    ways: np.ndarray, coupling: float = 0.0, *, camera: np.ndarray | None = None, begins: int = 0, leak: int = 0
) -> list[View]:
    """Pictures and masks of a tool that enters from the left and whose tip has gone [F, 2] px by each frame.

    Args:
        coupling: share of the tool's motion that the tissue at its tip follows.
        camera: motion of all of the picture besides, shape [F, 2] [px].
        begins: the frame from which tissue follows.
        leak: width by which the mask is too small [px].
    """
    tissue, steel = texture(1), texture(2)
    row, column = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    here = np.stack([column, row], axis=-1)
    views = []
    for index, way in enumerate(ways):
        moved = np.zeros(2) if camera is None else camera[index]
        source = here - moved
        held = way - ways[begins] if index > begins else np.zeros(2)
        for _ in range(8 if coupling and held.any() else 0):
            away = np.linalg.norm(source - TIP - ways[begins], axis=2, keepdims=True)
            source = here - moved - coupling * np.exp(-np.maximum(away - 12, 0) / REACH) * held
        picture = cv2.remap(tissue, *np.moveaxis(source.astype(np.float32), 2, 0), cv2.INTER_CUBIC, None, 2)
        tip = TIP + way + moved
        tool = (column < tip[0]) & (np.abs(row - tip[1]) < 14)
        shift = np.array([[1, 0, tip[0] - TIP[0]], [0, 1, tip[1] - TIP[1]]])
        picture[tool] = cv2.warpAffine(steel, shift, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)[tool]
        seen = cv2.erode(tool.astype(np.uint8), np.ones((2 * leak + 1, 2 * leak + 1), np.uint8), borderValue=1) > 0
        views.append((picture, seen))
    return views


def judged(frames: list[PreparedFrame], evidence: ContactEvidence | None = None) -> list[PreparedFrame]:
    evidence = evidence or ContactEvidence()
    for frame in frames:
        evidence.judge(frame)
    return frames


def frames_of(views: list[View]) -> list[PreparedFrame]:
    return [prepared(number, view) for number, view in enumerate(views)]


def probabilities(views: list[View]) -> np.ndarray:
    return np.array([frame.contact_probability for frame in judged(frames_of(views))])


def line(step: tuple[float, float], count: int = 8) -> np.ndarray:
    return np.outer(np.arange(count), step)


@pytest.mark.parametrize("step", [(3.0, 1.0), (0.0, -2.0), (0.6, 0.3)])
def test_a_tool_that_passes_hovers_and_one_that_holds_is_in_contact(step: tuple[float, float]) -> None:
    passes, holds = probabilities(drawn(line(step))), probabilities(drawn(line(step), 0.9))
    assert passes[0] == holds[0] == pytest.approx(PRIOR)
    late = 1 if np.hypot(*step) > 1 else 4  # slow ones take longer to tell
    assert (passes[late:] < THRESHOLD).all()
    assert (holds[1:] > THRESHOLD).all()
    assert holds[-1] > CERTAIN


def test_a_camera_that_moves_everything_changes_nothing() -> None:
    camera = np.cumsum(np.random.default_rng(0).normal(0, 4, (8, 2)), axis=0)
    assert (probabilities(drawn(line((3, 1)), camera=camera))[1:] < THRESHOLD).all()
    assert probabilities(drawn(line((3, 1)), 0.9, camera=camera))[-1] > CERTAIN


def test_where_nothing_moves_it_stays_what_outlines_say() -> None:
    still = probabilities(drawn(line((0, 0))))
    assert ((still > THRESHOLD) & (still < CERTAIN)).all()


@pytest.mark.parametrize("leak", [3, 6])
def test_tool_pixels_that_the_mask_leaves_to_the_tissue_do_not_fake_contact(leak: int) -> None:
    assert (probabilities(drawn(line((3, 1)), leak=leak))[1:] < THRESHOLD).all()
    assert probabilities(drawn(line((3, 1)), 0.9, leak=leak))[-1] > CERTAIN


def prepared(number: int, view: View, *, status: str = "ok") -> PreparedFrame:
    nothing, picture_labels = np.zeros((4, 4)), np.where(view[1], TOOL, TISSUE).astype(np.uint8)
    frame = PreparedFrame(Frame(number, number, number / 25, view[0]), status, "", nothing, nothing, picture_labels)
    frame.geometry = SimpleNamespace() if status == "ok" else None  # ty: ignore[invalid-assignment]  only whether
    return frame


def test_a_frame_whose_tool_hovers_has_no_contact_and_says_why() -> None:
    frames = judged(frames_of(drawn(line((3, 1), 4))))
    assert [frame.status for frame in frames] == ["ok", "no_contact", "no_contact", "no_contact"]
    assert (frames[0].hovers, frames[0].out_of_contact) == (False, False)
    assert (frames[1].hovers, frames[1].out_of_contact, frames[1].in_contact) == (True, False, False)
    assert "does not move with it, so it hovers" in frames[1].detail


@pytest.mark.parametrize(("follow", "contact"), [(0.0, False), (0.9, True)])
def test_frames_before_anything_has_moved_are_decided_by_later_ones(follow: float, contact: bool) -> None:
    """A tool that is at tissue from the first frame on, stands, and then passes over it or takes it along."""
    evidence, frames = ContactEvidence(), frames_of(drawn(np.concatenate([np.zeros((3, 2)), line((3, 1), 6)]), follow))
    given = [len(evidence.push(frame)) for frame in frames]
    assert given[:3] == [0, 0, 0]  # they wait
    assert sum(given) + len(evidence.finish()) == len(frames)
    assert [frame.in_contact for frame in frames] == [contact] * len(frames)
    assert all((frame.contact_probability > PRIOR) == contact for frame in frames)


@pytest.mark.parametrize("between", ["gap", "no_tool", "no_contact", "bad_depth"])
def test_what_was_known_before_an_interruption_counts_no_more(between: str) -> None:
    views = drawn(line((3, 1), 6))
    frames = frames_of(views)
    frames[3] = prepared(3, views[3], status=between)
    *_, after, later = judged(frames[:3] + frames[4:] if between == "gap" else frames)
    assert (after.status, after.contact_probability) == ("ok", pytest.approx(PRIOR))
    assert later.status == ("ok" if between == "no_contact" else "no_contact")


@pytest.mark.parametrize(("distance", "expected"), [(0.004, "ok"), (math.nan, "ok"), (0.03, "no_contact")])
def test_a_tool_that_was_seen_to_come_to_the_tissue_has_met_it(distance: float, expected: str) -> None:
    """Where depth doesn't say that it only passes in front of it."""
    views = drawn(line((3, 1), 4))
    frames = [prepared(0, views[0], status="no_contact"), *frames_of(views)[1:]]
    for frame in frames:
        frame.distance = distance
    judged(frames, ContactEvidence(near=0.02))
    # The frame in which it was apart counts, too.
    assert [frame.status for frame in frames[1:]] == [expected] * 3


@pytest.mark.parametrize(
    ("statuses", "expected"),
    [
        ("no_tool ok no_tool", "no_contact"),
        ("no_tool ok ok no_tool", "ok"),
        ("no_contact ok no_contact", "ok"),  # it was seen to come
        ("no_tool ok", "ok"),  # the clip ends
        ("no_tool ok no_mask", "ok"),  # it may be there
    ],
)
def test_an_outline_that_is_there_in_one_frame_alone_is_a_mask_that_flickers(statuses: str, expected: str) -> None:
    views = drawn(np.zeros((4, 2)))
    frames = [prepared(number, views[number], status=status) for number, status in enumerate(statuses.split())]
    evidence = ContactEvidence()
    given = [frame for item in frames for frame in evidence.push(item)] + evidence.finish()
    assert given == frames
    assert frames[1].status == expected
    assert math.isnan(frames[1].contact_probability) == (expected == "no_contact")


def test_a_mask_that_flickers_soon_after_a_contact_may_show_its_instrument_again() -> None:
    views = drawn(np.zeros((6, 2)))
    statuses = "no_tool ok ok no_tool ok no_tool"
    frames = [prepared(number, views[number], status=status) for number, status in enumerate(statuses.split())]
    evidence = ContactEvidence()
    for frame in frames:
        evidence.push(frame)
    assert [frame.status for frame in frames] == statuses.split()


COMES = np.array([(3.0 * min(index, 4), 0.0) for index in range(9)])
"""A tool passes, arrives in frame 4 and then stands still."""


def test_a_tool_that_comes_to_a_stand_is_not_called_hovering() -> None:
    """It may press from the frame in which it arrives; nothing tells."""
    frames = judged(frames_of(drawn(COMES)))
    assert [frame.status for frame in frames] == ["ok"] + ["no_contact"] * 3 + ["ok"] * 5
    for index, frame in enumerate(frames):
        assert (frame.hovers, frame.undecided) == (0 < index < 4, index >= 4)
    for frame in frames[4:]:
        assert frame.contact_probability == pytest.approx(PRIOR, abs=0.12)
        assert (frame.in_contact, frame.detail) == (True, "")


def changed(views: list[View], wider: int) -> list[View]:
    """Masks made wider, or narrower where it is negative [px]."""
    square = np.ones((2 * abs(wider) + 1,) * 2, np.uint8)
    change = cv2.dilate if wider > 0 else cv2.erode
    return [(picture, change(tool.astype(np.uint8), square) > 0) for picture, tool in views]


def recover(data: Path) -> list[View]:
    views = []
    for picture in sorted((data / "recover_tissue/img_left").iterdir()):
        mask = data / f"recover_tissue/tool_mask/{picture.stem}.png"
        tool = (cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE) == 0).astype(np.uint8)
        tool = cv2.morphologyEx(tool, cv2.MORPH_OPEN, np.ones((15, 15), np.uint8)) > 0
        views.append((cv2.cvtColor(cv2.imread(str(picture)), cv2.COLOR_BGR2RGB), tool))
    return views


def cholecystectomy(data: Path, first: int, stop: int) -> list[View]:
    stems = [data / f"cholecseg8k/video01/video01_00080/frame_{number}_endo" for number in range(first, stop)]
    pictures = [cv2.cvtColor(cv2.imread(f"{stem}.png"), cv2.COLOR_BGR2RGB) for stem in stems]
    masks = [cv2.imread(f"{stem}_watershed_mask.png", cv2.IMREAD_GRAYSCALE) == 31 for stem in stems]
    return list(zip(pictures, masks, strict=True))


@pytest.mark.acceptance
def test_no_pressed_frame_of_a_demo_clip_is_called_hovering(tmp_path: Path) -> None:
    """Neither as a video nor as a folder with its true depth, both with automatic masks."""
    write_clip(tmp_path, 2, SceneSettings(width=428, height=240, frames=32), clip_seed(1, 1))
    folder = tmp_path / "video02/video02_00000"
    with np.load(folder / "truth.npz") as truth:
        pressed = truth["in_contact"].astype(bool)
    assert pressed.sum() == 9
    settings = PrepareSettings(masks="automatic")
    for path in (folder, folder.with_suffix(".mp4")):
        frames = list(islice(ClipStream(open_source(path, settings.layout), settings), 22))
        assert [frame.status for frame in frames if pressed[frame.frame.index]] == ["ok"] * 9
        passing = [frame.hovers or frame.status == "no_contact" for frame in frames if not pressed[frame.frame.index]]
        assert sum(passing) >= 8  # the tool is in view, and its motion is known
        if path == folder:  # distance decides
            assert all(math.isnan(frame.contact_probability) for frame in frames)


@pytest.mark.slow
@pytest.mark.parametrize("wider", [-4, 0, 4])
def test_real_tools_that_hold_tissue_are_in_contact(real_data: Path, wider: int) -> None:
    """Whether masks are a few pixels too wide or too narrow."""
    pull = probabilities(changed(recover(real_data), wider) if wider else recover(real_data))
    assert (pull > THRESHOLD).all()
    assert (pull[2:] > CERTAIN).all()
    assert (probabilities(changed(cholecystectomy(real_data, 149, 160), 1)) > THRESHOLD).all()


@pytest.mark.slow
@pytest.mark.parametrize("leak", [0, 4])
@pytest.mark.parametrize(("first", "step"), [(90, (5.0, -2.0)), (100, (1.5, -2.0)), (110, (3.0, -3.0))])
def test_a_real_tool_over_other_real_tissue_hovers(real_data, leak, first, step) -> None:
    """The grasper of one clip drawn over another one whose camera moves: it passes over tissue, and never touches."""
    picture, tools = recover(real_data)[0]
    _, number = cv2.connectedComponents(tools.astype(np.uint8))
    tool = cv2.erode((number == number[430, 60]).astype(np.uint8), np.ones((5, 5), np.uint8))
    views = []
    for index, (under, _) in enumerate(cholecystectomy(real_data, first, first + 11)):
        size = under.shape[1::-1]
        shift = np.array([[1, 0, -20 + index * step[0]], [0, 1, -120 + index * step[1]]])
        mask = cv2.warpAffine(tool, shift, size)
        soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1)[..., None]
        seen = cv2.erode(mask, np.ones((2 * leak + 1,) * 2, np.uint8)) > 0
        views.append(((soft * cv2.warpAffine(picture, shift, size) + (1 - soft) * under).astype(np.uint8), seen))
    found = probabilities(views)
    assert (found[1:] < THRESHOLD).mean() >= 0.9
