"""What every estimator keeps, whichever it is: its sessions are independent, miss no frame, survive any, and forget."""

import dataclasses
import gc
import types
from collections.abc import Iterable, Iterator
from itertools import chain, zip_longest
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as some

from palpate.data.clip import ClipStream
from palpate.data.contact.features import FEATURES
from palpate.data.contact.sequence_features import SEQUENCE_FEATURES
from palpate.data.labels import MaskError
from palpate.data.masks.class_table import CLASSES
from palpate.data.prepared import STATUSES, PreparedFrame
from palpate.data.settings import PrepareSettings
from palpate.data.source.frames import Frame
from palpate.data.synthetic.clip import SyntheticClip
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.source import SyntheticSource, _Depth, _Masks, open_synthetic
from palpate.estimators.contract import Estimator, Output
from palpate.estimators.direct.estimator import WHOLE, fitted_press
from palpate.estimators.estimate import PressResult
from palpate.estimators.network.fits import MECHANICS
from palpate.estimators.online.particle_field import ParticleField
from palpate.estimators.open import ESTIMATORS, settings_of
from palpate.estimators.records import CONTACTS, FRAMES, FrameEstimate, InteractionEstimate
from palpate.physics.mechanics import RECOMMENDED
from palpate.physics.msd.simulation import simulate
from tests.data.clips import make_clip
from tests.estimators.sessions import SIZE, State, clip_info, follow, linked, sorted_out, touched
from tests.estimators.test_runs import whole_clip_runs
from tests.inference_inputs import metadata, write_model, write_posterior
from tests.physics.sheets import sheet

OTHERS = "network with depth", "online with a volume"
NAMES = *ESTIMATORS.entries, *OTHERS
FPS = (25.0, 30.0)
Said = tuple[list[FrameEstimate], list[InteractionEstimate]]
MESH = sheet(7, 7)
NORMAL = np.array([0.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """How every estimator is opened; those that take depth look at three frames."""
    folder = tmp_path_factory.mktemp("models")
    common = {"geometry": dataclasses.asdict(clip_info().geometry), "observation": "trajectory"}
    write_model(folder / "gan.onnx", metadata(3, **common | {"observation": "final"}))
    coarse = folder / "online.yaml"
    coarse.write_text("particles: 60\nstrain: 0.002\n")  # a press across the line of sight moves little
    thick = folder / "thick.yaml"
    thick.write_text("particles: 90\nthickness: 0.1\nstrain: 0.002\n")
    document = metadata(3, **common, bounds=dataclasses.asdict(RECOMMENDED), mechanics=dataclasses.asdict(MECHANICS))
    write_posterior(folder / "depth.onnx", document, FEATURES + SEQUENCE_FEATURES)
    return {
        "network": settings_of("network"),
        "network with depth": settings_of(model=folder / "depth.onnx"),
        "gan": settings_of("gan", model=folder / "gan.onnx"),
        "direct": settings_of("direct", onset="stamp"),
        "online": settings_of("online", settings=coarse),
        "online with a volume": settings_of("online", settings=thick),
    }


@pytest.fixture(scope="module", params=NAMES)
def estimator(request: pytest.FixtureRequest, files: dict[str, Any]) -> Estimator:
    """Each in turn."""
    return files[request.param].build()


@pytest.fixture(scope="module", params=NAMES)
def prompt(request: pytest.FixtureRequest, files: dict[str, Any]) -> Estimator:
    """Each in turn, for presses that begin at their time stamp, which takes a network a fifth of the time."""
    settings = files[request.param]
    return (dataclasses.replace(settings, onset="stamp") if hasattr(settings, "onset") else settings).build()


@pytest.fixture(scope="module")
def clips(frames: list[PreparedFrame]) -> list[list[PreparedFrame]]:
    """Prepared clips at 25 and 30 frames a second."""
    width, height = SIZE
    scene = SceneSettings(width=width, height=height, depth_noise=0.001, frames=30, fps=30.0, press_seconds=(0.3, 0.3))
    return [frames, list(open_synthetic(make_clip(scene, 5), PrepareSettings(geometry=clip_info().geometry)))]


@pytest.fixture(scope="module")
def alone(estimator: Estimator, clips: list[list[PreparedFrame]]) -> list[Said]:
    """What the estimator says of each clip when nothing else is open."""
    return [follow(estimator.start(clip_info(fps)), frames) for frames, fps in zip(clips, FPS, strict=True)]


def exactly(told: Iterable[FrameEstimate], runs: Iterable[InteractionEstimate]) -> list[str]:
    """Everything that is said, to the last digit."""
    found = [repr(FRAMES.known(item)) for item in told]
    for run in runs:
        seen, values = run.interaction, CONTACTS.known(*run.rows)
        arrays = () if seen is None else (seen.observation.times, seen.observation.displacement, seen.load.factor)
        arrays += run.simulated or ()
        found.append(repr(([values.get(name) for name in CONTACTS.columns], [array.tolist() for array in arrays])))
    return found


def test_sessions_side_by_side_say_what_they_say_alone(estimator, clips, alone) -> None:
    """At 25 and 30 frames a second, frame by frame in turn."""
    sessions = [estimator.start(clip_info(fps)) for fps in FPS]
    said: list[list[Output]] = [[], []]
    for pair in zip_longest(*clips):
        for session, frame, heard in zip(sessions, pair, said, strict=True):
            if frame is not None:
                heard += session.push(frame)
    for session, heard, expected in zip(sessions, said, alone, strict=True):
        assert exactly(*sorted_out([*heard, *session.finish()])) == exactly(*expected)
    # Estimates depend on the frame rate and on the clip, so that mixed sessions would be noticed.
    if estimator.name == "online":
        first, second = (fields_of(told)[-1].skill for told, _ in alone)
        assert not np.allclose(first, second, rtol=1e-4)
    else:
        first, second = (runs[0].estimate.theta for _, runs in alone)
        assert not np.allclose(first, second, rtol=1e-3)


def fields_of(told: Iterable[FrameEstimate]) -> list[ParticleField]:
    """Fields of stiffness of the frames that have one."""
    return [item.field for item in told if item.field is not None]


def test_fields_are_the_online_estimator_s_alone(estimator: Estimator, alone: list[Said]) -> None:
    for told, _ in alone:
        fields = fields_of(told)
        assert (fields != []) == (estimator.name == "online")
        for field in fields:
            count = len(field.rest)
            assert field.positions.shape == (count, 3)
            assert field.pixels.shape == (count, 2)
            assert field.faces.max() < count
            assert ((field.distance.value > 0) & (field.distance.value < 10)).all()
            assert ((field.shape.value > 0) & (field.shape.value < 0.02)).all()


def test_a_stream_is_told_once_and_in_order(clips: list[list[PreparedFrame]], alone: list[Said]) -> None:
    for frames, (told, (run,)) in zip(clips, alone, strict=True):
        assert [item.frame for item in told] == [frame.frame.number for frame in frames]
        assert [item.time_s for item in told] == [frame.frame.time_s for frame in frames]
        assert [item.status for item in told] == [frame.status for frame in frames]
        assert [run.onset] == [frame.frame.index for frame in frames if begins(frame)]
        assert run.load_s == pytest.approx(0.3, abs=0.021)
        assert len(run.interaction.observation) > 3


def begins(frame: PreparedFrame) -> bool:
    """Whether a run of contact begins here, its onset seen."""
    return frame.track_start == frame.frame.index


def test_every_estimate_has_its_verdict_its_covariance_and_its_words(estimator, alone) -> None:
    told, runs = ([item for said in alone for item in said[kind]] for kind in (0, 1))
    of_frames = [item.estimate for item in told if item.estimate is not None]
    estimates = of_frames + [run.estimate for run in runs if run.estimate is not None]
    assert (of_frames == []) == (estimator.name in ("direct", "online"))
    assert (estimates == []) == (estimator.name == "online")
    for found in estimates:
        require_complete(estimator, found)
    of_each = ("onset_in_view", "determined", "ratios", "undetermined")
    verdicts = {"direct": ("",), "online": ("stiffness_ratios", "undetermined")}.get(estimator.name, of_each)
    for item in told:
        if item.status == "ok":
            assert item.verdict in verdicts
            assert item.estimate is not None or item.field is not None or item.detail
            assert item.detail == WHOLE or estimator.name != "direct"
        else:
            assert (item.estimate, item.verdict) == (None, "")
    assert all(run.estimate is not None or run.detail for run in runs)


def test_a_press_is_simulated_with_the_load_and_the_constants_that_are_told(estimator, alone) -> None:
    for _, (run,) in alone:
        assert (run.mechanics is None) == (estimator.name in ("gan", "online"))
        if run.mechanics is None or run.estimate.light:
            continue
        press = fitted_press(run.interaction, run.estimate, run.mechanics.time_step, run.mechanics.steps)
        path = simulate(run.estimate.theta, run.interaction.mesh, press, run.mechanics) @ run.interaction.direction
        times, along = run.simulated
        began = run.estimate.course.delays[0] + run.mechanics.time_step * np.arange(len(path) + 1)
        found = np.interp(times, began, np.concatenate([[0.0], path]))
        np.testing.assert_allclose(found, along, rtol=0, atol=0.002 * np.abs(along).max())


def require_complete(estimator: Estimator, found: PressResult) -> None:
    """θ in its octant; a covariance with verdict, reason and information by it, or a verdict that needs none."""
    assert found.theta.shape == (3,)
    assert (np.sign(found.theta) == (1, 1, -1)).all()
    if estimator.name == "gan":
        assert (found.covariance, found.information, found.explanation, found.determined) == (None, None, "", ())
        assert found.verdict in ("onset_in_view", "undetermined")
        return
    assert found.verdict in ("determined", "ratios", "undetermined")
    np.testing.assert_allclose(found.covariance, found.covariance.T, rtol=1e-9, atol=1e-12)
    for matrix in (found.covariance, found.verdict_information):
        assert np.linalg.eigvalsh(matrix).min() > 0
    assert found.information.shape == (3, 3)
    assert found.misfit > 0
    assert found.noise > 0
    assert found.course.view_angle is not None or found.light


def test_depth_counts_for_a_network_that_takes_it(files, frames) -> None:
    """It counts in frames and runs alike: other pictures, other estimates."""
    estimator = files["network with depth"].build()
    dark = [dataclasses.replace(frame, depth=0.5 * frame.depth) for frame in frames]
    estimates = 0
    told, other = ([*chain(*follow(estimator.start(clip_info()), each))] for each in (frames, dark))
    for said in zip(told, other, strict=True):
        first, second = (item.estimate for item in said)
        assert (first is None) == (second is None)
        if first is not None:
            assert not np.allclose(first.theta, second.theta, rtol=1e-6)
            estimates += 1
    assert estimates > 1


def test_nothing_of_a_clip_stays_with_the_estimator(estimator: Estimator, clips: list[list[PreparedFrame]]) -> None:
    before, held = dict(vars(estimator)), reachable(estimator)
    follow(estimator.start(clip_info()), clips[0])
    assert vars(estimator).keys() == before.keys()
    assert all(vars(estimator)[name] is value for name, value in before.items())
    assert reachable(estimator) == held


def test_finishing_twice_or_without_frames_does_no_harm(estimator, clips, alone) -> None:
    empty = estimator.start(clip_info())
    assert [*empty.finish(), *empty.finish()] == []
    # Cut off in contact: what is left comes once.
    frames = clips[0][: next(index for index, frame in enumerate(clips[0]) if begins(frame)) + 2]
    session = estimator.start(clip_info())
    before = [item for frame in frames for item in session.push(frame)]
    told, runs = sorted_out([*before, *session.finish()])
    assert len(told) == len(frames)
    assert [run.onset for run in runs] == [len(frames) - 2]
    assert runs[0].load_s is None
    assert list(session.finish()) == []


class FaultySource(SyntheticSource):
    """Pictures of a clip, some of which can't be read, with the numbers that are given."""

    def __init__(self, clip: SyntheticClip, numbers: list[int], unreadable: tuple[int, ...]) -> None:
        super().__init__(clip)
        self.numbers, self.unreadable = numbers, unreadable

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order."""
        for frame, number in zip(super().__iter__(), self.numbers, strict=True):
            broken = {"image": None, "error": "Broken."} if number in self.unreadable else {}
            yield dataclasses.replace(frame, number=number, time_s=number / self.fps, **broken)


class FaultyMasks(_Masks):
    """Masks of a clip, of which some are missing."""

    def __init__(self, clip: SyntheticClip, without: tuple[int, ...]) -> None:
        super().__init__(clip)
        self.without = without

    def __call__(self, frame: Frame) -> np.ndarray:
        """Label map of a frame."""
        if frame.number in self.without:
            raise MaskError("No mask.")
        return super().__call__(frame)


def faulty(
    clip: SyntheticClip, numbers: range, unreadable=(), without_depth=(), without_mask=(), without_tool=(), missing=()
) -> list[PreparedFrame]:
    """A clip that is damaged in the frames of these numbers, prepared.

    A tool that is not in the mask is in sight; where frames are missing the others keep their numbers.
    """
    kept = [number for number in numbers if number not in missing]
    parts = {name: getattr(clip, name)[kept] for name in ("images", "labels", "depth")}
    parts["depth"][np.isin(kept, without_depth)] = 0
    bare = np.isin(kept, without_tool)
    parts["labels"][bare] = np.where(parts["labels"][bare] == CLASSES["grasper"].grey, 0, parts["labels"][bare])
    cut = dataclasses.replace(clip, **parts)
    inputs = {"masks": FaultyMasks(cut, without_mask), "depth": _Depth(cut), "camera": clip.camera}
    source = FaultySource(cut, kept, unreadable)
    return list(ClipStream(source, PrepareSettings(geometry=clip_info().geometry), **inputs))


# The tool touches frames 7 to 14 of `pressed`.
FAULTY = {
    "unreadable": (range(17), {"unreadable": (0, 10)}, [(7, True), (11, False)]),
    "without depth": (range(17), {"without_depth": (2, 10, 16)}, [(7, True)]),
    "without mask": (range(17), {"without_mask": (6, 10)}, [(7, False)]),
    "gaps in the numbers": (range(17), {"missing": (1, 9, 15)}, [(6, True), (8, False)]),
    "flicker": (range(17), {"without_tool": (9, 11, 12)}, [(7, True)]),
    "contact from the first frame on": (range(7, 17), {}, [(0, False)]),
    "always in contact": (range(8, 14), {}, [(0, False)]),
    "one frame": (range(8, 9), {}, [(0, False)]),
    "no contact": (range(5), {}, []),
}


@pytest.fixture(scope="module")
def damaged(pressed: SyntheticClip) -> dict[str, list[PreparedFrame]]:
    """A clip of every kind."""
    return {kind: faulty(pressed, numbers, **faults) for kind, (numbers, faults, _) in FAULTY.items()}


@pytest.mark.parametrize("kind", FAULTY)
def test_bad_frames_are_survived(estimator: Estimator, damaged: dict[str, list[PreparedFrame]], kind: str) -> None:
    """Runs of contact begin where they should, and are fitted where their onset is visible."""
    frames, (_, _, expected) = damaged[kind], FAULTY[kind]
    told, runs = follow(estimator.start(clip_info()), frames)
    assert [(item.frame, item.status) for item in told] == [(frame.frame.number, frame.status) for frame in frames]
    assert [(run.onset, run.interaction is not None) for run in runs] == expected
    assert [run.onset_frame for run in runs] == [frames[run.onset].frame.number for run in runs]
    for frame, item in zip(frames, told, strict=True):
        assert frame.detail in item.detail
        assert item.detail or item.status in ("ok", "no_contact", "no_tool")
    for run in runs:
        assert run.estimate is not None or run.detail
        if run.estimate is not None:
            require_complete(estimator, run.estimate)


states = some.builds(
    State,
    status=some.one_of(some.sampled_from(("ok", "no_contact")), some.sampled_from(STATUSES)),
    missing=some.sampled_from((0, 0, 0, 0, 1)),
    rested=some.sampled_from((True, True, False)),
    moved=some.none() | some.tuples(*[some.floats(-0.02, 0.02)] * 3),
)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(some.lists(states, max_size=16), some.booleans())
@example([State("ok")], True)
def test_any_clip_has_each_frame_and_each_run_once(estimator: Estimator, clip: list[State], noisy: bool) -> None:
    # A fit takes a second, so that the direct estimator is left to decline.
    noise = 0.001 if noisy and estimator.name != "direct" else float("nan")
    frames = linked(clip, touched(MESH, 24, NORMAL, noise))
    told, runs = follow(estimator.start(clip_info()), frames)
    assert [item.frame for item in told] == [frame.frame.number for frame in frames]
    assert [run.onset for run in runs] == [run.first for run in whole_clip_runs(frames, 2)]
    for run in runs:
        assert (run.interaction is not None) <= begins(frames[run.onset])
        assert run.estimate is not None or run.detail


def reachable(thing: object, *others: object) -> int:
    """Objects that something holds, however deep, without `others`, plain values and what all programs hold."""
    everywhere = (type, types.ModuleType, types.FunctionType, types.BuiltinFunctionType, int, float, str)
    known, left, count = {id(other) for other in others}, [thing], 0
    while left:
        item = left.pop()
        if id(item) not in known and not isinstance(item, everywhere):
            known.add(id(item))
            count += 1
            left += gc.get_referents(item)
    return count


def pressing(presses: int, frames: int) -> list[State]:
    """Presses of so many frames, each after three frames without."""
    down = [State("ok", moved=(0.0, 0.0, 0.01 * min(index, 10))) for index in range(frames)]
    return ([State("no_contact")] * 3 + down) * presses


@pytest.mark.parametrize(("presses", "length", "early"), [(1, 150, 60), (15, 5, 80)], ids=["a long press", "many"])
def test_a_session_does_not_grow(prompt: Estimator, presses: int, length: int, early: int) -> None:
    """Over frames: the first second of a press is kept, and no more."""
    noise = 0.001 if prompt.name != "direct" else float("nan")
    geometry = touched(MESH, 24, NORMAL, noise)
    frames = linked(pressing(presses, length), geometry)
    session, held = prompt.start(clip_info()), []
    runs: list[InteractionEstimate] = []
    for frame in frames:
        runs += sorted_out(session.push(frame))[1]
        held.append(reachable(session, prompt))
    assert len(runs) == presses - 1
    assert max(held[early:]) <= max(held[:early])
