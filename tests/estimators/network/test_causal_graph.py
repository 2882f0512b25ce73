"""One graph that follows presses frame by frame: its numbers are the estimator's, in plain ONNX Runtime."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from palpate.data.brightness.sequence import SIDE, BrightnessSequence
from palpate.data.contact.features import FRAME_RATE
from palpate.data.contact.interaction import BRIGHTNESS, Interaction
from palpate.data.contact.light_features import light_shapes, light_slots
from palpate.estimators.estimate import COMBINATIONS, NoEstimate
from palpate.estimators.network.causal_graph import INPUTS, OUTPUTS, STATE
from palpate.estimators.network.estimator import NetworkEstimator
from palpate.estimators.network.light_calibration import main
from palpate.estimators.onset import BETWEEN
from palpate.models.onnx_session import SHIPPED, ModelFileError, PosteriorModel, open_model
from palpate.physics import Observation, Press, held
from tests.lit_contacts import facing

STEP, STEPS = 0.005, 200
FRAMES = 2000


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("graph") / "press.onnx"
    assert main(["--model", str(SHIPPED), "--one-graph", "--output", str(path)]) == 0
    return path


def press(random: np.random.Generator) -> Iterator[tuple[Interaction, list[np.ndarray]]]:
    """A press as it is known after each of its frames, with what the graph is given of that one beside the state."""
    times = np.cumsum(random.uniform(0.4, 1.6, 40) / random.choice([12.0, 25.0, 30.0, 60.0]))
    times = times[times < (STEPS + 0.5) * STEP][: random.integers(1, 30)]
    released = random.choice([random.uniform(0.05, 0.7), math.inf])
    shapes, inner = light_shapes()
    fall, rest = np.exp(-times / random.uniform(0.02, 0.5)), np.minimum(released, times)
    course = np.where(times < released, 1 - fall, np.exp((rest - times) / 0.1))[:, None]
    amounts = course * random.normal(0, random.choice([0.01, 0.1, 0.3]), shapes.shape[1]) * (np.arange(24) < 8)
    change = np.full((len(times), SIDE, SIDE), np.nan, np.float32)
    change[:, inner] = amounts @ shapes.T
    change += random.normal(0, random.choice([0.002, 0.01, 0.1]), change.shape).astype(np.float32)
    hidden = np.zeros((SIDE, SIDE), bool)
    for frame in change:
        if random.random() < 0.4:  # an instrument has moved, and highlights; now and then nothing is seen
            hidden = random.random(hidden.shape) < random.choice([0.0, 0.1, 1.0], p=[0.5, 0.4, 0.1])
            row, column = random.integers(0, SIDE, 2)
            hidden[row:, column : column + random.integers(0, SIDE)] = True
        frame[hidden] = np.nan
    scene = random.uniform((0.2, 100, 5, 0, 0.001), (0.7, 250, 50, 0.05, 0.03))
    mesh, vertex = facing(*scene[:2], int(scene[2]))
    rim, step, noise = min(int(scene[2]), 40), *scene[3:]
    kind = type("Coded", (BrightnessSequence,), {"coder_step": step})
    for at, time in enumerate(times, start=1):
        sequence = kind(times[:at], change[:at], np.zeros((SIDE, SIDE), np.float32), noise)
        seconds = released if released <= time else math.inf
        # As in sessions an end that is not seen yet is now, which differs from none before the first slot alone.
        until = seconds if time < 1 / FRAME_RATE else min(seconds, time)
        steps = round(min(until / STEP, STEPS))
        load = Press.at(vertex, np.array([0, 0, -1], np.float32), held(steps, STEPS))
        seen = Observation.of_point(vertex, times[:at], np.zeros((at, 3)), np.nan)
        contact = Interaction(mesh, load, seen, STEP, brightness=sequence)
        known = [time, contact.load_seconds if seconds < math.inf else math.inf]
        yield contact, [change[at - 1], np.array(known), np.array([*scene[:2], rim, step, noise]), np.array(at == 1)]


@pytest.mark.slow
def test_frame_by_frame_it_says_what_the_estimator_says_of_the_press_so_far(written: Path) -> None:
    network = NetworkEstimator(PosteriorModel(SHIPPED), BETWEEN, observation=BRIGHTNESS)
    session = onnxruntime.InferenceSession(written)
    random, state = np.random.default_rng(39), np.full((1, STATE), np.nan)
    flags, given, told, worst = [], list[tuple[np.ndarray, ...]](), {}, np.zeros(2)
    while len(flags) < FRAMES:
        for contact, values in press(random):
            # The state of the press before stays: the flag alone begins a new one.
            given.append((*(value[None] for value in values), state))
            told = dict(zip(OUTPUTS, session.run(OUTPUTS, dict(zip(INPUTS, given[-1], strict=True))), strict=True))
            state = told["next_state"]
            determined, at_bound = told["determined"][0], told["at_bound"][0]
            flags.append([*determined, *at_bound, told["left"][0] > 0.6])
            try:
                found = network.lit(contact)
            except NoEstimate:
                assert np.isnan(told["log_mean"]).all()
                assert np.isnan(told["log_covariance"]).all()
                assert not np.any([*determined, *at_bound])
                continue
            assert tuple(np.array(list(COMBINATIONS))[determined]) == found.determined
            assert at_bound.tolist() == found.at_bound.tolist()
            assert bool(found.refuted) == flags[-1][-1]
            assert told["misfit"][0] == pytest.approx(found.misfit, rel=1e-9)
            pairs = (told["log_mean"][0], np.log(np.abs(found.theta))), (told["log_covariance"][0], found.covariance)
            worst = np.maximum(worst, [np.abs(one - other).max() for one, other in pairs])
        slots, count = light_slots(contact)
        assert told["known"] == count
        assert told["left"] == pytest.approx(slots.unexplained(count), abs=1e-9)
    assert worst.max() < 1e-5
    # Each was seen both ways, but for k_d and F, which are never at their bounds here.
    often = np.mean(flags, axis=0)[[*range(7), 9]]
    assert (often > 0.01).all()
    assert (often < 0.99).all()
    # Presses side by side are what they are alone; these are the last frames, of which one begins a press.
    some = [np.concatenate(values) for values in zip(*given[-40:], strict=True)]
    both = dict(zip(OUTPUTS, session.run(OUTPUTS, dict(zip(INPUTS, some, strict=True))), strict=True))
    assert some[3].any()
    np.testing.assert_allclose(both["next_state"][-1:], told["next_state"], atol=1e-12)
    np.testing.assert_allclose(both["log_mean"][-1:], told["log_mean"], atol=1e-5)


@pytest.mark.slow
def test_it_is_one_file_of_plain_operators_that_infer_does_not_take(written: Path) -> None:
    model = onnx.load(written)
    onnx.checker.check_model(model, full_check=True)
    assert {node.domain for node in model.graph.node} == {""}
    assert [entry.version for entry in model.opset_import] == [18]
    assert [path.name for path in written.parent.iterdir()] == [written.name]
    with pytest.raises(ModelFileError, match="takes change"):
        open_model(written)


def test_a_file_that_knows_no_light_is_refused(posterior: PosteriorModel, tmp_path: Path, capsys) -> None:
    output = tmp_path / "press.onnx"
    assert main(["--model", str(posterior.path), "--one-graph", "--output", str(output)]) == 1
    remedy = "give a file to which estimators.network.light_calibration added it"
    assert capsys.readouterr().err == f"{posterior.path} knows nothing of light; {remedy}.\n"
    assert not output.exists()
