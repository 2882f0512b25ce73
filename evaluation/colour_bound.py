"""What colours could tell of a press beside its depth: Cramér–Rao bounds of log θ from a clip's film and its pictures.

    python -m evaluation.colour_bound [--suite clean noisy] [--clips 12] [--seed N]

No estimator here looks at colours; this says what one could gain. A dent tilts the tissue, and under the endoscope's
own light tilted tissue is darker. The film's information is that of its depth (`evaluation.recovery.bounds`). That of
the colours is of the pictures of the same press on even springs, rendered without noise for the true θ and for one a
little off, at the noise that the clip's pictures have; the tissue's own colour is taken as known from the frames before
contact. The three channels count as one, and pixels on or beside the tool don't count, nor do those whose change is not
proportional to θ's, where edges pass: the true bound is lower.
"""

from __future__ import annotations

from physics.doors import INTERRUPTED, enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from rich.console import Console

from data.command_line import progress_bars, say
from data.masks.class_table import CLASSES
from data.synthetic.render import Renderer
from data.synthetic.scene import SceneError
from estimators.onset import STAMP
from estimators.worker_pool import WorkerLost, run_tasks
from evaluation.recovery.bounds import field_information, known
from evaluation.tables import to_markdown
from evaluation.watched import WatchedClip, add_clip_options, chosen_clips, watch
from physics.identifiability import covariance, fisher_information

STEP = 0.02
"""Of log θ, for differences."""
CURVED = 0.3
"""Pixels don't count whose changes either way differ by more than this share of both."""
BESIDE = 2
"""Pixels so near to the tool don't count [px]."""
ROUNDING = 1 / (255 * 12**0.5)
"""Standard deviation of the rounding to 8 bits, as a share of full scale."""
SOURCES = ("film", "colours", "both")


@dataclass(frozen=True)
class ColourTask:
    """One clip of a suite."""

    suite: str
    index: int
    seed: int
    """Seed of the clip."""


@dataclass(frozen=True)
class ColourBounds:
    """Of one clip."""

    suite: str
    regime: str
    bounds: np.ndarray
    """Standard deviations of log θ from each of SOURCES, shape [3, 3]."""


def colour_bounds(task: ColourTask) -> ColourBounds | None:
    """Bounds of one clip; None where no contact with a film is found in the frame of its onset."""
    clip = watch(task.suite, task.index, task.seed)
    whole = None if clip is None else field_information(clip.contact, clip.scene, clip.motion)
    if clip is None or clip.contact.film is None or whole is None:
        return None
    film = known(whole, STAMP)
    last = clip.motion.onset_frame + round(float(clip.contact.film.times[-1]) * clip.info.fps)
    try:
        colours = colour_information(clip, last)
    except SceneError:
        return None
    bounds = [np.sqrt(np.diag(covariance(each))) for each in (film, colours, film + colours)]
    return ColourBounds(task.suite, clip.scene.settings.regime, np.array(bounds))


def colour_information(clip: WatchedClip, last: int) -> np.ndarray:
    """Fisher information of log θ from the pictures from the onset to a frame, shape [3, 3].

    Raises:
        SceneError: another θ's motion can't be integrated.
    """
    theta, onset = clip.motion.theta, clip.motion.onset_frame
    frames = range(onset, last + 1)
    pictures, far = _exact(clip, theta, frames)
    slopes = []
    for one in np.eye(3):
        more, less = (_exact(clip, theta * np.exp(sign * STEP * one), frames)[0] for sign in (1, -1))
        above, below = more - pictures, pictures - less
        straight = np.abs(above - below) <= CURVED * (np.abs(above) + np.abs(below))
        slopes.append(np.where(straight & far[..., None], (above + below) / (2 * STEP), 0.0).ravel())
    variance = clip.scene.settings.image_noise**2 + ROUNDING**2
    # As if one channel was seen: highlights and the noise of real cameras are common to all.
    return fisher_information(np.stack(slopes, axis=1), float(np.sqrt(3 * variance * (1 + 1 / max(onset, 1)))))


def _exact(clip: WatchedClip, theta: np.ndarray, frames: range) -> tuple[np.ndarray, np.ndarray]:
    """Pictures without noise, shape [N, H, W, 3] in [0, 1], and where the tool is not near, shape [N, H, W], bool."""
    renderer = Renderer(clip.scene, clip.motion_at(theta), np.random.default_rng([clip.seed, 2]))
    drawn = [renderer.exact(index) for index in frames]
    reach = np.ones((2 * BESIDE + 1, 2 * BESIDE + 1), np.uint8)
    tools = [(labels == CLASSES["grasper"].grey).astype(np.uint8) for _, labels, _ in drawn]
    far = np.stack([cv2.dilate(tool, reach) == 0 for tool in tools])
    return np.stack([picture for picture, _, _ in drawn]).astype(np.float64), far


def main(arguments: list[str] | None = None) -> int:
    """Measure and print the table; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.colour_bound", description=__doc__.split("\n")[0])
    add_clip_options(parser, clips=12)
    options = parser.parse_args(arguments)
    tasks = [ColourTask(*clip) for clip in chosen_clips(options)]
    console = Console(stderr=True)
    try:
        with progress_bars(console) as progress:
            run = run_tasks(colour_bounds, tasks, options.workers, ordered=True)
            found = list(progress.track(run, len(tasks), description="clips"))
    except WorkerLost as error:
        say(console, str(error), "red")
        return 1
    except KeyboardInterrupt:
        return INTERRUPTED
    kept = [bounds for bounds in found if bounds is not None]
    if len(kept) < len(found):
        say(console, f"{len(found) - len(kept)} of {len(found)} clips have no contact with a film and are left out.")
    print("Median bounds of log k_s, log k_d, log |F|")
    print(to_markdown(("suite", "regime", "clips", *SOURCES), table(kept)))
    return 0


def table(found: Sequence[ColourBounds]) -> list[list[str]]:
    """Medians of each suite and regime, a row each."""
    rows = []
    for suite, regime in dict.fromkeys((each.suite, each.regime) for each in found):
        bounds = np.array([each.bounds for each in found if (each.suite, each.regime) == (suite, regime)])
        cells = [", ".join(f"{value:.2g}" for value in source) for source in np.median(bounds, axis=0)]
        rows.append([suite, str(regime), str(len(bounds)), *cells])
    return rows


if __name__ == "__main__":
    run_door(main)
