"""The README's picture: a frame of a synthetic press, what the shipped network says of it over time, and the truth.

    python -m evaluation.result_figure [--output docs/figures/result.png] [--seed 8]

Exit status: 0 drawn; 1 the clip has no estimate.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from palpate.api import open_clip, open_estimator
from palpate.common.command_line import path_option, whole_number
from palpate.common.output import replacing_own
from palpate.data.prepared import PreparedFrame
from palpate.data.synthetic.clip import write_clip
from palpate.data.synthetic.settings import SceneSettings
from palpate.estimators.contract import ClipInfo
from palpate.estimators.estimate import SYMBOLS
from palpate.estimators.records import FrameEstimate
from palpate.estimators.session import estimates_of
from palpate.physics.mechanics import PARAMETERS
from palpate.results.overlay import draw_overlay

SCENE = SceneSettings(frames=40, regime="under-damped", depth_noise=0.001)


def draw(frame: PreparedFrame, estimates: Sequence[FrameEstimate], index: int, truth: Mapping[str, float]) -> Figure:
    """A frame's overlay, and each parameter over time with its 90 % interval and the truth.

    Args:
        frame: with the picture that is shown.
        estimates: of all frames.
        index: the shown frame's among them.
        truth: k_s, k_d and F by name [scene units].
    """
    picture, labels = frame.view
    overlay = draw_overlay(picture, picture.shape[1::-1], labels, estimates[index])
    layout: list[list[Any]] = [["picture", name] for name in PARAMETERS]
    figure, places = plt.subplot_mosaic(layout, figsize=(12, 4.2), layout="constrained", width_ratios=[2, 1])
    places["picture"].imshow(overlay)
    places["picture"].set_axis_off()
    times = np.array([each.time_s for each in estimates])
    for name in PARAMETERS:
        axes = places[name]
        rows = [[each.values.get(f"{name}{end}") for end in ("", "_low", "_high")] for each in estimates]
        middle, low, high = np.array(rows, float).T
        axes.fill_between(times, low, high, color="tab:blue", alpha=0.25, lw=0, label="90 % interval")
        axes.plot(times, middle, color="tab:blue", label="estimate")
        axes.axhline(abs(truth[name]), color="black", ls="--", lw=1, label="truth")
        axes.axvline(times[index], color="tab:orange", lw=1, label="frame shown")
        axes.set(ylabel=f"{name} {SYMBOLS[name]}", ylim=(0, 2.5 * abs(truth[name])))
        axes.grid(alpha=0.3)
    places[PARAMETERS[-1]].set_xlabel("time [s]; stiffness, damping and force in scene units")
    places["stiffness"].legend(ncols=2, fontsize=8, loc="upper right")
    return figure


def main(arguments: list[str] | None = None) -> int:
    """Draw the picture; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.result_figure", description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=path_option, default=Path("docs/figures/result.png"), metavar="FILE")
    parser.add_argument("--seed", type=whole_number(0), default=8)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        path = write_clip(Path(folder), 1, SCENE, options.seed)
        truth = json.loads((path / "truth.json").read_text(encoding="utf-8"))
        estimator = open_estimator("network", onset="stamp")
        clip = open_clip(path, estimator)
        frames = list(clip)
        outputs = list(estimates_of(estimator.start(ClipInfo.of(clip)), frames))
        estimates = [item for item in outputs if isinstance(item, FrameEstimate)]
        index = truth["release_frame"] - 1
        if estimates[index].estimate is None:
            print("The clip has no estimate; give another --seed.", file=sys.stderr)
            return 1
        figure = draw(frames[index], estimates, index, truth["theta"])
        with replacing_own(options.output) as partial:
            figure.savefig(partial, dpi=100)
    return 0


if __name__ == "__main__":
    run_door(main)
