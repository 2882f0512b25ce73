"""Tables as text: values, escaping, and what is said where a value is missing."""

import csv
import io

import numpy as np
import pytest

from evaluation.paper.collapse import check_collapse
from evaluation.paper.settling import SettlingSummary
from evaluation.paper.statistics import compare, summarise
from evaluation.paper.tables import (
    Table,
    comparison_table,
    error_table,
    format_number,
    settling_table,
    spread_rows,
    spread_table,
    statistic_rows,
)
from evaluation.tables import to_csv
from physics.mechanics import Bounds

RNG = np.random.default_rng(0)
CLIPS = np.repeat(list("abcd"), 10)
ERRORS = RNG.exponential(size=40)


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (3, "3"), (0.00428123, "0.004281"), (2.5e-8, "2.5e−8"), (-8.4, "−8.4"), (1e12, "1e+12"),
     (float("nan"), "not finite"), ("n too small", "n too small")],
)  # fmt: skip
def test_numbers(value, text):
    assert format_number(value) == text


def test_a_table_to_read():
    table = Table("T", ("a|b", "<x>"), (("|F|", 0.1234567), ("none", None)), ("a & b",))
    assert table.to_markdown() == (
        "### T\n\n| a\\|b | <x> |\n| --- | --- |\n| \\|F\\| | 0.1235 |\n| none | – |\n\n- a & b\n"
    )
    assert Table("T", ("a",), (("b",),)).to_markdown() == "### T\n\n| a |\n| --- |\n| b |\n"


def test_table_2_shows_each_regimes_numbers():
    summaries = {"reference θ": summarise(2 * ERRORS, CLIPS), "predicted θ": summarise(ERRORS, CLIPS)}
    table = error_table(summaries, ["a note"])
    assert table.columns == ("metric", "reference θ", "predicted θ")
    mean, sd = ERRORS.mean(), ERRORS.std(ddof=1)
    assert table.rows[0][2] == f"{mean:.4g}\u00a0±\u00a0{sd:.4g}"
    low, high = summaries["predicted θ"].interval
    assert table.rows[1][2] == f"[{low:.4g}, {high:.4g}]"
    assert table.rows[3] == ("frames n", 40, 40)
    assert table.notes == ("a note", "With 4 clips the interval over whole clips is coarse.")


def test_small_samples_say_n_too_small_and_never_nan():
    summaries = {"one": summarise(ERRORS[:1], CLIPS[:1]), "none": summarise(ERRORS[:0], CLIPS[:0])}
    comparisons = {"vs x": compare(ERRORS[:1], 2 * ERRORS[:1], CLIPS[:1])}
    text = error_table(summaries).to_markdown() + comparison_table(comparisons).to_markdown()
    assert "nan" not in text.lower()
    assert "(SD: n too small (1 value, 2 needed))" in text
    assert "| Wilcoxon signed-rank W | n too small (1 non-zero difference, 6 needed) |" in text
    assert "| Cohen's d (paired, d_z) | n too small (1 pair, 2 needed) |" in text


def test_comparison_table_holds_every_statistic():
    comparison = compare(ERRORS, 1.5 * ERRORS + RNG.normal(0, 0.1, 40), CLIPS)
    rows = {row[0]: row[1] for row in comparison_table({"vs constant θ": comparison}).rows}
    assert rows["Wilcoxon signed-rank W"] == comparison.wilcoxon_w
    assert rows["paired t"] == comparison.t
    assert rows["Cohen's d (paired, d_z)"] == comparison.cohens_d
    assert rows["pairs n"] == 40
    assert rows["clips"] == 4


def test_statistic_rows_keep_full_precision():
    comparison = compare(ERRORS, 1.5 * ERRORS, CLIPS)
    summaries = {"predicted θ": summarise(ERRORS, CLIPS)}
    text = to_csv(statistic_rows(summaries, {"constant θ": comparison}))
    rows = {(row["compared_with"], row["quantity"]): row for row in csv.DictReader(io.StringIO(text))}
    assert float(rows["", "mean"]["value"]) == ERRORS.mean()
    assert (rows["", "mean"]["low"], rows["", "interval"]["value"]) == ("", "")
    assert float(rows["", "interval"]["low"]) == summaries["predicted θ"].interval[0]
    assert float(rows["constant θ", "wilcoxon_p"]["value"]) == comparison.wilcoxon_p
    assert float(rows["constant θ", "difference_clip_interval"]["high"]) == comparison.difference_clip_interval[1]
    assert rows["constant θ", "t"]["clips"] == "4"


def test_spread_tables():
    theta = np.tile([0.5, 0.1, -5.0], (40, 1))
    theta[:, 0] += RNG.normal(0, 0.2, 40)
    check = check_collapse(theta, CLIPS, Bounds())
    reading, (stiffness, *_, force) = spread_table(check), spread_rows(check)
    assert [row[-1] for row in reading.rows] == ["varies", "constant", "constant"]
    assert reading.rows[2][0] == "|F| [normalised]"
    assert reading.rows[2][3] == "0 … 10"
    assert stiffness["sd"] == pytest.approx(theta[:, 0].std(ddof=1))
    assert stiffness["sd_of_range"] == stiffness["sd"] / (stiffness["high"] - stiffness["low"])
    assert (stiffness["verdict"], force["verdict"]) == ("varies", "constant")
    assert ",".join(force) == (
        "parameter,mean,sd,minimum,maximum,low,high,sd_of_range,sd_of_mean,between_clips_sd,within_clips_sd,at_bound,"
        "verdict"
    )
    signed = spread_table(check_collapse(theta, CLIPS, Bounds(force=(-10, 10))))
    assert signed.rows[2][0] == "F [normalised], signed"


def test_settling_table_names_what_did_not_settle():
    counts = {"settled": 0, "not reached": 7, "no release": 0, "no motion": 1, "not finite": 2}
    row = settling_table({"reference θ": SettlingSummary(counts, None, None)}).rows[0]
    assert row == ("reference θ", "none settled", "none settled", 0, 7, 0, 1, 2)
