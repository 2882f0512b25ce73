"""All numbers of an evaluation, from test records to what `evaluation.paper.report` writes (Bini 2026, section 4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from data.contact.interaction import Interaction
from evaluation.paper.baselines import (
    CHAOTIC_AMPLIFICATION,
    ConstantTheta,
    ConstantThetaSettings,
    amplification,
    fit_constant_theta,
    no_motion_error,
    reference_theta,
    simulate_contacts,
)
from evaluation.paper.collapse import CollapseCheck, check_collapse, conclude, describe
from evaluation.paper.figures import Response, ThetaSeries, response, theta_series
from evaluation.paper.settling import Settling, settle
from evaluation.paper.statistics import Comparison, Summary, compare, judge, summarise
from physics.mechanics import REFERENCE_DAMPING, REFERENCE_STIFFNESS, Bounds, Mechanics

Record = Mapping[str, Any]

REFERENCE, PREDICTED, CONSTANT = "reference θ", "predicted θ", "constant θ"
MEAN, NO_MOTION = "mean of predicted θ", "no motion"
PHRASES = {
    REFERENCE: f"the literature constants (k_s {REFERENCE_STIFFNESS}, k_d {REFERENCE_DAMPING})",
    CONSTANT: "the constant θ fitted on the training contacts",
    MEAN: "its own mean over the test frames, used for all of them",
    NO_MOTION: "a simulation in which nothing moves",
}
REGULARITY_CONTACTS = 16
"""Most test contacts simulated again to look for chaotic motion, evenly spaced over those available."""
SCENE_SIZE = 1.0
"""The deepest point of a scene lies at 1 scene unit: a larger displacement leaves the scene."""
CONDITION_SHARE = 0.05
"""Below this fraction of the change between frames, a change of θ hardly reaches the decoded picture."""


@dataclass(frozen=True)
class Regularity:
    """Whether one regime's simulations can be believed at all."""

    frames: int
    not_finite: int
    """Trajectories with a value that isn't finite."""
    leaves_scene: int
    """Finite trajectories whose peak exceeds 1 scene unit."""
    checked: int
    """Trajectories simulated again with F changed by 1e-4 of itself."""
    chaotic: int
    """Of those, how many changed by more than 100 times as much, relative to their peak."""


@dataclass(frozen=True)
class NextDepth:
    """The decoder as a predictor of the next depth map; errors are mean |Δz| [scene units]."""

    decoder: Summary
    copy: Summary
    """Error of repeating the last frame."""
    sensitivity: Summary
    """Change of the decoded depth when θ moves to the farthest corner of the admissible box."""
    comparison: Comparison
    sensitivity_share: float | None
    """Mean sensitivity divided by the mean change between frames (the copy error)."""
    sentences: tuple[str, str]


@dataclass(frozen=True)
class Evaluation:
    """Everything measured on the test frames; arrays have one entry a frame, in order of clip and frame."""

    clips: np.ndarray
    frames: np.ndarray
    contacts: int
    """Different observed motions behind the frames."""
    theta: np.ndarray
    """Predicted (k_s, k_d, F), F signed, shape [n, 3]."""
    errors: dict[str, np.ndarray]
    """Regime → displacement error of each frame [scene units²]."""
    summaries: dict[str, Summary]
    comparisons: dict[str, Comparison]
    """Baseline → paired comparison of the predicted θ with it."""
    constant: ConstantTheta | None
    missing: tuple[str, ...]
    """Sentences on what could not be computed, and why."""
    regularity: dict[str, Regularity]
    check: CollapseCheck
    sentences: tuple[str, ...]
    """One sentence for each comparison."""
    conclusion: str
    settling: dict[str, list[Settling]]
    next_depth: NextDepth
    next_depth_errors: dict[str, np.ndarray]
    response: Response
    series: ThetaSeries


def _contact(record: Record, mechanics: Mechanics) -> Interaction:
    """The record's contact, to be simulated again."""
    return Interaction(record["mesh"], record["load"], record["observation"], mechanics.time_step)


def count_contacts(records: Sequence[Record]) -> int:
    """How many different motions were observed; the frames of one contact may share theirs."""
    observed = (
        (str(record["clip"]), record["observation"].times.tobytes(), record["observation"].displacement.tobytes())
        for record in records
    )
    return len(set(observed))


def _column(records: Sequence[Record], name: str) -> np.ndarray:
    return np.array([record[name] for record in records], dtype=float)


def _finite_summary(values: np.ndarray, clips: np.ndarray) -> Summary:
    finite = np.isfinite(values)
    return summarise(values[finite], clips[finite])


def _regularity(
    trajectories: np.ndarray, theta: np.ndarray, contacts: Sequence[Interaction], mechanics: Mechanics
) -> Regularity:
    """Count what can't be believed."""
    distance = np.linalg.norm(trajectories.astype(float), axis=2)
    finite = np.isfinite(distance).all(axis=1)
    count = min(REGULARITY_CONTACTS, len(contacts))
    chosen = np.unique(np.linspace(0, len(contacts) - 1, count).round().astype(int))
    gain = amplification(theta[chosen], [contacts[i] for i in chosen], mechanics)
    chaotic = int(np.count_nonzero(gain > CHAOTIC_AMPLIFICATION))
    return Regularity(
        frames=len(distance),
        not_finite=int(np.count_nonzero(~finite)),
        leaves_scene=int(np.count_nonzero(distance[finite].max(axis=1, initial=0.0) > SCENE_SIZE)),
        checked=len(chosen),
        chaotic=chaotic,
    )


def analyse_next_depth(decoder: np.ndarray, copy: np.ndarray, sensitivity: np.ndarray, clips: np.ndarray) -> NextDepth:
    """Compare the decoder's next depth with the last frame, and say whether θ reaches the picture; all shape [n]."""
    comparison = compare(decoder, copy, clips)
    summary, change = _finite_summary(sensitivity, clips), _finite_summary(copy, clips)
    share = summary.mean / change.mean if summary.mean is not None and change.mean else None
    first = describe(comparison, "The decoder's next depth map", "repeating the last frame")
    if judge(comparison) == "better":
        first += " The picture carries motion."
    elif judge(comparison) != "untested":
        first += " The picture carries no motion that repeating the last frame would not."
    if share is None:
        second = "The decoder's sensitivity to θ has nothing to be compared with: the scene does not change."
    else:
        reach = "θ reaches the picture" if share >= CONDITION_SHARE else "θ hardly reaches the picture"
        second = (
            f"Moving θ to the farthest corner of the admissible box changes the decoded depth by {summary.mean:.3g} "
            f"scene units, {100 * share:.3g} % of the change between frames: {reach}."
        )
        own = _finite_summary(decoder, clips).mean
        if summary.mean and own is not None and own > 2 * summary.mean:
            second += f" The decoder's own error is {own / summary.mean:,.0f} times that."
    return NextDepth(_finite_summary(decoder, clips), change, summary, comparison, share, (first, second))


def _errors_and_baselines(
    records: Sequence[Record], contacts: Sequence[Interaction], training: Sequence[Interaction], mechanics: Mechanics,
    bounds: Bounds, settings: ConstantThetaSettings,
) -> tuple[dict[str, np.ndarray], ConstantTheta | None]:  # fmt: skip
    """Errors by regime, and the fitted constant."""
    errors = {REFERENCE: _column(records, "error_reference"), PREDICTED: _column(records, "error_predicted")}
    constant = fit_constant_theta(training, bounds, mechanics, settings)
    if constant is not None:
        errors[CONSTANT] = simulate_contacts(np.array(constant.theta), contacts, mechanics, settings.batch_size)[1]
    mean = np.mean([record["theta"] for record in records], axis=0)
    errors[MEAN] = simulate_contacts(mean, contacts, mechanics, settings.batch_size)[1]
    errors[NO_MOTION] = np.array([no_motion_error(record["observation"]) for record in records])
    return errors, constant


def analyse(
    records: Sequence[Record],
    training: Sequence[Interaction],
    mechanics: Mechanics,
    bounds: Bounds,
    settings: ConstantThetaSettings | None = None,
) -> Evaluation:
    """Compute every number of the evaluation; see `evaluation.paper.report.write_evaluation` for the arguments.

    Raises:
        ValueError: there are no records.
    """
    if not records:
        raise ValueError(
            "no test pair is in contact, so there is nothing to evaluate; check the split and the counts by status "
            "that the data preparation prints."
        )
    settings = settings or ConstantThetaSettings()
    records = sorted(records, key=lambda record: (str(record["clip"]), int(record["frame"])))
    clips = np.array([str(record["clip"]) for record in records])
    theta = np.array([record["theta"] for record in records], dtype=float)
    trajectories = {
        REFERENCE: np.array([record["reference_trajectory"] for record in records]),
        PREDICTED: np.array([record["trajectory"] for record in records]),
    }
    load_steps = [round(float(record["load"].factor.sum())) for record in records]
    again = [_contact(record, mechanics) for record in records]
    errors, constant = _errors_and_baselines(records, again, training, mechanics, bounds, settings)
    missing = [] if constant is not None else ["No constant θ was fitted: there are no training contacts."]
    baselines = [name for name in (REFERENCE, CONSTANT, MEAN, NO_MOTION) if name in errors]
    comparisons = {name: compare(errors[PREDICTED], errors[name], clips) for name in baselines}
    check = check_collapse(theta, clips, bounds)
    contacts = count_contacts(records)
    if contacts < len(records):
        missing.append(
            f"The {len(records)} test frames share {contacts} observed motion{'' if contacts == 1 else 's'} of a "
            "contact: p-values and intervals over frames overstate what they prove."
        )
    depth_errors = {name: _column(records, name) for name in ("next_depth_error", "copy_error", "theta_sensitivity")}
    thetas = {REFERENCE: reference_theta(theta), PREDICTED: theta}
    frames = np.array([int(record["frame"]) for record in records])
    return Evaluation(
        clips=clips,
        frames=frames,
        contacts=contacts,
        theta=theta,
        errors=errors,
        summaries={name: _finite_summary(values, clips) for name, values in errors.items()},
        comparisons=comparisons,
        constant=constant,
        missing=tuple(missing),
        regularity={name: _regularity(trajectories[name], thetas[name], again, mechanics) for name in trajectories},
        check=check,
        sentences=tuple(describe(value, "The predicted θ", PHRASES[name]) for name, value in comparisons.items()),
        conclusion=conclude(check, comparisons.get(CONSTANT), comparisons[REFERENCE], contacts),
        settling={
            name: [settle(one, steps, mechanics) for one, steps in zip(values, load_steps, strict=True)]
            for name, values in trajectories.items()
        },
        next_depth=analyse_next_depth(*depth_errors.values(), clips),
        next_depth_errors=depth_errors,
        response=response(trajectories[PREDICTED], load_steps, mechanics),
        series=theta_series(theta, clips.tolist(), frames.tolist(), bounds),
    )
