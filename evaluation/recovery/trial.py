"""One synthetic clip against its truth: made in memory, observed as each suite says, estimated as users estimate.

A trial is one clip in all wanted suites, because the true motion costs most and is the same in most of them. Its result
is a row a suite and estimator; what doesn't exist is left out. θ = [k_s, k_d, F], lengths in scene units:

suite, index, estimator, seed   the clip, and who was asked
action, regime                  `press` or `grip`; of a press on a sheet, how it is damped
status, reason                  `ok`, or why there is no estimate: its draw failed (`no scene`), no run of contact was
                                found (`no contact`), one was found but in another frame (`other onset`), the estimator
                                declined (`no estimate`), or something broke (`error`)
seconds                         time that the estimate took
verdict, warned                 as estimated; whether the estimate says that its model doesn't explain the motion, or
                                that a dent may hide its bottom

of a press on a sheet, and without the truth's on a slab:

theta, estimate, covariance     true and estimated θ, shape [3], and the estimated covariance of log θ, shape [3, 3]
information                     Fisher information of log θ and both delays from the contact's motion for σ = 1
                                (`evaluation.recovery.bounds`), shape [5, 5]
field_information               the same from the sequence of its dent with the sequence's noise
tracking                        tracked minus true displacement along the true direction, shape [M]
onset_off, release_off          frames from the true onset, or release, to the one that was found
place_off                       how far the contact was found from the true one [grid px]
noise, misfit, at_bound         σ that the estimator believed in; its misfit; whether θ lies at its range's end, [3]

of a grip on a sheet:

contact_right                   share of the frames in which something moves whose contact is the true one
skill                           as estimated
foundation, force               log of foundation, and of the force in the last frame, over stiffness: true, estimated,
                                its standard deviation and bound, shape [4]
curve                           force over that of the last frame: true, estimated, its standard deviation, shape [3, T]
following                       error of a followed point by axis in the last frame, root mean square [px]
rank, rank_most                 rank correlation of the stiffness field with the true one where tissue moves; of regions
                                that are separated exactly, in any order within each: √(3p(1 - p)), p the share of one
held, knots, held_between       share of the field's knots there whose 90 % interval holds the truth; how many they are;
                                the same share of all followed points there (bilinear between knots, a step is none)

of a slab of finite elements:

tissue                          true numbers in the order of `data.synthetic.slab.SlabTissue`, shape [8]
true_force                      size of the true force: of a press, or of the pull in the last frame that was fitted
fitted                          what was fitted, one of `estimators.open.MODELS`; of finite elements θ = [E, αρ, F]
reaction                        of a pull: F/k_s, of finite elements F/E, and the standard deviation of its logarithm
curve                           as of a grip
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import KDTree
from scipy.stats import spearmanr

from palpate.common.doors import interruptible
from palpate.data.contact.interaction import Horizon, Interaction
from palpate.data.labels import TOOL
from palpate.data.prepared import PreparedFrame
from palpate.data.synthetic.clip import draw_truth, synthetic_clip
from palpate.data.synthetic.grip import GrippedMotion
from palpate.data.synthetic.scene import Scene, SceneError
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.slab import GrippedSlab, PressedSlab, SlabMotion
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.data.synthetic.truth import PressedMotion
from palpate.data.tracks.following import SPACING, PointFollower
from palpate.estimators.contract import ClipInfo
from palpate.estimators.estimate import NINETY, Estimate, FrameEstimate, GripEstimate, InteractionEstimate
from palpate.estimators.grip.stiffness_field import StiffnessField
from palpate.estimators.oblique import is_oblique
from palpate.estimators.open import FEM, EstimatorOptions
from palpate.estimators.runs import RunTracker
from palpate.estimators.session import estimates_of
from palpate.evaluation.harness import OK, Row, attempted
from palpate.evaluation.recovery.bounds import MECHANICS, contact_information, field_information
from palpate.evaluation.recovery.estimators import Candidate, opened
from palpate.evaluation.recovery.grip_bound import grip_bound, measure_following
from palpate.evaluation.recovery.suites import EVERY, GRID_SIZE

MOTION = "motion"
"""How contacts are found where no tool is in view: by their dents."""
STIRRED = 1.0
"""Tool or tissue moves where either has gone so far since the frame before [px]."""
MOVED = 5.0
"""A stiffness field is judged where tissue moves by more than this [px]."""

Compare = Callable[[Any], Row]
"""From what a session says of a clip, or a constant, to what is known then."""


@dataclass(frozen=True)
class Trial:
    """What one worker does in one go."""

    index: int
    seed: int
    """Seed of the clip."""
    wanted: Mapping[str, Mapping[str, Candidate]]
    """Suites, each with the estimators that are to be tried, by name; those without any are left out."""
    seen: Horizon = None
    """Frames after the onset that estimators and bound observe; None = one second."""
    size: tuple[int, int] = GRID_SIZE
    """Width and height of pictures of presses on a sheet [px]."""
    contact: Literal["touching", "motion"] = "touching"
    """How contacts are found; with motion clips are drawn without the tool, and an onset one frame off counts."""


@dataclass(frozen=True, eq=False)
class TrueClip:
    """A clip as estimators observe it, and its truth."""

    scene: Scene
    motion: PressedMotion | GrippedMotion | SlabMotion
    frames: list[PreparedFrame]
    info: ClipInfo


def run_trial(trial: Trial) -> list[Row]:
    """Rows of one clip for every wanted suite and estimator; what goes wrong becomes a row that says so."""
    wanted = [(suite, candidates) for suite, candidates in trial.wanted.items() if candidates]
    return [row for suite, candidates in wanted for row in _suite_rows(trial, suite, candidates)]


@functools.lru_cache(maxsize=1)
def _truth(settings: SceneSettings, seed: int) -> tuple[Scene, PressedMotion | GrippedMotion | SlabMotion]:
    """Drawn once for all suites that only observe otherwise; these follow each other."""
    return draw_truth(settings, seed)


def _suite_rows(trial: Trial, suite: str, candidates: Mapping[str, Candidate]) -> list[Row]:
    settings = EVERY[suite].settings(trial.index, trial.size)
    known: Row = {"suite": suite, "index": trial.index, "seed": trial.seed, "action": settings.action}
    if EVERY[suite].of == "press":
        known["regime"] = settings.regime

    def failed(status: str, reason: str) -> list[Row]:
        return [known | {"estimator": name, "status": status, "reason": reason} for name in candidates]

    try:
        scene, motion = _truth(EVERY[suite].truth_settings(trial.index, trial.size), trial.seed)
    except SceneError as error:
        return failed("no scene", str(error))
    scene = dataclasses.replace(scene, settings=dataclasses.replace(settings, tool_in_view=trial.contact != MOTION))
    prepare = dataclasses.replace(PREPARE, geometry=dataclasses.replace(PREPARE.geometry, contact=trial.contact))
    if isinstance(motion, PressedMotion):
        known["theta"] = motion.theta
    try:
        with interruptible():
            prepared = open_synthetic(synthetic_clip(scene, motion, trial.seed), prepare)
            clip = TrueClip(scene, motion, list(prepared), ClipInfo.of(prepared))
            found, compare = _judged(trial, clip)
    except Exception as error:  # a clip that breaks the preparation is a result, and the others go on
        return failed("error", f"{type(error).__name__}: {error}")
    known |= found
    if compare is None:
        return failed(known["status"], known["reason"])
    rows = []
    for name, candidate in candidates.items():
        named = known | {"estimator": name}
        if isinstance(motion, SlabMotion) and isinstance(candidate, EstimatorOptions) and candidate.model == Path(FEM):
            candidate = dataclasses.replace(candidate, thickness=motion.tissue.thickness)
            named["fitted"] = FEM
        rows.append(named | estimated(candidate, clip, compare))
    return rows


def _judged(trial: Trial, clip: TrueClip) -> tuple[Row, Compare | None]:
    """What holds for all estimators, and what makes a row of an answer; None where nothing can be compared."""
    motion = clip.motion
    if isinstance(motion, GrippedMotion):
        return {}, functools.partial(_gripped, clip, motion)
    if isinstance(motion, SlabMotion):
        known: Row = {"tissue": np.array(dataclasses.astuple(motion.tissue))}
        if isinstance(motion, PressedSlab):
            force = float(np.abs(motion.force).max())
            return known | {"true_force": force}, functools.partial(_pressed, motion.onset_frame)
        if isinstance(motion, GrippedSlab):
            return known, functools.partial(_pulled, clip, motion)
    if not isinstance(motion, PressedMotion):
        raise TypeError(f"{type(motion).__name__} is no motion of a suite.")
    contacts = observed_contacts(clip.frames, clip.info, trial.seen)
    if not contacts:
        return {"status": "no contact", "reason": "no onset of contact was found."}, None
    onset = min(contacts, key=lambda found: abs(found - motion.onset_frame))
    if abs(onset - motion.onset_frame) > (trial.contact == MOTION):
        begun = ", ".join(map(str, contacts))
        return {
            "status": "other onset",
            "reason": f"contact began in frame {begun} instead of {motion.onset_frame}.",
        }, None
    contact, scene = contacts[onset], clip.scene
    known = _off(contact, clip.frames[onset], scene, motion)
    motion = as_stamped(motion, onset)
    known["tracking"] = tracking_errors(contact, scene, motion)
    known["information"] = contact_information(contact, scene, motion)
    known["field_information"] = field_information(contact, scene, motion)
    return known, functools.partial(_pressed, onset)


def estimated(candidate: Candidate, clip: TrueClip, compare: Compare) -> Row:
    """What becomes of an estimator's answer, or why there is none."""
    start = time.perf_counter()

    def answered() -> Row:
        answer = candidate if isinstance(candidate, Estimate) else answers(candidate, clip.frames, clip.info)
        seconds = time.perf_counter() - start
        return {"status": OK, "seconds": seconds, **compare(answer)}

    return attempted(answered)  # an estimator that breaks on a clip is a result, and the others go on


def answers(
    candidate: EstimatorOptions, frames: Sequence[PreparedFrame], clip: ClipInfo
) -> list[FrameEstimate | InteractionEstimate]:
    """Everything that the session that users run says of a clip."""
    session = opened(candidate).start(clip)
    return list(estimates_of(session, frames))


def _pressed(onset: int, answer: Estimate | list) -> Row:
    """What is estimated of the press whose contact begins in a frame."""
    found = answer
    if not isinstance(found, Estimate):
        runs = [item for item in found if isinstance(item, InteractionEstimate)]
        run = next((item for item in runs if item.onset == onset), None)
        if run is None or run.estimate is None:
            return {"status": "no estimate", "reason": "it doesn't see this contact." if run is None else run.detail}
        found = run.estimate
    if not np.isfinite(found.theta).all():
        return {"status": "no estimate", "reason": "its θ is not finite."}
    return {
        "estimate": np.asarray(found.theta, np.float64),
        "covariance": found.covariance,
        "verdict": "" if found.told_verdict else found.verdict,
        "noise": found.noise,
        "misfit": found.misfit,
        "at_bound": found.at_bound,
        "warned": None if found.told_verdict else not found.explained or is_oblique(found),
    }


def _off(contact: Interaction, onset: PreparedFrame, scene: Scene, motion: PressedMotion) -> Row:
    """How far a contact was found from the true one."""
    seconds = (motion.release_frame - onset.frame.index) / scene.settings.fps
    released = contact.load_seconds - seconds if contact.released else math.nan
    place = contact.mesh.pixels[contact.vertex] - scene.mesh.pixels[scene.vertex]
    return {
        "onset_off": float(onset.frame.index - motion.onset_frame),
        "release_off": round(released * scene.settings.fps, 2),
        "place_off": float(np.linalg.norm(place)),
    }


def as_stamped(motion: PressedMotion, onset: int) -> PressedMotion:
    """The same motion with its delay counted from another frame that is taken for the onset."""
    interval = motion.times[1] - motion.times[0]
    delay = motion.delay - (onset - motion.onset_frame) * interval
    return dataclasses.replace(motion, onset_frame=onset, delay=delay)


def observed_contacts(frames: Sequence[PreparedFrame], clip: ClipInfo, seen: Horizon = None) -> dict[int, Interaction]:
    """Every run of contact whose onset was observed and whose tissue was followed, by the frame of its onset.

    Args:
        frames: of the whole clip.
        seen: how much of each counts.
    """
    runs = RunTracker(clip, MECHANICS.seconds)
    ended = [*(runs.push(frame) for frame in frames), runs.finish()]
    found = {
        run.index: run.builder.build(MECHANICS, seen) for run in ended if run is not None and run.builder is not None
    }
    return {onset: contact for onset, contact in found.items() if len(contact.observation)}


def tracking_errors(contact: Interaction, scene: Scene, motion: PressedMotion) -> np.ndarray:
    """Errors of a tracked contact along the true direction, shape [M] [scene units].

    Args:
        contact: as observed; it must begin in the true onset's frame.
    """
    frames = motion.onset_frame + np.rint(contact.observation.times * scene.settings.fps).astype(int)
    return (contact.moved - motion.contact[frames]) @ scene.direction


def _gripped(clip: TrueClip, motion: GrippedMotion, answer: list) -> Row:
    """What is estimated of a grip."""
    contact = np.array([item.contact is True for item in answer if isinstance(item, FrameEstimate)])
    moves = moving_frames(clip.scene, motion)
    found: Row = {"contact_right": float((contact == motion.in_contact)[moves].mean()) if moves.any() else math.nan}
    gripped = _grip_of(answer)
    if isinstance(gripped, dict):
        return found | gripped
    run, grip = gripped
    found |= {"verdict": run.verdict, "skill": grip.skill}
    if run.onset < motion.onset_frame:
        return found
    return found | _grip_against_truth(run.onset, grip, clip.scene, motion, clip.frames)


def _grip_of(answer: list) -> tuple[InteractionEstimate, GripEstimate] | Row:
    """The first run of contact that has an estimate as a grip, with that, or a row that says why there is none."""
    runs = [item for item in answer if isinstance(item, InteractionEstimate)]
    missing: Row = {"status": "no estimate", "reason": " ".join(item.detail for item in runs)}
    return next(((item, item.grip) for item in runs if item.grip is not None), missing)


def moving_frames(scene: Scene, motion: GrippedMotion) -> np.ndarray:
    """Frames in which the tool or the tissue it holds moves, shape [F], bool: in others nothing shows contact."""
    camera, vertex = scene.camera, scene.mesh.vertices[scene.vertex]
    held = vertex[:2] + motion.contact[:, :2]
    place = held / (vertex[2] + motion.contact[:, 2:]) * [camera.fx, camera.fy]
    tip = place + motion.course * scene.settings.cell
    steps = np.maximum(*(np.linalg.norm(np.diff(way, axis=0), axis=1) for way in (place, tip)))
    return np.append(False, steps > STIRRED)


def _grip_against_truth(
    onset: int, grip: GripEstimate, scene: Scene, motion: GrippedMotion, frames: Sequence[PreparedFrame]
) -> Row:
    """Truth, estimate and bound of a run of contact that begins in a frame."""
    cell = np.array(scene.settings.cell)
    used = onset + np.rint(grip.times * scene.settings.fps).astype(int)
    follower, moved, noise = _followed(frames[onset : used[-1] + 1])
    points = follower.points.astype(np.float64)
    true_moved = np.array([picture_motion(scene, motion, index, points) for index in (onset, *used)])
    true = true_moved[1:] - true_moved[0]
    error = moved[used - onset - 1] - true
    visible = np.isfinite(error[-1]).all(axis=1)
    size = float(np.sqrt(np.square(error[-1, visible]).mean()))
    places = points[visible], follower.distance[visible]
    followed = measure_following(*places, SPACING, noise[visible], error[:, visible])
    log_anchor = math.log(motion.anchor * SPACING**2 / cell.prod())
    bound = grip_bound(*places, follower.hidden, SPACING, true[:, visible], followed, log_anchor)
    force = motion.reaction[used] / scene.spacing * cell
    unit = force[-1] / (force[-1] @ force[-1])
    found: Row = {
        "foundation": np.array([log_anchor, *log_of(grip, "foundation_over_stiffness"), bound.foundation]),
        "force": np.array([math.log(np.linalg.norm(force[-1])), *log_of(grip, "reaction_over_stiffness"), bound.force]),
        "curve": np.array([force @ unit, grip.force, grip.force_sd]),
        "following": size,
    }
    if scene.settings.regions > 1 and grip.stiffness is not None:
        found |= _field(grip.stiffness, points, true[-1], scene, motion)
    return found


def log_of(grip: GripEstimate, name: str) -> tuple[float, float]:
    """Logarithm of a quantity of a grip and its standard deviation, by the ends of its 90 % interval."""
    value, low, high = (getattr(grip, name + end) for end in ("", "_low", "_high"))
    return math.log(value), math.log(high / low) / (2 * NINETY)


def picture_motion(scene: Scene, motion: GrippedMotion, frame: int, points: np.ndarray) -> np.ndarray:
    """True displacement in the picture of tissue points [N, 2] (column, row at rest) in a frame, shape [N, 2] [px]."""
    rest = scene.mesh.vertices.astype(np.float64)
    moved, camera = rest + motion.field[frame], scene.camera
    shift = [camera.fx, camera.fy] * (moved[:, :2] / moved[:, 2:] - rest[:, :2] / rest[:, 2:])
    grid = np.zeros((*scene.mesh.grid_shape, 2))
    grid[tuple(scene.mesh.pixels.T)] = shift
    place = (points[:, ::-1] + 0.5) / np.array(scene.settings.cell)[::-1] - 0.5
    return np.stack([map_coordinates(grid[..., axis], place.T, order=1, mode="nearest") for axis in (0, 1)], axis=1)


def _followed(frames: Sequence[PreparedFrame]) -> tuple[PointFollower, np.ndarray, np.ndarray]:
    """Points followed through frames as the estimator follows them.

    Returns:
        The follower, displacements since the first frame in those after it [F - 1, N, 2] and the stated noise of the
        last ones [N] [px].
    """
    first, *others = [(frame.view[0], frame.view[1] == TOOL) for frame in frames]
    follower, moved = PointFollower(*first), []
    for picture, tool in others:
        follower.step(picture, tool)
        moved.append(follower.moved)
    return follower, np.array(moved), follower.noise


def _field(
    found: StiffnessField, points: np.ndarray, true: np.ndarray, scene: Scene, motion: GrippedMotion
) -> dict[str, float]:
    """How a fitted stiffness field compares with the true one where tissue moves, at its knots and at points [N]."""
    moves = np.linalg.norm(true, axis=1) > MOVED
    apart, nearest = KDTree(points).query(found.knots)
    at_knots = found.knots[moves[nearest] & (apart < SPACING)]

    def off(places: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        log, sd = found.at(places)
        truth, middle = _true_log(places, scene, motion), _true_log(found.moving, scene, motion).mean()
        held = np.abs(log - truth + middle) < NINETY * sd
        return log, truth, float(held.mean()) if len(places) else math.nan

    log, truth, held_between = off(points[moves])
    stiffer = float((truth > (motion.log_stiffness.max() + motion.log_stiffness.min()) / 2).mean())
    return {
        "rank": float(spearmanr(log, truth).statistic),
        "rank_most": math.sqrt(3 * stiffer * (1 - stiffer)),
        "held": off(at_knots)[2],
        "held_between": held_between,
        "knots": len(at_knots),
    }


def _true_log(places: np.ndarray, scene: Scene, motion: GrippedMotion) -> np.ndarray:
    """True log stiffness at places [N, 2] (column, row) [px], shape [N]."""
    cells = (places[:, ::-1] + 0.5) / np.array(scene.settings.cell)[::-1] - 0.5
    return map_coordinates(motion.log_stiffness, cells.T, order=1, mode="nearest")


def _pulled(clip: TrueClip, motion: GrippedSlab, answer: list) -> Row:
    """What is estimated of a pull on a slab."""
    gripped = _grip_of(answer)
    if isinstance(gripped, dict):
        return gripped
    run, grip = gripped
    return _pull_against_truth(run.onset, grip, motion, clip.scene)


def _pull_against_truth(onset: int, grip: GripEstimate, motion: GrippedSlab, scene: Scene) -> Row:
    """What is estimated of a pull that was observed from a frame on, compared with the truth."""
    used = onset + np.rint(grip.times * scene.settings.fps).astype(int)
    true = motion.reaction[used]
    size = float(np.linalg.norm(true[-1]))
    sheet = math.isnan(grip.reaction_over_young)
    unit = scene.spacing / scene.settings.cell[0] if sheet else 1.0
    log, sd = log_of(grip, "reaction_over_stiffness" if sheet else "reaction_over_young")
    return {
        "true_force": size,
        "reaction": np.array([math.exp(log) * unit, sd]),
        "curve": np.array([true @ true[-1] / size**2, grip.force, grip.force_sd]),
        "verdict": grip.verdict,
        "warned": not grip.explained,
    }
