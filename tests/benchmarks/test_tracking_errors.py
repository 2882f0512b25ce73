"""Known properties of errors are measured as they were put in, and the clips are of the validation split."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.benchmarks import tracking_errors as benchmark
from palpate.benchmarks.tracking_errors import FRAMES, STEP, ClipErrors, measure_clip, stacked, statistics
from palpate.data.synthetic.scene import SceneError
from palpate.evaluation.recovery.suites import suite_clip_seed

TIMES = np.arange(1, FRAMES + 1)


def clip_of(along: np.ndarray, simulated: np.ndarray, generator: np.random.Generator) -> ClipErrors:
    across, rest = 0.1 * generator.normal(size=(FRAMES, 2)), 0.05 * generator.normal()
    errors = ClipErrors(along, across, simulated, rest, sigma=1 + 0.02 * generator.normal())
    for values in errors[:3]:
        values[3] = np.nan  # a frame in which the tissue was not followed
    return errors


def motion(generator: np.random.Generator) -> np.ndarray:
    """A slow swing of up to 6 rounding steps [σ]."""
    return STEP * generator.uniform(1, 6) * np.sin(generator.uniform(0.05, 0.4) * TIMES)


def noisy_clips(count: int, size: float, rest: float, seed: int) -> list[ClipErrors]:
    """White noise on top of an error that all frames of a clip share."""
    generator = np.random.default_rng(seed)
    errors = [generator.normal(rest * generator.normal(), size, FRAMES) for _ in range(count)]
    return [clip_of(along, motion(generator), generator) for along in errors]


def rounded_clips(count: int, seed: int) -> list[ClipErrors]:
    """Depths that were rounded indeed, each clip's from another place within a step."""
    generator, clips = np.random.default_rng(seed), []
    for _ in range(count):
        simulated, place = motion(generator), generator.uniform(0, STEP)
        observed = np.rint((simulated + place) / STEP) * STEP - place
        clips.append(clip_of(observed - simulated, simulated, generator))
    return clips


def test_noise_and_what_its_frames_share() -> None:
    found = statistics(stacked(noisy_clips(400, 1.2, 0.4, seed=0)))
    assert found["contacts"] == 400
    assert found["spread along the force"] == pytest.approx(1.2, rel=0.02)
    assert found["spread across it"] == pytest.approx(0.1, rel=0.02)
    assert found["spread of the rest position's error"] == pytest.approx(0.05, rel=0.15)
    assert (found["told over true σ"], found["its spread"]) == pytest.approx((1, 0.02), abs=0.003)
    for lag in (1, 4):
        assert found[f"correlation, {lag} frames apart"] == pytest.approx(0.16 / (0.16 + 1.44), abs=0.03)


def test_rounding_errors_of_a_slow_motion() -> None:
    for part, theory, found in np.array(benchmark.rounding_rows(stacked(rounded_clips(400, seed=2))), float):
        assert theory == pytest.approx(1 - 6 * part * (1 - part), abs=0.03)
        assert found == pytest.approx(theory, abs=0.1)


def test_evidence_tells_rounding_from_noise() -> None:
    name = "log evidence for rounding, 50 %"
    assert statistics(stacked(rounded_clips(100, seed=6)))[name] > 2
    assert statistics(stacked(noisy_clips(100, 1.0, 0.0, seed=7)))[name] < -2


def test_tables_of_validation_clips(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    tasks: list[tuple[int, int]] = []
    suites = {
        "clean": noisy_clips(20, 1.0, 0.1, 8),
        "8bit": rounded_clips(20, 9),
        "noisy": noisy_clips(20, 1.0, 0.1, 10),
    }

    def run_tasks(function, wanted, workers):
        assert function is measure_clip
        tasks.extend(wanted)
        return iter([{name: clips[index] for name, clips in suites.items()} for index, _ in wanted])

    monkeypatch.setattr(benchmark, "run_tasks", run_tasks)
    monkeypatch.setattr(benchmark, "CLIPS", 20)
    monkeypatch.setattr("sys.argv", ["tracking_errors"])
    benchmark.main()
    assert tasks == [(index, suite_clip_seed("validation", 777, index)) for index in range(20)]
    for split in ("training", "test"):
        assert not {seed for _, seed in tasks} & {suite_clip_seed(split, 777, index) for index in range(20)}
    printed = capsys.readouterr().out.splitlines()
    assert "| contacts | 20 | 20 | 20 |" in printed
    assert "| u | 1 - 6u(1 - u) | correlation |" in printed


def test_a_clip_with_known_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    task = 2, suite_clip_seed("validation", 0, 2)  # over-damped: the cheapest motion
    found = measure_clip(task)
    assert list(found) == ["clean", "8bit", "noisy"]
    for clip in found.values():
        assert np.isfinite(clip.along).all()
        assert clip.sigma == pytest.approx(1, abs=0.05)
        assert abs(clip.rest) < 0.3
        assert 0.5 < np.sqrt(np.mean(np.square(clip.along))) < 1.5
        assert np.sqrt(np.mean(np.square(clip.across))) < 0.5
    sizes = {"clean": 0.001, "8bit": 1 / 255 / STEP, "noisy": 0.004}  # σ in scene units; the truth is the same
    truths = [clip.simulated * clip.sigma * sizes[name] for name, clip in found.items()]
    np.testing.assert_allclose(truths[1:], [truths[0]] * 2, atol=0.02 * np.abs(truths[0]).max())
    assert np.abs(found["8bit"].along).max() < STEP / 2 + 0.5

    def nothing(*_: object) -> None:
        raise SceneError("nothing to draw.")

    monkeypatch.setattr(benchmark, "draw_press", nothing)
    assert measure_clip(task) == {}
