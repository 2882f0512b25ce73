"""The tables of a clip: their columns, each with what it is, and their rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from palpate.estimators.estimate import LEAST_SKILL, NINETY, REPORTED, SYMBOLS
from palpate.estimators.grip.grip_estimate import GripEstimate
from palpate.estimators.known_force import KnownForce, predict_force
from palpate.estimators.online.particle_field import FieldEstimate
from palpate.estimators.records import InteractionEstimate
from palpate.physics.mechanics import PARAMETERS

ESTIMATED = {
    column: text.format(SYMBOLS[name])
    for name in REPORTED
    for column, text in (
        (name, "{}"),
        (f"{name}_sd", "standard deviation of {}; empty: the estimator gives none"),
        (f"{name}_low", "lower end of the 90 % interval of {}"),
        (f"{name}_high", "upper end of the 90 % interval of {}"),
    )
} | {
    f"{name}_bound": f"Cramér–Rao bound on the sd of log {SYMBOLS[name]} (0.1: 10 %), were the onset known"
    for name in PARAMETERS
}
"""Columns of an estimate; k_d/k_s is in s and |F|/k_s in scene units; of `--model fem`, where k_s is Young's modulus,
in s/scene unit² and scene unit²."""
UNITS = {
    "stiffness": "scene units (normalised), not N/m",
    "damping": "scene units (normalised), not N·s/m",
    "force": "scene units (normalised), not N",
    "displacement": "scene units: depth divided by the clip's one fixed scale",
    "time": "s",
    "distance_stiffness": "relative: a particle's mass over the square of a frame's time, not N/m; compares places "
    "within a run of contact, not clips",
    "shape_stiffness": "likewise, not comparable with distance_stiffness",
    "gap": "scene units",
}
"""Units of the results; nothing that estimates knows of others."""
VERDICT = {
    "verdict": "determined, ratios (only k_s/k_d and F/k_d), reaction (only that over E, of a pull), "
    "foundation (only that over stiffness, and relative forces), relative_force (only that), stiffness_ratios (only "
    "where tissue is stiffer, of --estimator online), undetermined; onset_in_view: the model doesn't tell",
    "determined": "which parameters and ratios are determined, joined by ; (in fit.png: the curve of "
    "relative_force, the map of stiffness_ratios)",
}
GRIP = {
    "foundation_over_stiffness": "of a node over a spring's, nodes 8 px apart in a picture at most 854 px wide; empty "
    "unless determined",
    "foundation_over_stiffness_low": "lower end of its 90 % interval",
    "foundation_over_stiffness_high": "upper end of its 90 % interval",
    "reaction_over_stiffness": "what holds the tissue in the last frame over a spring's stiffness, px of such a "
    "picture; times depth over focal length it is F/k_s",
    "reaction_over_stiffness_low": "lower end of its 90 % interval",
    "reaction_over_stiffness_high": "upper end of its 90 % interval",
    "reaction_over_young": "what holds the tissue in the last frame over E, scene units²; empty unless "
    "determined, which takes --model fem",
    "reaction_over_young_low": "lower end of its 90 % interval",
    "reaction_over_young_high": "upper end of its 90 % interval",
    "skill": "of that sheet in frames that were not fitted: 1 - error / motion; unless foundation, detail says it; of "
    "--estimator online as in parameters.csv, of all frames",
}
"""Columns of what the motion around an instrument tells, where nothing is determined by the contact's own."""
FIELD = {
    column: text
    for name, what in (("distance_stiffness", "stretch"), ("shape_stiffness", "bending"))
    for column, text in (
        (
            name,
            f"against {what}, the median over tissue where it is determined, {UNITS[name]}; all of it in fields.npz",
        ),
        (f"{name}_low", "its 10 % quantile over that tissue, not an interval"),
        (f"{name}_high", "its 90 % quantile over that tissue, not an interval"),
        (f"{name}_log_sd", "standard deviation of the log of stiffness over its mean, the median over that tissue"),
    )
} | {
    "field_known": "share of the particles whose stiffness against stretch is determined: surer than before anything "
    "was seen, the tissue there has stretched, and the fit explains the motion",
    "shape_known": "the same of stiffness against bending",
    "skill": "1 - error / motion so far of the tissue simulated under the instrument alone; below "
    f"{LEAST_SKILL:g} the fit does not explain the motion, and nothing is determined",
    "gap": "norm of the deformation by which the simulated particles missed what the frame shows, scene units",
}
"""Columns of a frame's field of stiffness; empty from estimators without one."""
FRAMES: dict[str, str] = {
    "frame": "number of the frame in its source",
    "time_s": "s",
    **ESTIMATED,
    "contact": "1 or 0; empty: undecided",
    "contact_probability": "that tissue next to the tool moves with it or sinks under it; below 0.5 it hovers; "
    "empty: no contact to judge",
    "contact_distance": "scene units",
    "contact_u": "px of the source frame, column",
    "contact_v": "px of the source frame, row",
    "simulated_displacement": "scene units",
    "observed_displacement": "scene units",
    **FIELD,
    "status": "ok, or why the frame has no parameters",
    **VERDICT,
    "detail": "sentences about the status, or about what can't be trusted",
}
"""Columns of `parameters.csv`, in order."""
INTERACTIONS: dict[str, str] = {
    "onset_frame": "number of the run's first frame in contact",
    "onset_time_s": "s",
    "frames": "frames after the onset in which its tissue was followed",
    "load_s": "s from the onset to the release; empty: the onset or the release was not seen",
    "delay_s": "s from the onset frame to the beginning of the press, as fitted; empty: taken to be 0, or no estimate",
    "release_delay_s": "s from the first frame after contact to the end of the press; empty: the same, or not seen",
    "press_radius": "R of the patch that is pressed, by 1 - (r/R)², as fitted, grid pixels; this and "
    "the next three empty: a step on one point along the normal explains the motion, or no estimate",
    "press_lean_deg": "angle between the force and the tissue's normal",
    "press_rise_s": "s in which the force rises to F",
    "press_fall_s": "s in which it falls from F to nothing; 0 where no release was seen",
    **ESTIMATED,
    **GRIP,
    **VERDICT,
    "explanation": "which products of k_s, k_d and F are determined, with their relative errors",
    "noise": "standard deviation of every observed coordinate, scene units",
    "misfit": "root mean square of observed minus simulated displacement along the force over the noise; 1: it fits",
    "outliers": "share of the observed pixels so far from the fit that they count less; empty: all count equally",
    "modes": "tissues far apart that explain the motion about as well; above 1 the intervals span them all",
    "at_bound": "parameters that lie at the end of their admissible range",
    "status": "ok or no_estimate",
    "detail": "sentence about the status, or about an estimate that can't be trusted",
}
"""Columns of `interactions.csv`, in order."""
FORCES: dict[str, str] = {
    "onset_frame": "number of the run's first frame in contact",
    "time_s": "s",
    "force_N": "predicted by the one factor between the known force and the relative force of the run",
    "force_N_low": "lower end of its 90 % interval",
    "force_N_high": "upper end of its 90 % interval",
    "known_N": "what --known-force gives there; empty where nothing",
}
"""Columns of `forces.csv`, in order; written with --known-force."""


def row(columns: Mapping[str, str], values: Mapping[str, Any]) -> list[str]:
    """The cells of one frame or one run of contact.

    Args:
        columns: FRAMES or INTERACTIONS.
        values: what is known, by column.
    """
    return [cell(values.get(name), decimals=6 if name.endswith("time_s") else None) for name in columns]


def interaction_values(run: InteractionEstimate) -> dict[str, Any]:
    """What is known of a run of contact, by column."""
    estimate, contact, output = run.estimate, run.interaction, run.main_estimate
    found = vars(run) | {"frames": 0 if contact is None else len(contact.observation), "status": "no_estimate"}
    if estimate is not None:
        stuck = [name for name, at_end in zip(PARAMETERS, estimate.at_bound, strict=True) if at_end]
        delays = dict(zip(("delay_s", "release_delay_s"), estimate.delays, strict=False))
        found |= vars(estimate) | estimate.numbers() | delays
        found |= {"explanation": estimate.explanation if output is estimate else "", "at_bound": " ".join(stuck)}
    if isinstance(output, GripEstimate):
        # The force over a spring's stiffness leans on the foundation.
        leaning = ("reaction_over_stiffness",) if "foundation_over_stiffness" in output.determined else ()
        known = [name for name in GRIP if name.startswith((*output.determined, *leaning, "skill"))]
        found |= {name: getattr(output, name) for name in known} | {"frames": len(output.times)}
    if isinstance(output, FieldEstimate):
        found |= {"skill": output.skill, "explanation": output.explanation, "frames": len(output.times)}
    if output is not None:
        found |= {"status": "ok", "verdict": output.verdict, "determined": ";".join(output.determined)}
    return found


def force_rows(run: InteractionEstimate, known: KnownForce) -> list[dict[str, Any]]:
    """The force of a run over time by column of FORCES; none where no relative force is determined.

    Raises:
        NoEstimate: the known force tells nothing of this run.
    """
    grip = run.main_estimate
    if not isinstance(grip, GripEstimate) or "relative_force" not in grip.determined:
        return []
    times = run.onset_time_s + grip.times
    curve = predict_force(known.at(times), grip.force, grip.force_sd)
    return [
        {
            "onset_frame": run.onset_frame,
            "time_s": float(time),
            "force_N": float(force),
            "force_N_low": float(force - NINETY * sd),
            "force_N_high": float(force + NINETY * sd),
            "known_N": float(measured),
        }
        for time, force, sd, measured in zip(times, curve.force, curve.sd, curve.known, strict=True)
    ]


def cell(value: float | int | bool | str | None, *, decimals: int | None = None) -> str:
    """A value as text: seven significant digits (float32's), or a fixed number of decimals, and text on one line."""
    if value is None or value != value:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, float):
        return f"{value:.7g}" if decimals is None else f"{value:.{decimals}f}"
    return " ".join(str(value).split())
