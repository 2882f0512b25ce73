"""A clip with its truth: the same without the errors of depth."""

import numpy as np
import pytest

from palpate.data.labels import TISSUE
from palpate.data.synthetic.scene import SceneError
from palpate.evaluation.ablation.watched import WatchedClip, watch
from palpate.evaluation.recovery.suites import SUITES, suite_clip_seed


@pytest.fixture(scope="module")
def clip() -> WatchedClip:
    found = watch("noisy", 2, suite_clip_seed("validation", 0, 2))
    assert found is not None
    return found


@pytest.mark.slow
def test_only_the_depth_s_errors_are_taken_away(clip: WatchedClip) -> None:
    seen, truth = clip.frames[0], clip.truth[0]
    tissue = (seen.labels == TISSUE) & (truth.labels == TISSUE)
    assert tissue.mean() > 0.3
    assert np.std((seen.depth - truth.depth)[tissue]) == pytest.approx(SUITES["noisy"].errors["depth_noise"], rel=0.05)


@pytest.mark.slow
def test_instants_have_a_past_and_a_future(clip: WatchedClip) -> None:
    instants = clip.instants(4)
    assert instants[0] == clip.motion.onset_frame + 2
    assert instants[-1] == clip.motion.release_frame - 1
    assert clip.instants(20) == instants[:4]  # the simulator's second ends after 25 frames
    assert clip.since(instants[0]) == pytest.approx(2 / clip.info.fps)


def test_a_clip_without_a_scene_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def hopeless(*_: object) -> None:
        raise SceneError("nothing moves so far")

    monkeypatch.setattr("palpate.evaluation.ablation.watched.draw_press", hopeless)
    assert watch("clean", 0, 1) is None
