"""A synthetic clip as it is observed, frame by frame, and what truly happens."""

from dataclasses import dataclass, replace

import numpy as np

from palpate.data.contact.depth_sequence import window_around
from palpate.data.contact.interaction import Interaction, InteractionBuilder
from palpate.data.labels import TISSUE
from palpate.data.prepared import PreparedFrame
from palpate.data.synthetic.clip import draw_press, synthetic_clip
from palpate.data.synthetic.scene import Scene, SceneError
from palpate.data.synthetic.source import PREPARE, open_synthetic
from palpate.data.synthetic.truth import PressedMotion
from palpate.estimators.contract import ClipInfo
from palpate.estimators.runs import RunTracker
from palpate.evaluation.recovery.bounds import MECHANICS
from palpate.evaluation.recovery.suites import SUITES

FIRST = 2
"""Frames after the onset from which on a network says something."""


@dataclass(frozen=True)
class WatchedClip:
    """A clip of a suite whose contact was found where it is."""

    motion: PressedMotion
    info: ClipInfo
    frames: list[PreparedFrame]
    """As they are observed."""
    truth: list[PreparedFrame]
    """The same without noise, flicker and rounding of the depth."""
    run: InteractionBuilder
    """The contact, all its frames gathered."""
    contact: Interaction
    """The same as a whole."""

    def since(self, frame: int) -> float:
        """Time from the onset to a frame [s]."""
        return self.frames[frame].frame.time_s - self.run.start

    def instants(self, horizon: int) -> list[int]:
        """Frames under the tool whose picture so many frames later lies in the clip, and within the rollout."""
        frames = range(self.motion.onset_frame + FIRST, len(self.frames) - horizon)
        pressed = [now for now in frames if self.frames[now].in_contact]
        return [now for now in pressed if self.since(now + horizon) <= MECHANICS.seconds]

    def tissue(self, now: int, horizon: int) -> np.ndarray:
        """Where tissue near the contact is in view now and truly so many frames later, shape [h, w], bool."""
        here, then = self.frames[now], self.truth[now + horizon]
        near = np.zeros(here.depth.shape, bool)
        near[window_around(self.contact.mesh.pixels[self.contact.vertex])] = True
        return near & (here.labels == TISSUE) & (then.labels == TISSUE) & (here.depth > 0) & (then.depth > 0)


def watch(suite: str, index: int, seed: int) -> WatchedClip | None:
    """A clip of a suite; None where no scene can be drawn, or no contact is found in the frame of its onset.

    Args:
        suite: one of `evaluation.recovery.suites.SUITES`.
        index: of the clip, which decides its regime.
        seed: of the clip.
    """
    chosen = SUITES[suite]
    try:
        scene, motion = draw_press(chosen.truth_settings(index), seed)
    except SceneError:
        return None
    scene = replace(scene, settings=chosen.settings(index))
    frames, info = _observed(scene, motion, seed)
    runs = RunTracker(info, MECHANICS.seconds)
    ended = [*(runs.push(frame) for frame in frames), runs.finish()]
    run = next((run for run in ended if run is not None and run.index == motion.onset_frame), None)
    if run is None or run.builder is None:
        return None
    contact = run.builder.build(MECHANICS)
    if not len(contact.observation):
        return None
    quiet = replace(scene.settings, depth_noise=0.0, scale_flicker=0.0, depth_bits=16)
    truth, _ = _observed(replace(scene, settings=quiet), motion, seed)
    return WatchedClip(motion, info, frames, truth, run.builder, contact)


def _observed(scene: Scene, motion: PressedMotion, seed: int) -> tuple[list[PreparedFrame], ClipInfo]:
    clip = open_synthetic(synthetic_clip(scene, motion, seed), PREPARE)
    return list(clip), ClipInfo.of(clip)
