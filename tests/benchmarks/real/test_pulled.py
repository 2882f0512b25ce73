"""Drawn tissue that a drawn tool pulls: what the session of users says of it, and what can't be said."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.real.__main__ import PulledClip, evaluate_pull
from palpate.data.source.layout import InputError
from tests.benchmarks.real_clips import pull_clip

SHARES = np.linspace(0, 3, 9)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> PulledClip:
    return pull_clip(tmp_path_factory.mktemp("pulled"), SHARES)


def test_what_the_session_says_of_a_grip_is_told(clip: PulledClip) -> None:
    told = evaluate_pull(clip)
    assert (told["status"], told["verdict"]) == ("ok", "relative_force")
    assert told["skill in frames kept back"] > 0.5
    assert told["seconds of the fit"] > 0
    assert told["frames that move"] >= 6
    assert told["frames"] == len(SHARES)
    shown = [value for name, value in told.items() if name.startswith("contact_frame_")]
    assert len(shown) == len(SHARES)
    assert told["frames in contact"] == sum(value >= 0.5 for value in shown)


def test_a_clip_that_can_t_be_read_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no can't be opened"):
        evaluate_pull(PulledClip(tmp_path / "no"))


@pytest.mark.slow
def test_a_real_clip_is_told_of_as_users_have_it(real_data: Path) -> None:
    """Half a minute: sixteen frames of half a megapixel."""
    folder = real_data / "recover_tissue"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    layout = Path(__file__).parents[3] / "configs/layouts/recover_tissue.yaml"
    told = evaluate_pull(PulledClip(folder, layout))
    assert told["verdict"] == "relative_force"
    assert told["skill in frames kept back"] > 0.4
