"""A force known for a part of a motion: the factor, the forces of other frames, and tables that can't be used."""

from pathlib import Path

import numpy as np
import pytest

from palpate.data.source.layout import InputError
from palpate.estimators.estimate import NoEstimate
from palpate.estimators.known_force import KnownForce, fit_factor, predict_force, read_forces
from palpate.physics.identifiability import NINETY


def test_the_factor_is_that_of_least_squares() -> None:
    dent = np.array([1.0, 2.0, 3.0])
    factor, variance, left = fit_factor(dent, np.array([2.0, 4.0, 7.0]))
    assert factor == pytest.approx(31 / 14)
    squares = (2 - 31 / 14) ** 2 + (4 - 62 / 14) ** 2 + (7 - 93 / 14) ** 2
    assert left == pytest.approx(np.sqrt(squares / 2))
    assert variance == pytest.approx(2 * squares / 2 / 14)  # half of the frames count
    assert fit_factor(dent, 0.3 * dent) == pytest.approx((0.3, 0, 0), abs=1e-12)


def test_the_force_of_other_frames_is_the_factor_times_what_shows_it() -> None:
    shown = np.array([0.1, 0.4, 0.7, 1.0, 0.5])
    known = np.array([0.3, 1.2, 2.1, np.nan, np.nan])
    force, sd = predict_force(known, shown, np.zeros(5))
    np.testing.assert_allclose(force, 3 * shown)
    np.testing.assert_allclose(sd, 0, atol=1e-9)


def test_errors_of_factor_frames_and_shown_force_add_up() -> None:
    shown, known = np.array([1.0, 2.0, 3.0, 6.0]), np.array([2.0, 4.0, 7.0, np.nan])
    factor, variance, left = fit_factor(shown[:3], known[:3])
    sd = predict_force(known, shown, np.array([0.0, 0.0, 0.0, 0.2]))[1]
    assert sd[3] == pytest.approx(np.sqrt(36 * variance + left**2 + (0.2 * factor) ** 2))


def test_intervals_hold_nine_of_ten_forces() -> None:
    """Noise of 0.1 N, half of the frames known; the variance counts half of them, so that a little more are held."""
    random = np.random.default_rng(4)
    shown = np.linspace(0.1, 1, 40)
    held = []
    for _ in range(200):
        force = 4 * shown + random.normal(0, 0.1, 40)
        found, sd = predict_force(np.where(np.arange(40) < 20, force, np.nan), shown, np.zeros(40))
        held.append(np.abs(found - force)[20:] < NINETY * sd[20:])
    assert 0.86 < np.mean(held) < 0.96


def test_too_little_that_is_known_is_a_sentence() -> None:
    shown = np.linspace(0, 1, 5)
    with pytest.raises(NoEstimate, match="The force is known in 2 frames that move; 3 are needed"):
        predict_force(np.array([0, 1, np.nan, np.nan, np.nan]), shown, np.zeros(5))
    with pytest.raises(NoEstimate, match="3 are needed"):
        predict_force(np.ones(5), np.zeros(5), np.zeros(5))


def test_force_in_between_is_linear_and_outside_unknown() -> None:
    known = KnownForce(np.array([1.0, 2.0, 4.0]), np.array([0.0, 1.0, 5.0]))
    np.testing.assert_allclose(known.at(np.array([0.9, 1.0, 1.5, 3.0, 4.0, 4.1])), [np.nan, 0, 0.5, 3, 5, np.nan])


def test_a_table_is_read(tmp_path: Path) -> None:
    (tmp_path / "forces.csv").write_text("force_N,time_s,note\n0.5,0.0,a\n1.5,0.1,b\n2,0.25,c\n")
    known = read_forces(tmp_path / "forces.csv")
    np.testing.assert_array_equal(known.times, [0, 0.1, 0.25])
    np.testing.assert_array_equal(known.force, [0.5, 1.5, 2])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "is no table of forces .*; give a CSV file with the columns time_s, force_N"),
        ("time_s,newtons\n0,1\n1,1\n2,1\n", "is no table of forces .there is no 'force_N'.; give a CSV file"),
        ("time_s,force_N\n0,1\n1,x\n2,1\n", "is no table of forces"),
        ("time_s,force_N\n0,1\n1,1\n", "has 2 rows; .*3 rows or more"),
        ("time_s,force_N\n0,1\n1,nan\n2,1\n", "holds a value that is not finite; leave such rows out"),
        ("time_s,force_N\n0,1\n1,1e300\n2,1\n", "holds a number beyond ±1e\\+15; correct the file"),
        ("time_s,force_N\n0,1\n2,1\n1,1\n", "a time that is not after the one before; sort its rows by time_s"),
    ],
)
def test_a_table_that_can_t_be_used_is_a_sentence(tmp_path: Path, text: str | None, told: str) -> None:
    file = tmp_path / "forces.csv"
    if text is not None:
        file.write_text(text)
    with pytest.raises(InputError, match=told):
        read_forces(file)


def test_what_is_no_text_at_all_is_told_in_a_short_sentence(tmp_path: Path) -> None:
    for content, told in (
        (bytes(range(128, 256)), "it is no text"),
        (b'time_s,force_N\n"' + 200_000 * b"x" + b'",1\n', "field larger than field limit"),
        (b"time_s,force_N\n" + 100_000 * b"x" + b",1\n", "could not convert string to float"),
    ):
        file = tmp_path / "forces.csv"
        file.write_bytes(content)
        told = rf"^{file} is no table of forces \(.*{told}.*\); give a CSV file with"
        with pytest.raises(InputError, match=told) as caught:
            read_forces(file)
        assert len(str(caught.value)) < len(str(file)) + 300
