"""Known properties of errors are measured as they were put in, and the clips are of the validation split."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from benchmarks import tracking_errors as benchmark
from benchmarks.tracking_errors import (
    BEYOND,
    EDGE,
    PARTS,
    STEP,
    ClipErrors,
    amplitudes,
    common_variance,
    correlation,
    fitted_fall,
    frame_pairs,
    jackknife,
    measure_clip,
    of_pairs,
    part_bins,
    rounding_evidence,
    sawtooth,
    shares_beyond,
    spread,
)
from data.synthetic.scene import SceneError
from estimators.direct import error_model as noise
from evaluation.recovery.suites import suite_clip_seed

FRAMES = np.arange(1, 26)


def clip_of(along: np.ndarray, simulated: np.ndarray, generator: np.random.Generator) -> ClipErrors:
    across, rest = 0.1 * generator.normal(size=(len(along), 2)), 0.05 * generator.normal()
    return ClipErrors(along, across, simulated, FRAMES, rest, sigma=1 + 0.02 * generator.normal())


def motion(generator: np.random.Generator) -> np.ndarray:
    """A slow swing of up to 6 rounding steps [σ]."""
    return STEP * generator.uniform(1, 6) * np.sin(generator.uniform(0.05, 0.4) * FRAMES)


def noisy_clips(count: int, size: float, rest: float, seed: int) -> list[ClipErrors]:
    """White noise on top of an error that all frames of a clip share."""
    generator = np.random.default_rng(seed)
    errors = [generator.normal(rest * generator.normal(), size, len(FRAMES)) for _ in range(count)]
    return [clip_of(along, motion(generator), generator) for along in errors]


def rounded_clips(count: int, seed: int, rest: float = 0.0) -> list[ClipErrors]:
    """Depths that were rounded indeed, each clip's from another place within a step."""
    generator, clips = np.random.default_rng(seed), []
    for _ in range(count):
        simulated, place = motion(generator), generator.uniform(0, STEP)
        observed = np.rint((simulated + place) / STEP) * STEP - place + rest * generator.normal()
        clips.append(clip_of(observed - simulated, simulated, generator))
    return clips


def test_noise_and_what_its_frames_share() -> None:
    clips = noisy_clips(400, 1.2, 0.4, seed=0)
    assert spread([clip.along for clip in clips]) == pytest.approx(1.2, rel=0.02)
    assert spread([clip.across for clip in clips]) == pytest.approx(0.1, rel=0.02)
    value, error = jackknife(lambda some: common_variance(some, rounded=False), clips)
    assert value == pytest.approx(0.16, abs=3 * error)
    # A variance of 0.16 beside 1.2²/25 that chance leaves, known from 400 clips.
    assert error == pytest.approx((0.16 + 1.44 / 25) * math.sqrt(2 / 400), rel=0.2)
    lags = of_pairs(lambda pairs: [correlation(pairs[:, pairs[0] == lag]) for lag in (1, 4)], clips)
    np.testing.assert_allclose(lags[:, 0], 0.16 / (0.16 + 1.44), atol=0.03)


def test_the_jackknife_of_a_mean_is_its_standard_error() -> None:
    values = np.random.default_rng(1).normal(size=(50, 2))
    found = jackknife(lambda some: np.mean(some, axis=0), values)
    expected = np.stack([values.mean(axis=0), values.std(axis=0, ddof=1) / math.sqrt(50)], axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_rounding_errors_of_a_slow_motion() -> None:
    clips = rounded_clips(400, seed=2)
    pairs = np.concatenate([frame_pairs(clip) for clip in clips], axis=1)
    for some, low, high in zip(part_bins(pairs), PARTS, PARTS[1:], strict=False):
        assert ((some[0] == 1) & (low <= some[1] % 1) & (some[1] % 1 < high)).all()
        assert correlation(some) == pytest.approx(sawtooth(some[1]).mean(), abs=0.06)
    np.testing.assert_allclose(amplitudes(pairs)[:4], 1, atol=0.1)
    independent, reach = fitted_fall(pairs)
    assert independent == pytest.approx(0, abs=0.05)
    assert reach > 8  # no end of it but chance
    assert common_variance(clips, rounded=True) == pytest.approx(0, abs=0.02)
    assert common_variance(rounded_clips(400, 3, rest=0.4), rounded=True) == pytest.approx(0.16, abs=0.06)
    assert shares_beyond(clips)[2:] == pytest.approx(0)
    assert shares_beyond(clips)[0] == pytest.approx(2 * EDGE / STEP, abs=0.01)


def test_the_constants_come_out_of_errors_that_have_them() -> None:
    generator, clips = np.random.default_rng(4), []
    for _ in range(600):
        simulated = motion(generator)
        covariance = noise.rounding_covariance(simulated[None])[0]
        errors = generator.multivariate_normal(np.zeros(len(FRAMES)), covariance, method="cholesky")
        clips.append(clip_of(errors, simulated, generator))
    pairs = np.concatenate([frame_pairs(clip) for clip in clips], axis=1)
    independent, reach = fitted_fall(pairs)
    assert independent == pytest.approx(noise.INDEPENDENT, abs=0.1)  # chance: 0.036, and 0.2 for the reach
    assert reach == pytest.approx(noise.REACH, abs=0.6)


def test_the_shares_that_are_assumed_are_those_of_such_errors() -> None:
    generator, count = np.random.default_rng(5), 1_000_000
    even = generator.uniform(-STEP / 2, STEP / 2, count) + EDGE * generator.normal(size=count)
    errors = np.where(generator.random(count) < noise.ASTRAY, noise.WANDER * generator.normal(size=count), even)
    clips = [clip_of(errors, errors, generator)]
    found, assumed = shares_beyond(clips), benchmark.assumed_beyond()
    assert (np.abs(found - assumed) < 4 * np.sqrt(assumed / count)).all()
    assert len(found) == len(BEYOND)


def test_evidence_and_density() -> None:
    rounded, noisy = rounded_clips(100, seed=6), noisy_clips(100, 1.0, 0.0, seed=7)
    assert np.median([rounding_evidence(clip) for clip in rounded]) > 2
    assert np.median([rounding_evidence(clip) for clip in noisy]) < -2
    clip, before = rounded[0], noise.BLUR
    assert benchmark.log_density(clip, before) == noise.bounded_log_density(clip.along[None])[0]
    # Within its step an error has the density 1/STEP, however little its ends are blurred.
    inside = dataclasses.replace(clip, along=np.zeros(10))
    assert benchmark.log_density(inside, 0.001) == pytest.approx(-10 * math.log(STEP), abs=0.06)
    assert benchmark.log_density(inside, 1.0) < benchmark.log_density(inside, 0.001) - 0.5
    assert before == noise.BLUR


def test_tables_of_validation_clips(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    tasks: list[tuple[int, int]] = []
    suites = {
        "clean": noisy_clips(20, 1.0, 0.1, seed=8),
        "8bit": rounded_clips(20, seed=9),
        "noisy": noisy_clips(20, 1.0, 0.1, seed=10),
    }

    def run_tasks(function, wanted, workers):
        assert function is measure_clip
        tasks.extend(wanted)
        return iter([{name: clips[index] for name, clips in suites.items()} for index, _ in wanted])

    monkeypatch.setattr(benchmark, "run_tasks", run_tasks)
    assert benchmark.main(["--clips", "20"]) == 0
    assert tasks == [(index, suite_clip_seed("validation", 777, index)) for index in range(20)]
    for split in ("training", "test"):
        assert not {seed for _, seed in tasks} & {suite_clip_seed(split, 777, index) for index in range(20)}
    printed = capsys.readouterr().out
    assert "8bit: 20 of 20 clips" in printed
    line = next(line for line in printed.splitlines() if "spread along the force" in line)
    assert line.split("│")[2].split("±")[0].strip() == f"{spread([clip.along for clip in suites['clean']]):.3f}"
    for name in ("REST²", "TRACKING²", "INDEPENDENT", "REACH", "ASTRAY", "odds before: -3.0", "over BLUR 0.08"):
        assert name in printed

    monkeypatch.setattr(benchmark, "run_tasks", lambda *_: iter([{}] * 20))
    assert benchmark.main(["--clips", "20"]) == 1
    with pytest.raises(SystemExit, match="2"):
        benchmark.main(["--clips", "1"])


def test_a_clip_with_known_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    task = 2, suite_clip_seed("validation", 0, 2)  # over-damped: the cheapest motion
    found = measure_clip(task)
    assert list(found) == ["clean", "8bit", "noisy"]
    for clip in found.values():
        assert clip.frames.tolist() == list(range(1, 26))
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

    monkeypatch.setattr(benchmark, "draw_truth", nothing)
    assert measure_clip(task) == {}
