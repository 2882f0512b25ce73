"""How long following tissue points takes a frame, and how far off it is where the motion is known.

    python -m benchmarks.following

Smoothed noise of 854x480 is pulled by 40 px within 25 frames: motion dies away over 60 px around the middle. Errors are
of the points that move by more than 10 px, in the last frame; their share of the told noise is told, too.
"""

from __future__ import annotations

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import time

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from palpate.benchmarks.shared import command_line, machine, print_table, timed
from palpate.data.tracks.following import PointFollower

WIDTH, HEIGHT, FRAMES = 854, 480, 25
PULL, DECAY = np.array([30.0, -26.0]), 60.0
FAR = 10.0
"""Points that move farther count [px]."""


def motion(places: np.ndarray, share: float) -> np.ndarray:
    """How far places [..., 2] (column, row) have moved [px]."""
    away = np.linalg.norm(places - [WIDTH / 2, HEIGHT / 2], axis=-1, keepdims=True)
    return share * PULL * np.exp((DECAY - np.hypot(away, DECAY)) / DECAY)


def pictures(seed: int) -> list[np.ndarray]:
    """The clip, RGB; its grey values have a noise of 2 of 255."""
    random = np.random.default_rng(seed)
    smooth = gaussian_filter(random.normal(size=(HEIGHT, WIDTH, 3)), (3, 3, 0))
    rest = 130 + 30 * smooth / smooth.std()
    here = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).astype(np.float64)
    found = []
    for share in np.linspace(0, 1, FRAMES):
        source = here
        for _ in range(30):  # which place came here
            source = here - motion(source, share)
        places = source[..., ::-1].transpose(2, 0, 1)
        moved = np.stack([map_coordinates(rest[..., one], places, mode="reflect") for one in range(3)], axis=-1)
        found.append(np.clip(moved + random.normal(0, 2, moved.shape), 0, 255).astype(np.uint8))
    return found


def main(arguments: list[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    command_line(__doc__).parse_args(arguments)
    clip, tool = pictures(0), np.zeros((HEIGHT, WIDTH), bool)
    print(f"{WIDTH}x{HEIGHT}, {FRAMES - 1} frames ({machine()})\n")
    follower = PointFollower(clip[0], tool)
    start = time.process_time()
    times = [timed(follower.step, picture, tool)[1] for picture in clip[1:]]
    processor = 1e3 * (time.process_time() - start) / len(times)
    true = motion(follower.points.astype(np.float64), 1.0)
    far = np.linalg.norm(true, axis=1) > FAR
    off = (follower.moved - true)[far & follower.followed]
    told = follower.noise[far & follower.followed]
    length = np.linalg.norm(off, axis=1)
    row = [
        len(follower.points),
        *(f"{value:.1f}" for value in (np.mean(times), np.median(times), np.min(times), processor)),
        f"{follower.followed[far].mean():.1%}",
        *(f"{value:.2f}" for value in (np.median(length), np.quantile(length, 0.95))),
        f"{np.sqrt(np.square(off).mean()) / np.sqrt(np.square(told).mean()):.2f}",
    ]
    names = (
        "points",
        "mean [ms a frame]",
        "median",
        "least",
        "of all cores together",
        "followed",
        "median error [px]",
        "95 %",
        "error over told noise",
    )
    print_table(names, [row])
    return 0


if __name__ == "__main__":
    run_door(main)
