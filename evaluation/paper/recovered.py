"""Compares the estimates of `train.py test` on synthetic clips with their truth: are k_s, k_d and F recovered?

    python -m evaluation.paper.recovered EVALUATION CLIPS

EVALUATION is the folder that `train.py test` wrote, CLIPS the data set of `python -m data.synthetic` that it was tested
on. Prints a table: how far estimates are from the truth, and whether they rank the contacts as the truth does, compared
with the constant whose logarithm is the truth's mean, which no estimator knows. Exit status: 0 done, 1 something is
missing, 2 wrong usage.
"""

from palpate.common.doors import enter_door, run_door

if __name__ == "__main__":
    enter_door()  # before the slow imports

import argparse
import io
import json
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from scipy import stats

from palpate.common.command_line import path_option, say
from palpate.common.files import read_file
from palpate.common.settings import LARGEST
from palpate.common.tables import to_markdown
from palpate.data.source.table import MOST_BYTES, reason
from palpate.estimators.estimate import COMBINATIONS, REPORTED
from palpate.evaluation.compare_with_truth import true_values
from palpate.evaluation.paper.statistics import format_number
from palpate.physics.mechanics import PARAMETERS

MIN_MAGNITUDE = 1e-9
"""Smaller estimates count as this, so that they have a logarithm."""
COLUMNS = ("quantity", "truth", "estimate", "typical factor off", "of the constant", "rank correlation", "p")


def read_contacts(evaluation: Path, clips: Path) -> pd.DataFrame:
    """One row a test frame: its clip, and estimate and truth of every REPORTED quantity as `NAME` and `true_NAME`.

    Raises:
        ValueError: no such evaluation, or a clip without truth; one sentence.
    """
    try:
        text = io.BytesIO(read_file(evaluation / "per_frame.csv", MOST_BYTES))
        frames = pd.read_csv(text, dtype={"clip": str, **dict.fromkeys(PARAMETERS, float)})[["clip", *PARAMETERS]]
        if not len(frames) or not frames["clip"].notna().all():
            raise ValueError("a row without a clip, or none")
        if not (frames[list(PARAMETERS)].abs() <= LARGEST).all(axis=None):
            raise ValueError(f"an estimate that is no number up to {LARGEST:g}")
    except (OSError, ValueError, KeyError) as error:
        problem = f"holds no per_frame.csv of train.py test ({reason(error)}); test a network"
        raise ValueError(f"{evaluation} {problem}.") from error
    magnitudes = np.maximum(frames[list(PARAMETERS)].abs().to_numpy(), MIN_MAGNITUDE)
    for name in REPORTED:
        frames[name] = np.prod(magnitudes ** np.array(COMBINATIONS[name]), axis=1)
    truths = {}
    for clip in frames["clip"].unique():
        file = clips / clip.rpartition("_")[0] / clip / "truth.json"
        try:
            truths[clip] = true_values(json.loads(read_file(file, MOST_BYTES))["theta"])
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            problem = f"is no truth of data.synthetic ({reason(error)}); give the clips' folder"
            raise ValueError(f"{file} {problem}.") from error
    return frames.join(pd.DataFrame.from_dict(truths, orient="index").add_prefix("true_"), on="clip")


def recovery_row(name: str, frames: pd.DataFrame) -> list[str]:
    """A quantity's line of the table, by COLUMNS.

    Factors are medians over the frames of exp |log estimate − log truth|; ranks are those of the contacts' median
    estimates.
    """
    estimate, truth = np.log(frames[name]), np.log(frames[f"true_{name}"])
    by_clip = frames.groupby("clip")[[name, f"true_{name}"]].median()
    of_clips = np.log(by_clip[f"true_{name}"])
    enough = by_clip[name].nunique() > 2
    rank, p = stats.spearmanr(by_clip[name], by_clip[f"true_{name}"]) if enough else (np.nan, np.nan)
    off = [np.exp(np.abs(each - truth).median()) for each in (estimate, of_clips.mean())]
    middle, spread = frames[name].mean(), frames[name].std()
    return [
        name.replace("_", " "),
        f"{format_number(float(np.exp(of_clips.min())))} to {format_number(float(np.exp(of_clips.max())))}",
        f"{format_number(float(middle))} ± {format_number(float(spread))}",
        *(format_number(float(value)) for value in (*off, rank, p)),
    ]


def main(arguments: list[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.paper.recovered", description=__doc__.split("\n")[0])
    parser.add_argument("evaluation", type=path_option, metavar="EVALUATION", help="folder that train.py test wrote")
    parser.add_argument("clips", type=path_option, metavar="CLIPS", help="data set of python -m data.synthetic")
    options = parser.parse_args(arguments)
    try:
        frames = read_contacts(options.evaluation, options.clips)
    except ValueError as error:
        say(Console(stderr=True), str(error), "red")
        return 1
    print(f"{len(frames)} test frames of {frames['clip'].nunique()} contacts [normalised units]")
    print(to_markdown(list(COLUMNS), [recovery_row(name, frames) for name in REPORTED]))
    return 0


if __name__ == "__main__":
    run_door(main)
