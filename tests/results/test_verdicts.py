"""How pictures tell verdicts and numbers."""

import pytest

from palpate.estimators.records import FrameEstimate
from palpate.results.verdicts import NOTES, digits, numbers, rounded, state

VALUES = {
    **dict.fromkeys(("stiffness_sd", "damping_sd", "force_sd"), 0.0123),
    **{"stiffness": 0.5123, "stiffness_low": 0.2345, "stiffness_high": 0.8765},
    **{"damping": 0.0512, "damping_low": 0.00123, "damping_high": 0.35678},
    **{"force": 0.1024, "force_low": 0.0912, "force_high": 0.1156},
    **{"damping_over_stiffness": 0.0999, "damping_over_stiffness_low": 0.0877, "damping_over_stiffness_high": 0.1123},
    **{"force_over_stiffness": 0.1999, "force_over_stiffness_low": 0.165, "force_over_stiffness_high": 0.234},
}
NO_INTERVAL = {"stiffness": 0.5123, "damping": 0.0512, "force": 0.1024}


def test_verdicts_have_colours_and_meanings_and_only_determined_is_green() -> None:
    said = {name for name, note in NOTES.items() if note.text}
    assert set(NOTES) - said == {"doubtful", "no_estimate"}
    colors = {name: note.color for name, note in NOTES.items()}
    green = [name for name, (red, strongest, blue) in colors.items() if strongest > 1.2 * max(red, blue)]
    assert green == ["determined"]


def test_the_verdict_goes_before_the_status() -> None:
    assert state(FrameEstimate(0, 0.0, "ok", verdict="ratios")) == "ratios"
    assert state(FrameEstimate(0, 0.0, "no_tool")) == "no_tool"


@pytest.mark.parametrize(
    ("verdict", "values", "expected"),
    [
        ("determined", VALUES, ["0.51 ± 0.32", "0.05 ± 0.18", "0.102 ± 0.012"]),
        ("undetermined", VALUES, ["0.23 to 0.88", "0.0012 to 0.36", "0.091 to 0.12"]),
        (
            "undetermined",
            VALUES | {"determined": ["damping_over_stiffness"]},
            ["0.23 to 0.88", "0.0012 to 0.36", "0.091 to 0.12", "0.100 ± 0.012"],
        ),
        ("doubtful", VALUES, ["0.23 to 0.88", "0.0012 to 0.36", "0.091 to 0.12"]),
        ("ratios", VALUES, ["0.23 to 0.88", "0.0012 to 0.36", "0.091 to 0.12", "0.100 ± 0.012", "0.200 ± 0.035"]),
        ("undetermined", NO_INTERVAL, ["—", "—", "—"]),
        ("onset_in_view", NO_INTERVAL, ["≈ 0.51", "≈ 0.051", "≈ 0.1"]),
    ],
)
def test_no_number_is_surer_than_its_verdict(verdict: str, values: dict[str, float], expected: list[str]) -> None:
    told = numbers(verdict, values)
    assert [name for name, *_ in told] == ["k_s", "k_d", "|F|", "k_d/k_s", "|F|/k_s"][: len(expected)]
    assert [unit for *_, unit in told] == ["f/u", "f·s/u", "f", "s", "u"][: len(expected)]
    assert [text for _, text, _ in told] == expected


def test_physical_units_are_those_of_the_table_and_numbers_end_at_their_uncertainty() -> None:
    known = {"force": 348.2, "force_low": 320.0, "force_high": 380.0, "force_unit": "N, by forces.csv"}
    assert numbers("determined", known) == [("|F|", "348 ± 30", "N")]
    assert (rounded(1234.5, 0.0), rounded(0.00123, 0.000456)) == ("1234.500 ± 0.000", "0.00123 ± 0.00046")


@pytest.mark.parametrize(("value", "expected"), [(0.000456, "0.00046"), (348.2, "350"), (1.0, "1"), (0.0, "0")])
def test_digits_need_no_exponent(value: float, expected: str) -> None:
    assert digits(value) == expected
