"""The online estimator (Liang 2024): a field of stiffness of tissue that an instrument drives, frame by frame.

A run of contact begins a sheet or a volume of particles at rest, its end ends it. How the instrument moves the tissue
is taken from what is followed next to it, or from a file; all other tissue is simulated, mapped to what the frame
shows, and its stiffness changed by one step. θ, a force and a unit are not determined: displacements don't determine
them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from palpate.common.options import option
from palpate.common.robust import affine_motion
from palpate.common.settings import LARGEST, Checked
from palpate.data.contact.tissue_points import grid_to_picture
from palpate.data.prepared import PreparedFrame
from palpate.data.tracks.background import without_background
from palpate.data.tracks.following import PointFollower
from palpate.estimators.contract import SMOOTHING, ClipInfo, Estimator, Output
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.online.driven import DrivenTissue
from palpate.estimators.online.particle_field import FieldResult, ParticleField, StiffnessMap
from palpate.estimators.online.settings import OnlineSettings, load_settings
from palpate.estimators.online.surface import make_surface
from palpate.estimators.records import InteractionEstimate
from palpate.estimators.run_tracker import Run
from palpate.estimators.runs import RunSession, frame_estimate
from palpate.physics.mechanics import Mechanics


@dataclass(frozen=True)
class OnlineOptions(Checked):
    """Stiffness place by place, relative, of tissue that an instrument drives, frame by frame."""

    settings: Path | None = option(None, metavar="FILE")
    """YAML file (default: as configs/online.yaml, which explains them)"""
    smoothing: Annotated[float, 0, LARGEST] = option(SMOOTHING, metavar="PIXELS")
    """smooth the tissue's resting shape over this many grid pixels"""

    def build(self) -> "OnlineEstimator":
        """Open the estimator.

        Raises:
            InputError: the file can't be used.
        """
        settings = OnlineSettings() if self.settings is None else load_settings(Path(self.settings))
        return OnlineEstimator(settings, self.smoothing)


class OnlineEstimator(Estimator):
    """Estimator that follows tissue driven by an instrument; needs no network and no onset.

    Args:
        settings: how.
        smoothing: width over which the tissue's resting shape is smoothed [grid px].
    """

    name = "online"
    live = tells_field = True
    tells_theta = False

    def __init__(self, settings: OnlineSettings, smoothing: float = SMOOTHING) -> None:
        self.settings, self.smoothing = settings, smoothing

    def start(self, clip: ClipInfo) -> "OnlineSession":
        """Open a session."""
        return OnlineSession(self, clip)


class _Followed:
    """One run's tissue with the points that are followed on it; begins in a frame with picture and labels.

    Raises:
        NoEstimate: no sheet can be made of it.
    """

    def __init__(self, first: PreparedFrame, clip: ClipInfo, estimator: OnlineEstimator) -> None:
        if not first.visible:
            raise NoEstimate(f"Frame {first.frame.number} has no picture with masks to begin with.")
        settings = estimator.settings
        self._number, self._clip, self._settings = first.frame.number, clip, settings
        surface = make_surface(first, clip.camera, clip.geometry, settings.particles, settings.thickness)
        self._follower = PointFollower(first.shown)
        follower = self._follower
        self._driven = DrivenTissue(surface, follower.points, follower.distance, settings, follower.spacing)
        self._background = np.zeros_like(surface.pixels)
        self._gap: float | None = None
        self._times = [first.frame.time_s]

    def step(self, frame: PreparedFrame) -> None:
        """Follow the tissue into a frame, and take it in."""
        follower = self._follower
        follower.step(frame.shown)
        moved = follower.moved
        still = without_background(follower.points, moved, follower.distance)
        motion, places = moved - still, self._driven.surface.pixels
        known = np.asarray(np.isfinite(motion).all(axis=1))
        self._background = np.zeros_like(places)
        if known.any():
            self._background = affine_motion(follower.points, motion, known, places)
        self._gap = self._driven.step(still).gap
        self._times.append(frame.frame.time_s)

    @property
    def fitted(self) -> str:
        """Sentence on the parameters that were fitted to the first frames; empty if nothing was fitted."""
        fit = self._driven.fit
        if fit is None:
            return ""
        text = f"Fitted to the first frames: steps of {fit.time_step:g}, foundation {fit.foundation:g} and bending"
        return f"{text} {fit.bending:g} of the stiffness against stretch, which leave {fit.error:.0%} of their motion."

    def estimate(self) -> FieldResult:
        """Return the result of the run so far."""
        driven = self._driven
        course, times = np.array(driven.alone.course), np.array(self._times) - self._times[0]
        skills = driven.skills() if len(times) > 2 else {}
        return FieldResult(self.field(), times, course, bool(driven.stretched.any()), driven, skills)

    def field(self) -> ParticleField:
        """Return the field as it is now."""
        surface, session = self._driven.surface, self._driven.session
        size = surface.camera.height, surface.camera.width
        pixels = grid_to_picture(surface.project(session.positions) + self._background, size, self._clip.size)
        tissue = surface.body.rest, surface.faces, surface.body.tetrahedra, session.positions, pixels
        maps = map(StiffnessMap, session.fields[:2], *self._driven.determined())
        return ParticleField(self._number, *tissue, *maps, self._driven.alone.skill, self._gap)


class OnlineSession(RunSession):
    """One clip: a field for every frame in contact, and a sentence for every run."""

    def __init__(self, estimator: OnlineEstimator, clip: ClipInfo) -> None:
        super().__init__(clip, Mechanics())
        self._estimator = estimator
        self._driven: _Followed | None = None
        self._reason, self._begun = "", -1

    def push(self, frame: PreparedFrame) -> Iterator[Output]:
        """Take the next frame."""
        yield from self._ended(self._runs.push(frame))
        with self.seconds.timed("online"):
            field = self._field(frame)
        doubts = "" if field is not None or not frame.in_contact else self._reason
        verdict = "" if not frame.in_contact else "undetermined" if field is None else field.verdict
        yield replace(frame_estimate(frame, self.clip, verdict=verdict, doubts=doubts, whole=True), field=field)

    def _field(self, frame: PreparedFrame) -> ParticleField | None:
        """Return stiffness in a frame of the run under way; None where there is none, or the frame shows nothing."""
        run = self._runs.current
        if run is None:
            self._driven, self._begun = None, -1
            return None
        if run.index != self._begun:
            self._begun, self._driven, self._reason = run.index, None, ""
            try:
                self._driven = _Followed(frame, self.clip, self._estimator)
            except NoEstimate as reason:
                self._reason = str(reason)
        elif self._driven is not None and frame.frame.index - run.last <= self.clip.bridge_frames:
            if not frame.visible:
                return None
            self._driven.step(frame)
        else:
            return None
        return None if self._driven is None else self._driven.field()

    def _pressed(self, run: Run) -> InteractionEstimate:
        """Return the record of a run, with a sentence on its field."""
        contact = None if run.builder is None else run.builder.build(self.mechanics, self.horizon)
        if contact is not None and len(contact.observation) == 0:
            contact = None
        reason, found = self._reason, None
        if self._driven is not None:
            found = self._driven.estimate()
            undriven = "Not enough tissue moved with the instrument to tell its stiffness anywhere."
            reason = " ".join(filter(None, (found.explanation or undriven, self._driven.fitted)))
        alone = "Relative stiffness place by place (fields.npz) is told; no k_s, k_d or F."
        detail = " ".join(filter(None, (run.detail, reason, alone)))
        return run.estimate(interaction=contact, field=found, detail=detail)
