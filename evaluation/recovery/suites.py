"""Named suites of synthetic clips, each with one error of observation, and the seeds that keep the splits apart.

Clip i of a split has the same truth in every suite, because errors of observation have random streams of their own
(`data.synthetic.clip.draw_truth`); `mismatch` moves otherwise on the same geometry, `late-onset` moves the same, but
later, and `oblique` has other geometry. Regimes take turns: clip 0 is under-damped, 1 critical, 2 over-damped, 3
under-damped again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.truth import REGIMES

GRID_SIZE = (214, 120)
"""Width and height of pictures of the network's input size [px]."""
SPLITS = {"training": 1, "validation": 2, "test": 3}
"""First number of each split's random stream."""
FITTED_ON = {"test": "validation", "validation": "training", "training": "validation"}
"""Split on which the constant is fitted that a split's clips are compared with."""
LARGEST_SEED = 2**32 - 1
_STREAM = 0x70A17A7E
"""Tells these streams from any other use of the same seed, such as `data.synthetic.clip.clip_seed`."""


@dataclass(frozen=True)
class Suite:
    """One way to observe, or to spoil, the clips of a split."""

    name: str
    reason: str
    """What it stands for, and why the error is as large as it is."""
    errors: Mapping[str, Any] = field(default_factory=dict)
    """Fields of SceneSettings that leave the truth as it is."""
    truth: Mapping[str, Any] = field(default_factory=dict)
    """Fields of SceneSettings that change how, or when, the tissue answers, or how it lies."""
    every_other_truth: Mapping[str, Any] = field(default_factory=dict)
    """The same, in every other clip of each regime only."""

    of: ClassVar[str] = "press"
    """What moves the tissue: `press` and `grip` on a sheet, or `slab`, some of either on finite elements."""

    def truth_settings(self, index: int, size: tuple[int, int] = GRID_SIZE) -> SceneSettings:
        """What the truth of clip `index` is drawn from, without errors: its regime is REGIMES[index % 3].

        Args:
            size: width and height of the pictures [px].
        """
        extra = self.every_other_truth if index // len(REGIMES) % 2 else {}
        return SceneSettings(width=size[0], height=size[1], regime=REGIMES[index % len(REGIMES)], **self.truth, **extra)

    def settings(self, index: int, size: tuple[int, int] = GRID_SIZE) -> SceneSettings:
        """The same with the suite's errors of observation."""
        return replace(self.truth_settings(index, size), **self.errors)

    def describe(self) -> dict[str, dict[str, Any]]:
        """What decides the suite's clips, for the run's record."""
        return {name: dict(getattr(self, name)) for name in ("errors", "truth", "every_other_truth")}


class GripSuite(Suite):
    """Clips whose tool grips tissue or passes over it, at CholecSeg8k's size; errors of depth are as networks' are."""

    of = "grip"

    def truth_settings(self, index: int, size: tuple[int, int] = GRID_SIZE) -> SceneSettings:
        """The same for all clips, and the errors with it."""
        return SceneSettings(**(_GRIPS | dict(self.truth)))

    def describe(self) -> dict[str, dict[str, Any]]:
        """What decides the suite's clips, for the run's record."""
        return {"truth": _GRIPS | dict(self.truth)}


class SlabSuite(Suite):
    """Clips whose tissue is a slab of finite elements: of three clips two are pressed and one is pulled."""

    of = "slab"

    def truth_settings(self, index: int, size: tuple[int, int] = GRID_SIZE) -> SceneSettings:
        """Of two of three a press, at the network's size, of the third a pull at CholecSeg8k's, with their errors.

        Threes of damping proportional to mass and of a standard linear solid take turns, and sixes without and with an
        inclusion.
        """
        act = _SLAB_PULLS if index % 3 == 2 else _SLAB_PRESSES
        viscosity = _RELAXING if index // 3 % 2 else {}
        return SceneSettings(**act, **viscosity, slab_inclusion=STIFF if index // 6 % 2 else 1.0)

    def describe(self) -> dict[str, Any]:
        """What decides the suite's clips, for the run's record."""
        return {"presses": _SLAB_PRESSES, "pulls": _SLAB_PULLS, "relaxing": _RELAXING, "inclusion": STIFF}


CLEAN_NOISE = 0.001
"""Depth noise of all suites but `8bit` and `noisy` [scene units]: 0.2 % of the tissue's distance, what a calibrated
stereo endoscope reaches."""
_ALL = (
    Suite("clean", "depth noise alone, of a good sensor", {"depth_noise": CLEAN_NOISE}),
    Suite(
        "8bit",
        "depth stored in 8 bits as in CholecSeg8k preparations of the paper: steps of 1/255, no other noise",
        {"depth_bits": 8},
    ),
    Suite(
        "noisy",
        "depth noise of 0.8 % of the distance, about one 8-bit step: a depth network from frame to frame",
        {"depth_noise": 0.004},
    ),
    Suite(
        "flicker",
        "the scale changes by 0.5 % from frame to frame, as depth networks' does although the clip has one scale; "
        "that is 2.5 times the noise, but common to all of a frame",
        {"depth_noise": CLEAN_NOISE, "scale_flicker": 0.005},
    ),
    Suite(
        "mask-error",
        "outlines off by 1 grid px, which is 4 px of an 854x480 picture: the edge of a good segmentation network",
        {"depth_noise": CLEAN_NOISE, "mask_error": 1.0},
    ),
    Suite(
        "focal-error",
        "focal length 10 % too long: a field of view that was guessed, 55 instead of 60 degrees",
        {"depth_noise": CLEAN_NOISE, "focal_error": 1.1},
    ),
    Suite("occlusion", "a fifth of the tissue behind drifting fat", {"depth_noise": CLEAN_NOISE, "occlusion": 0.2}),
    Suite(
        "mismatch",
        "tissue that isn't the fitted model: stiffness varies by 30 % over some pixels, and in every other clip the "
        "springs are half as stiff again at an elongation of 0.01",
        {"depth_noise": CLEAN_NOISE},
        truth={"stiffness_variation": 0.3},
        every_other_truth={"nonlinearity": 0.5},
    ),
    Suite(
        "oblique",
        "pressed at up to 30 degrees to the line of sight, not 0.2: a dent one grid cell wide hides its own bottom",
        {"depth_noise": CLEAN_NOISE},
        truth={"max_tilt_deg": 30.0},
    ),
    Suite(
        "late-onset",
        "the force starts and ends up to one frame after the time stamps that say so, each for itself: cameras don't "
        "wait for the tool",
        {"depth_noise": CLEAN_NOISE},
        truth={"onset_delay": (0.0, 1.0), "release_delay": (0.0, 1.0)},
    ),
    Suite(
        "patch",
        "pressed on a patch of 2 to 5 grid px, up to 20 degrees aslant to the tissue, by a force that rises, holds and "
        "falls: a round tip, a hand",
        {"depth_noise": CLEAN_NOISE},
        truth={
            "patch_radius": (2.0, 5.0),
            "force_tilt_deg": (0.0, 20.0),
            "profile": "hold",
            "rise": (0.1, 0.45),
            "fall": (0.1, 0.45),
        },
    ),
)
SUITES = {suite.name: suite for suite in _ALL}
"""Suites by name, in the order of tables."""


_GRIPS: dict[str, Any] = {
    "action": "grip",
    "frames": 20,
    "onset_fraction": (0.0, 0.0),
    "peak_displacement": (0.02, 0.05),
    # A grip may be anywhere, not only where the wet tissue mirrors the light.
    "max_tilt_deg": 30.0,
    "relaxation": (0.0005, 0.002),
    "depth_noise": 0.004,
    "depth_noise_correlation": 8.0,
    "depth_bias": 0.05,
    "scale_flicker": 0.005,
}
"""Of all grips: in contact from the first frame, and depth as networks see it that know one picture each."""
_ALL_GRIPS = (
    GripSuite("retraction", "a tool that holds tissue from the first frame moves it across the line of sight"),
    GripSuite(
        "foundation",
        "the same on tissue that is attached loosely or firmly: motion dies away over 30 to 180 px",
        truth={"spread": (7.5, 45.0)},
    ),
    GripSuite("breathing", "the background is carried to and fro by up to 16 px", truth={"breathing": (1.0, 4.0)}),
    GripSuite(
        "creep",
        "tissue comes to rest in 0.02 to 0.1 s, one to three frames: what damps it shows while the tool moves",
        truth={"relaxation": (0.02, 0.1)},
    ),
    GripSuite(
        "regions", "stiffness changes by a factor 3 across a line that passes by the grip", truth={"regions": 3.0}
    ),
    GripSuite("hover", "a tool passes over still tissue and never touches", truth={"onset_fraction": (1.0, 1.0)}),
    GripSuite(
        "approach", "a tool passes over tissue, then grips it", truth={"onset_fraction": (0.3, 0.5), "frames": 32}
    ),
)
GRIP_SUITES = {suite.name: suite for suite in _ALL_GRIPS}
"""Suites of grips by name, in the order of tables."""


STIFF = 4.0
"""Of inclusions, over the tissue around."""
_RELAXING: dict[str, Any] = {"slab_damping": (0.0, 0.0), "slab_branch": (0.5, 2.0), "slab_branch_time": (0.05, 0.3)}
_SLAB_PRESSES: dict[str, Any] = {
    "tissue": "slab",
    "width": GRID_SIZE[0],
    "height": GRID_SIZE[1],
    "patch_radius": (8.0, 8.0),
    "peak_displacement": (0.008, 0.0115),
    "depth_noise": CLEAN_NOISE,
}
"""Observed as in the suite `clean`."""
_SLAB_PULLS: dict[str, Any] = {name: value for name, value in _GRIPS.items() if name != "relaxation"} | {
    "tissue": "slab",
    "peak_displacement": (0.01, 0.03),
}
"""Observed as in the suites of grips."""
_ALL_SLABS = (
    SlabSuite(
        "fem",
        "a soft neo-Hookean slab, some with a stiffer ball inside, pressed or pulled, damped or relaxing: the truth is "
        "no estimator's model",
    ),
)
SLAB_SUITES = {suite.name: suite for suite in _ALL_SLABS}
"""Suites of slabs by name."""
EVERY: dict[str, Suite] = SUITES | GRIP_SUITES | SLAB_SUITES


def suite_clip_seed(split: str, seed: int, index: int) -> int:
    """Seed of a clip, 64 bits: a stream for each split, so that no two splits share geometry or θ at any seed.

    Args:
        split: training, validation or test.
        seed: of the benchmark, 0 to 2³² - 1.
        index: number of the clip in its split.
    """
    stream = np.random.SeedSequence((_STREAM, SPLITS[split], seed, index))
    return int(stream.generate_state(1, np.uint64)[0])
