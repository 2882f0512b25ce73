"""Fields of stiffness in a file: every frame as it was said, and no memory that grows with them."""

import dataclasses
import gc
import tracemalloc
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import matplotlib.figure  # noqa: F401  what the writer imports meanwhile is no memory of a field
import numpy as np

from palpate.data.labels import TOOL
from palpate.estimators.online.particle_field import FieldNumbers, ParticleField, StiffnessMap
from palpate.estimators.records import FRAMES, FrameEstimate
from palpate.estimators.result import columns_of, values_of
from palpate.results.artefacts.fields import FieldFile
from palpate.results.overlay import MIDDLE, OPACITY, SOFT, STIFF, colors, draw_field
from palpate.results.writer import ClipResults
from tests.results.fields import FIELD_SEEN, UNKNOWN, opened
from tests.results.test_writer import FRAME

SAID = FrameEstimate(5, 0.2, "ok", field=FIELD_SEEN)


def test_a_file_holds_every_frame_and_every_run_once(tmp_path: Path) -> None:
    file = FieldFile(cast(ClipResults, SimpleNamespace(partial=tmp_path)))
    second = dataclasses.replace(FIELD_SEEN, onset_frame=9, distance=FIELD_SEEN.shape)
    for number, field in ((5, FIELD_SEEN), (6, FIELD_SEEN), (9, second)):
        file.frame(FrameEstimate(number, 0.04 * number, "ok", field=field), None, None)
    file.close()
    with np.load(tmp_path / "fields.npz", allow_pickle=False) as found:
        runs = [f"run_{run}/{name}" for run in (3, 9) for name in ("rest", "faces")]
        names = ("run", "positions", "pixels", "distance", "shape", "known")
        names += ("distance_log_sd", "shape_log_sd", "shape_known")
        assert sorted(found.files) == sorted([*runs, *(f"frame_{n}/{name}" for n in (5, 6, 9) for name in names)])
        assert found["frame_9/run"] == 9
        np.testing.assert_array_equal(found["frame_9/distance"], second.distance.value.astype(np.float32))
        np.testing.assert_array_equal(found["frame_5/positions"], FIELD_SEEN.positions)
        np.testing.assert_array_equal(found["frame_5/known"], FIELD_SEEN.distance.known)
        np.testing.assert_array_equal(found["frame_5/shape_known"], FIELD_SEEN.shape.known)
        np.testing.assert_allclose(found["frame_5/distance_log_sd"], FIELD_SEEN.distance.log_sd, rtol=1e-6)
        np.testing.assert_array_equal(found["run_3/faces"], FIELD_SEEN.faces)
    volume = FieldFile(cast(ClipResults, SimpleNamespace(partial=tmp_path)))
    solid = dataclasses.replace(FIELD_SEEN, tetrahedra=np.array([[0, 1, 2, 3]]))
    volume.frame(FrameEstimate(5, 0.2, "ok", field=solid), None, None)
    volume.close()
    with np.load(tmp_path / "fields.npz", allow_pickle=False) as found:
        np.testing.assert_array_equal(found["run_3/tetrahedra"], [[0, 1, 2, 3]])


def test_columns_tell_quantiles_where_it_is_known() -> None:
    cells = dict(zip(FRAMES.columns, FRAMES.row(SAID), strict=True))
    told = dict.fromkeys(("distance_stiffness", "distance_stiffness_low", "distance_stiffness_high"), "4")
    told |= dict.fromkeys((f"shape_stiffness{end}" for end in ("", "_low", "_high", "_log_sd")), "")
    told |= {"distance_stiffness_log_sd": "0.3", "field_known": "0.75", "shape_known": "0"}
    assert {name: cells[name] for name in columns_of(FieldNumbers)} == told | {"skill": "0.75", "gap": "0.25"}
    assert FIELD_SEEN.verdict == "stiffness_ratios"
    nothing = dataclasses.replace(UNKNOWN, gap=None)
    assert values_of(nothing.numbers) == {"field_known": 0.0, "shape_known": 0.0, "skill": 0.75}
    assert nothing.verdict == "undetermined"
    known = np.array([True, False, False, False])
    bent = dataclasses.replace(nothing, shape=dataclasses.replace(nothing.shape, known=known))
    assert (bent.verdict, values_of(bent.numbers)["shape_stiffness"]) == ("stiffness_ratios", 0.01)
    assert "relative" in FRAMES.columns["distance_stiffness"]


def test_results_keep_no_field_of_a_frame(tmp_path: Path) -> None:
    """400 frames of a sheet of 600 particles take less memory than forty of their fields."""
    count, frames = 600, 400
    positions = np.random.default_rng(0).normal(size=(count, 3))
    faces = np.arange(count).reshape(-1, 3)
    none, told = np.empty((0, 4), int), StiffnessMap(*positions.T[:2], positions[:, 2] > 0)
    one = ParticleField(0, positions, faces, none, positions, positions[:, :2], told, told, 0.5, 0.1)
    size = sum(value.nbytes for value in vars(one).values() if isinstance(value, np.ndarray))
    with opened(tmp_path / "clip", kinds=[FieldFile]) as output:
        tracemalloc.start()
        for number in range(frames):
            # Arrays of their own, as a session gives them.
            field = dataclasses.replace(one, positions=positions.copy(), pixels=positions[:, :2].copy())
            output.write(FRAME, FrameEstimate(number, number / 25, "ok", field=field))
            if number == frames // 10:
                gc.collect()  # what waits to be collected is no growth
                before = tracemalloc.get_traced_memory()[0]
        gc.collect()
        grown = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()
    assert grown < 0.1 * frames * size


def test_stiff_is_red_and_soft_is_blue() -> None:
    np.testing.assert_array_equal(colors(np.array([-3.0, -1.0, 0.0, 1.0, 3.0])), [SOFT, SOFT, MIDDLE, STIFF, STIFF])


def test_only_what_is_known_is_painted_and_no_tool() -> None:
    canvas, labels = np.full((40, 50, 3), 100, np.uint8), np.zeros((40, 50), np.uint8)
    labels[:, :10] = TOOL
    draw_field(canvas, FIELD_SEEN, 1.0, labels)
    blend = np.round(OPACITY * MIDDLE + (1 - OPACITY) * 100)
    np.testing.assert_allclose(canvas[20, 14], blend, atol=1)
    np.testing.assert_array_equal(canvas[20, 5], [100] * 3)  # the tool
    np.testing.assert_array_equal(canvas[32, 40], [100] * 3)  # the corner that isn't known
    untouched = np.full((40, 50, 3), 100, np.uint8)
    draw_field(untouched, UNKNOWN, 1.0)
    np.testing.assert_array_equal(untouched, 100)
