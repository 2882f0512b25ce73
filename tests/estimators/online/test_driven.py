"""Tissue under an instrument: what is gripped, pinned and compared, what motion is taken from followed points."""

import dataclasses
import gc
import tracemalloc
from collections.abc import Iterable

import numpy as np
import pytest

from palpate.data.contact.geometry import GeometrySettings
from palpate.data.labels import OTHER, TISSUE, TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.source.camera import Camera
from palpate.data.source.frames import Frame
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.online import determined
from palpate.estimators.online.driven import DrivenTissue
from palpate.estimators.online.forecast import FIELD, SHEET
from palpate.estimators.online.objective import PAPER, Bounds
from palpate.estimators.online.session import Method
from palpate.estimators.online.settings import OnlineSettings
from palpate.estimators.online.surface import Surface, make_surface

WIDTH, HEIGHT, DEPTH = 240, 160, 0.5
CAMERA = Camera.from_field_of_view(60.0, WIDTH, HEIGHT)
GEOMETRY = GeometrySettings(height=80, width=120, smoothing=0.0)
SETTINGS = OnlineSettings(particles=120, fitted=0)
PER_PIXEL = DEPTH / CAMERA.fx
"""Length of a pixel at that depth [scene units]."""


def first_frame(tissue: bool = True, tool: bool = True) -> PreparedFrame:
    """Flat tissue across the line of sight, an instrument from the left up to a third of the picture."""
    labels = np.full((HEIGHT, WIDTH), TISSUE if tissue else OTHER, np.uint8)
    if tool:
        labels[60:100, :80] = TOOL
    grid = labels[::2, ::2]
    picture = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    depth = np.full(grid.shape, DEPTH, np.float32)
    return PreparedFrame(Frame(0, 7, 0.0, picture), "ok", "", depth, grid, labels)


@pytest.fixture(scope="module")
def surface() -> Surface:
    return make_surface(first_frame(), CAMERA, GEOMETRY, SETTINGS.particles)


def from_tool(points: np.ndarray) -> np.ndarray:
    return np.hypot(np.maximum(points[:, 0] - 79, 0), np.maximum(np.abs(points[:, 1] - 79.5) - 19.5, 0))


POINTS = np.stack(np.meshgrid(np.arange(8.0, 232, 8), np.arange(8.0, 152, 8)), axis=-1).reshape(-1, 2)
POINTS = POINTS[from_tool(POINTS) > 5]
"""Places to follow, shape [P, 2] [px]."""
AWAY = from_tool(POINTS)
"""Their distances from the instrument, shape [P] [px]."""


def pulled(share: float) -> np.ndarray:
    """Displacement [P, 2] [px] that dies away from the instrument."""
    return share * np.array([-8.0, 4.0]) * np.exp(-AWAY / 40)[:, None]


def driven(surface: Surface, shares: Iterable[float] = (), led: bool = False, **settings) -> DrivenTissue:
    """Tissue that has been pulled by these shares."""
    tissue = DrivenTissue(surface, POINTS, AWAY, dataclasses.replace(SETTINGS, **settings), 8, led)
    for share in shares:
        tissue.step(pulled(share))
    return tissue


def test_about_as_many_particles_as_asked_lie_on_the_tissue(surface: Surface) -> None:
    rest = surface.body.rest
    assert 0.8 * SETTINGS.particles < len(rest) < 1.3 * SETTINGS.particles
    np.testing.assert_allclose(rest[:, 2], DEPTH)
    np.testing.assert_allclose(surface.project(rest), surface.pixels, atol=1e-3)
    np.testing.assert_allclose(surface.lift(surface.pixels, rest[:, 2]), rest, atol=1e-5)


def test_the_far_edge_is_pinned_and_what_is_near_the_tool_gripped(surface: Surface) -> None:
    pixels, pinned = surface.pixels, surface.body.pinned
    gripped = np.isin(np.arange(len(pixels)), surface.gripped)
    away = from_tool(pixels)
    assert gripped.any()
    assert not (pinned & gripped).any()
    assert away[gripped].max() < surface.reach + 2
    assert away[~gripped].min() > surface.reach - 2
    right = pixels[:, 0] > pixels[:, 0].max() - 1
    assert pinned[right].all()
    assert away[pinned].min() >= np.percentile(away, 60) - 2  # the picture's border next to the tool is free
    border = (pixels[:, 1] < pixels[:, 1].min() + 1) & (pixels[:, 0] < 100)
    assert border.any()
    assert not pinned[border].any()
    inner = (pixels > 30).all(axis=1) & (pixels[:, 0] < WIDTH - 30) & (pixels[:, 1] < HEIGHT - 30)
    assert not pinned[inner].any()


def test_places_are_shares_that_bring_a_point_back(surface: Surface) -> None:
    points = np.array([[150.3, 40.7], [200.0, 120.5], [20.0, 80.0], [500.0, 80.0]])
    inside, shares = surface.places(points)
    np.testing.assert_array_equal(inside, [0, 1])  # behind the tool and outside there is no sheet
    np.testing.assert_allclose(shares.sum(axis=1), 1)
    np.testing.assert_allclose(shares @ surface.pixels, points[:2], atol=1e-9)
    assert shares.data.min() > -1e-9


def test_gripped_particles_move_as_the_tissue_beside_the_tool(surface: Surface) -> None:
    tissue = driven(surface)
    shift = np.array([3.0, -2.0])
    places = tissue.gripped_places(np.tile(shift, (len(POINTS), 1)))
    rest = surface.body.rest[surface.gripped]
    assert places is not None
    np.testing.assert_allclose(places - rest, np.broadcast_to([*(shift * PER_PIXEL), 0], rest.shape), atol=1e-6)
    hidden = np.tile(shift, (len(POINTS), 1))
    hidden[surface.reach > AWAY] = np.nan
    assert tissue.gripped_places(hidden) is None


def test_a_frame_without_the_grip_is_not_learnt_from(surface: Surface) -> None:
    tissue = driven(surface, [0.5])
    before = tissue.session.fields
    told = tissue.step(np.full_like(POINTS, np.nan))
    assert told.gap is None
    assert tissue.session.fields is before


def test_states_follow_what_is_seen_and_stretched_tissue_is_found(surface: Surface) -> None:
    tissue = driven(surface, np.linspace(0.1, 1, 10))
    moved = pulled(1.0)[tissue.around]
    off = tissue.shown(tissue.session.positions[None])[0] - moved
    assert np.linalg.norm(off) < 0.25 * np.linalg.norm(moved)
    stretched = tissue.stretched
    assert stretched.any()
    assert not stretched[surface.body.pinned].any()
    assert not stretched[surface.gripped].any()
    far = surface.pixels[:, 0] > 200
    assert not stretched[far].any()


@pytest.mark.parametrize(("name", "shares"), [("PBD", (0.5, 1.0)), ("PBD-RM", (0.5, 1.0)), ("PBD-RM-ON", (0.0,) * 3)])
def test_nothing_is_known_by_methods_that_learn_nothing_or_where_nothing_moves(surface, name: str, shares) -> None:
    tissue = driven(surface, shares, method=Method(name))
    assert not tissue.stretched.any()
    assert not tissue.determined()[1][0].any()
    if any(shares):
        np.testing.assert_array_equal(tissue.session.fields.distance, SETTINGS.start.distance)
    else:
        np.testing.assert_allclose(tissue.session.positions, surface.body.rest, atol=1e-9)


def test_field_and_sheet_predict_later_frames(surface: Surface) -> None:
    skills = driven(surface, np.linspace(0.1, 0.5, 5)).skills()
    assert set(skills) == {FIELD, SHEET}
    assert min(skills.values()) > 0.5


def test_what_is_fitted_to_the_first_frames_holds_from_the_first_on(surface: Surface) -> None:
    tissue, shares = driven(surface, [0.3, 0.6], fitted=3), [0.3, 0.6, 1.0, 1.0, 0.9, 0.8]
    assert tissue.fit is None
    tissue.step(pulled(1.0))
    fit = tissue.fit
    assert fit.error < 0.5
    for share in shares[3:]:
        told = tissue.step(pulled(share))
    settings = tissue.settings
    stepping = fit.stepping(SETTINGS.stepping, SETTINGS.start.distance)
    again = driven(surface, shares[:-1], start=settings.start, bounds=settings.bounds, stepping=stepping)
    assert again.settings.start.shape == fit.bending * SETTINGS.start.distance
    np.testing.assert_array_equal(told.positions, again.step(pulled(shares[-1])).positions)
    assert tissue.alone.skill == again.alone.skill
    assert settings.bounds.shape == fit.bending * SETTINGS.bounds.distance
    assert driven(surface, [0.0] * 3, fitted=2).fit is None


@pytest.mark.parametrize("bound", [0.02, 0.5])
def test_what_is_fitted_keeps_to_the_bounds_that_were_given(surface: Surface, bound: float) -> None:
    """The paper's allows none of the stiffness of shapes that is tried, half of that of distances all but one."""
    tissue = driven(surface, np.linspace(0.2, 1, 6), fitted=3, bounds=Bounds(shape=bound))
    fit, settings = tissue.fit, tissue.settings
    assert fit.bending in ([SETTINGS.start.shape] if bound == PAPER.shape else [0.02, 0.3])
    assert settings.start.shape == fit.bending < settings.bounds.shape <= bound
    assert tissue.session.fields.shape.max() <= bound


@pytest.mark.parametrize(("frame", "sentence"), [(first_frame(tool=False), "no instrument"), (first_frame(False), "7")])
def test_a_frame_without_tool_or_tissue_is_a_sentence(frame: PreparedFrame, sentence: str) -> None:
    with pytest.raises(NoEstimate, match=sentence):
        make_surface(frame, CAMERA, GEOMETRY, 100)


def test_memory_does_not_grow_with_the_frames(surface: Surface) -> None:
    """Mapped states are kept for a window of 20, the grip's way for 50; 20 more frames would be 20 states."""
    mapping = dataclasses.replace(SETTINGS.mapping, steps=1)
    stepping = dataclasses.replace(SETTINGS.stepping, iterations=2)
    shares, used = [index % 5 / 5 for index in range(60)], []
    tissue = driven(surface, shares, method=Method("PBD-RM"), mapping=mapping, stepping=stepping)
    tracemalloc.start()
    for _ in range(4):
        for share in shares[:20]:
            tissue.step(pulled(share))
        gc.collect()
        used.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    # What Python itself keeps comes and goes; what is kept of every frame would show in each 20 of them.
    assert np.diff(used).min() < 10 * surface.body.rest.nbytes


def test_a_volume_moves_with_its_grip_and_keeps_its_volume(monkeypatch: pytest.MonkeyPatch) -> None:
    """Raised towards the camera by a third of its thickness; without stiffness of volumes it grows thrice as much."""
    volume = make_surface(first_frame(), CAMERA, GEOMETRY, 300, 0.15)
    body, changes = volume.body, []

    def held(state: np.ndarray) -> float:
        parts = state[body.tetrahedra]
        return float(np.linalg.det(parts[:, 1:] - parts[:, :1]).sum() / 6)

    for stiffness in (determined.VOLUME, 0.0):
        monkeypatch.setattr(determined, "VOLUME", stiffness)
        tissue = driven(volume, led=True, method=Method("PBD"))
        for share in np.linspace(0.1, 1, 10):
            places = volume.lift(volume.pixels[volume.gripped], body.rest[volume.gripped, 2] - 0.05 * share)
            told = tissue.step(np.zeros_like(POINTS), led=places)
        np.testing.assert_array_equal(told.positions[volume.gripped], places)
        np.testing.assert_array_equal(told.positions[body.pinned], body.rest[body.pinned])
        raised = body.rest[:, 2] - told.positions[:, 2]
        layers = raised.reshape(-1, len(volume.seen))
        under = layers[:, volume.gripped].mean(axis=1)
        assert (np.diff(under) < 0).all()  # the less the deeper, but all of it
        assert under[-1] > 0.001
        changes.append(held(told.positions) / held(body.rest) - 1)
    assert abs(changes[0]) < 0.005
    assert abs(changes[1]) > 3 * abs(changes[0])


def test_where_tissue_is_led_its_grip_moves_it_exactly_and_alone(surface: Surface) -> None:
    """What the followed points near the instrument do doesn't count, and without a place the grip stays."""
    tissue, gripped = driven(surface, led=True), surface.gripped
    places = surface.lift(surface.pixels[gripped] + [-6.0, 3.0], surface.body.rest[gripped, 2] - 0.01)
    seen = pulled(0.5)
    seen[surface.reach > AWAY] = 99.0
    told = tissue.step(seen, led=places)
    np.testing.assert_array_equal(told.positions[gripped], places)
    assert told.gap is not None
    told = tissue.step(seen)
    np.testing.assert_array_equal(told.positions[gripped], places)
    assert told.gap is None
