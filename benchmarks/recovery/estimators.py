"""What the benchmark compares: the estimators that users run, and a constant that ignores its input."""

import functools
from typing import Any

import numpy as np
from rich.progress import Progress

from benchmarks.recovery.suites import FITTED_ON, GRID_SIZE, SUITES, suite_clip_seed
from palpate.common.workers import run_tasks
from palpate.data.synthetic.clip import draw_truth
from palpate.data.synthetic.scene import SceneError
from palpate.data.synthetic.truth import PressedMotion
from palpate.estimators.contract import Estimator
from palpate.estimators.estimate import Estimate
from palpate.estimators.open import OF_THETA, EstimatorOptions, open_estimator
from palpate.models.onnx_session import ModelFileError, PosteriorModel
from palpate.physics.mechanics import theta_of

CONSTANT, DIRECT = "constant", "direct"
"""What ignores its input, and the estimator that fits grips."""
NAMES = (*sorted(OF_THETA), CONSTANT)
"""Estimators in the order of tables."""
CONSTANT_CLIPS = 60
"""Truths whose mean the constant is: over all clips its error is then within 1 % of the least."""
Candidate = EstimatorOptions | Estimate
"""An estimator, or what one says that ignores its input."""


@functools.cache
def opened(options: EstimatorOptions) -> Estimator:
    """The estimator, opened once a process.

    Raises:
        ModelFileError: its network can't be used.
    """
    found = open_estimator(options)
    model = getattr(found, "model", None)
    if model is not None and getattr(model, "takes_depth", True) and model.input_size[::-1] != GRID_SIZE:
        taken, given = ("x".join(map(str, size)) for size in (model.input_size[::-1], GRID_SIZE))
        raise ModelFileError(
            f"{model.path} takes depth of {taken} pixels and the benchmark's has {given}; "
            "export a network that was trained at that size."
        )
    return found


def describe(options: EstimatorOptions) -> dict[str, Any]:
    """What its estimates depend on, for the run's record.

    Raises:
        ModelFileError: its network can't be used.
    """
    model = getattr(opened(options), "model", None)
    posterior = model if isinstance(model, PosteriorModel) else None
    return {
        "model_sha256": "" if model is None else model.sha256,
        "weights_sha256": "" if posterior is None else posterior.metadata.get("training", {}).get("weights_sha256", ""),
        "calibrated": None if posterior is None else posterior.calibrated,
        "noise": options.noise,
        "seen": options.horizon,
        "onset": options.onset,
    }


def constant_estimate(split: str, seed: int, workers: int, progress: Progress) -> Estimate:
    """The mean of true log θ over clips of a split that is not judged, as wide as these, whatever is observed.

    Args:
        split: whose clips are judged, one of `benchmarks.recovery.suites.SPLITS`.
        seed: the user's.
        workers: processes; 0 = in this one.
        progress: gets a bar.
    """
    fitted_on = FITTED_ON[split]
    tasks = [(index, suite_clip_seed(fitted_on, seed, index)) for index in range(CONSTANT_CLIPS)]
    drawn = run_tasks(draw_log_theta, tasks, workers, ordered=True)
    bar = progress.track(drawn, total=CONSTANT_CLIPS, description=f"truths of the {fitted_on} split")
    logs = np.array([logs for logs in bar if logs is not None])
    return Estimate(theta_of(logs.mean(axis=0)), np.cov(logs.T), given_verdict="undetermined")


def draw_log_theta(task: tuple[int, int]) -> np.ndarray | None:
    """True log |θ| of a clip, shape [3], without its pictures; None where nothing can be drawn.

    Args:
        task: index and seed of the clip.
    """
    index, seed = task
    try:
        _, motion = draw_truth(SUITES["clean"].truth_settings(index), seed)
    except SceneError:
        return None
    assert isinstance(motion, PressedMotion)
    return np.log(np.abs(motion.theta))
