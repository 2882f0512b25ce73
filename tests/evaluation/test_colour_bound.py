"""What colours could tell: of nothing that moves nothing, half the noise four times as much, and the door's table."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from evaluation.colour_bound import ColourBounds, colour_information, table
from evaluation.recovery.suites import suite_clip_seed
from evaluation.watched import WatchedClip, watch


def with_noise(clip: WatchedClip, noise: float) -> WatchedClip:
    """The same clip seen by a better or worse camera."""
    settings = dataclasses.replace(clip.scene.settings, image_noise=noise)
    return dataclasses.replace(clip, scene=dataclasses.replace(clip.scene, settings=settings))


@pytest.mark.slow
def test_pictures_of_the_onset_tell_nothing_and_noise_counts_squared() -> None:
    clip = watch("noisy", 2, suite_clip_seed("validation", 0, 2))
    assert clip is not None
    onset = clip.motion.onset_frame
    np.testing.assert_allclose(colour_information(clip, onset), 0.0, atol=1e-6)
    little, much = (colour_information(with_noise(clip, noise), onset + 3) for noise in (0.1, 0.2))
    np.testing.assert_allclose(little, 4 * much, rtol=1e-3)
    assert np.linalg.eigvalsh(much).min() > 0
    assert much[1, 2] < 0  # tissue that creeps more slowly looks like tissue pressed less


def test_a_row_has_the_medians_of_its_suite_and_regime() -> None:
    bounds = np.arange(1.0, 10.0).reshape(3, 3)
    found = [ColourBounds("noisy", "critical", factor * bounds) for factor in (1, 2, 30)]
    found.append(ColourBounds("noisy", "over-damped", bounds))
    assert table(found) == [
        ["noisy", "critical", "3", "2, 4, 6", "8, 10, 12", "14, 16, 18"],
        ["noisy", "over-damped", "1", "1, 2, 3", "4, 5, 6", "7, 8, 9"],
    ]
