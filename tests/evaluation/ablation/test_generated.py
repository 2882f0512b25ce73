"""A trained generator on a clip: its θ is its head's, its picture its decoder's."""

from pathlib import Path

import numpy as np
import pytest

from palpate.estimators.onset import STAMP
from palpate.estimators.open import EstimatorOptions, open_estimator
from palpate.estimators.records import FrameEstimate
from palpate.evaluation.ablation.generated import TrainedGenerator, carried_ahead
from palpate.evaluation.ablation.watched import WatchedClip, watch
from palpate.evaluation.recovery.bounds import MECHANICS
from palpate.evaluation.recovery.suites import suite_clip_seed
from palpate.models.generator import LEAST_DEPTH
from palpate.models.onnx_session import SHIPPED
from tests.evaluation.ablation.trained_generators import write_checkpoint


@pytest.fixture(scope="module")
def clip() -> WatchedClip:
    found = watch("clean", 0, suite_clip_seed("validation", 0, 0))
    assert found is not None
    return found


@pytest.fixture(scope="module")
def generator(tmp_path_factory: pytest.TempPathFactory) -> TrainedGenerator:
    return TrainedGenerator(write_checkpoint(tmp_path_factory.mktemp("run") / "last.ckpt"))


@pytest.mark.slow
def test_its_theta_is_what_the_same_head_says_as_a_network(clip: WatchedClip, generator: TrainedGenerator) -> None:
    """In every frame: told what was seen up to it, as training tells it and as `infer.py` does."""
    session = open_estimator(EstimatorOptions("network", model=SHIPPED, onset=STAMP, threads=1)).start(clip.info)
    said = [item for frame in clip.frames for item in session.push(frame) if isinstance(item, FrameEstimate)]
    network = {item.frame: item.estimate.theta for item in said if item.estimate is not None}
    instants = clip.instants(4)
    assert len(instants) > 4
    for now in instants:
        np.testing.assert_allclose(generator.estimate(clip, now), network[now], rtol=2e-4)


@pytest.mark.slow
def test_a_decoder_that_adds_nothing_gives_its_start(clip: WatchedClip, tmp_path: Path) -> None:
    """The carried map, by whatever constants of the rollout; the last one; or the same everywhere."""
    now, theta = clip.instants(4)[-1], clip.motion.theta
    carried = carried_ahead(clip, now, 4, theta, MECHANICS)
    starts = {"physics": carried, "residual": clip.frames[now].depth, "direct": np.full(carried.shape, 0.5)}
    assert np.abs(carried - starts["residual"]).max() > 0.003
    for decoder, start in starts.items():
        path = tmp_path / f"{decoder}.ckpt"
        made = TrainedGenerator(write_checkpoint(path, decoder)).picture(clip, now, theta)  # ty: ignore[invalid-argument-type]  a key
        valid = (clip.frames[now].depth > 0) & (start > LEAST_DEPTH)
        assert valid.mean() > 0.9
        np.testing.assert_allclose(made[valid], start[valid], atol=1e-4)
        assert not made[clip.frames[now].depth == 0].any()
