"""Calibration by hand, on errors of known size, and what it refuses."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest

from data.contact.features import REFERENCE_SPACING
from estimators.estimate import NINETY
from evaluation.calibration import (
    check_record,
    conformal_scale,
    fit_exponents,
    fit_widths_of,
    main,
)
from tests.evaluation.recovery_cases import off_by, recovery


def test_factor_by_hand() -> None:
    """With 199 scores 1…199 in units of sd the 180th is the 90 % quantile of 200."""
    errors = np.arange(1.0, 200.0)
    assert conformal_scale(errors, np.ones(199)) * NINETY == pytest.approx(180)
    assert conformal_scale(-2 * errors, np.ones(199)) * NINETY == pytest.approx(360)


def test_widths_are_found_again() -> None:
    generator = np.random.default_rng(0)
    known = np.log(generator.uniform(0.05, 0.5, (20000, 2)))
    errors = generator.normal(size=20000) * np.exp(0.3 + known @ (0.7, 0.2))
    np.testing.assert_allclose(fit_exponents(errors, known), (0.7, 0.2), atol=0.03)
    known[:, 1] = 1.0  # tells nothing, so the rest must come out as without it
    found = fit_exponents(errors, known)
    assert found[1] == 0
    np.testing.assert_allclose(found[:1], fit_exponents(errors, known[:, :1]), rtol=1e-6)


def test_overconfident_estimates_become_calibrated_at_any_width() -> None:
    """Errors with a floor under their size: one factor for all leaves narrow intervals too narrow."""
    generator = np.random.default_rng(0)
    sd, noise = generator.uniform(0.03, 0.6, (6000, 3)), generator.choice([0.4, 1.5], 6000)
    errors = generator.normal(size=(6000, 3)) * 1.3 * sd**0.7 * noise[:, None] ** 0.2
    rows = [
        recovery(
            index,
            estimator="network",
            estimate=off_by(error),
            covariance=np.diag(deviation**2),
            noise=level * REFERENCE_SPACING,
        )
        for index, (error, deviation, level) in enumerate(zip(errors[:3000], sd[:3000], noise[:3000], strict=True))
    ]
    found = fit_widths_of(rows)
    np.testing.assert_allclose(found.power, 0.7, atol=0.06)
    np.testing.assert_allclose(found.noise, 0.2, atol=0.06)
    widths = found.scale * sd[3000:] ** found.power * noise[3000:, None] ** np.array(found.noise)
    held = np.abs(errors[3000:]) <= NINETY * widths
    for parameter in range(3):
        order = np.argsort(sd[3000:, parameter])
        for half in np.array_split(order, 2):
            assert held[half, parameter].mean() == pytest.approx(0.9, abs=0.03)
        flat = conformal_scale(errors[:3000, parameter], sd[:3000, parameter]) * sd[3000:, parameter]
        narrow, wide = (
            (np.abs(errors[3000:, parameter]) <= NINETY * flat)[half].mean() for half in np.array_split(order, 2)
        )
        assert narrow < 0.87 < 0.93 < wide


def test_too_few_clips_are_refused() -> None:
    with pytest.raises(ValueError, match="needs 100"):
        fit_widths_of([recovery(index, estimator="network") for index in range(99)])


def test_results_of_something_else_are_refused(tmp_path) -> None:
    """Another split, contacts cut off otherwise, another network, or one whose intervals are calibrated already."""
    network = {"weights_sha256": "abc", "calibrated": False}
    right = {"split": "validation", "seen": None, "estimator network": network}
    for change, words in (
        ({"split": "test"}, "has split test; run the benchmark with --split validation"),
        ({"seen": "press"}, "has seen press; run the benchmark without --seen"),
        ({"estimator network": network | {"weights_sha256": "def"}}, "not of the uncalibrated network"),
        ({"estimator network": network | {"calibrated": True}}, "not of the uncalibrated network"),
        ({"estimator network": network | {"onset": "between"}}, "made with --onset between"),
        ({"estimator network": {}}, "not of the uncalibrated network"),
    ):
        (tmp_path / "run.json").write_text(json.dumps(right | change))
        with pytest.raises(ValueError, match=words):
            check_record(tmp_path, "abc", None)
    (tmp_path / "run.json").write_text(json.dumps(right))
    check_record(tmp_path, "abc", None)
    with pytest.raises(ValueError, match="with --seen press"):
        check_record(tmp_path, "abc", "press")
    with pytest.raises(ValueError, match="run the benchmark with --onset between"):
        check_record(tmp_path, "abc", None, "between")
    unknown = right | {"estimator network": network | {"onset": "between"}}
    (tmp_path / "run.json").write_text(json.dumps(unknown))
    check_record(tmp_path, "abc", None, "between")


def test_the_noise_of_one_suite_has_no_exponent() -> None:
    """It differs by a few per cent from clip to clip, and whatever goes with that would be wrong for others."""
    generator = np.random.default_rng(0)
    noise, deviation = generator.normal(0, 0.02, 200), generator.normal(0, 0.5, 200)
    errors = np.exp(deviation + 3 * noise) * generator.normal(size=200)
    exponents = fit_exponents(errors, np.stack([deviation, noise], axis=1))
    assert exponents[1] == 0
    assert exponents[0] == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("text", ["[" * 100_000, "{", "[]", None], ids=["deep", "cut", "a list", "a pipe"])
def test_a_damaged_record_is_one_sentence(tmp_path, text: str | None) -> None:
    if text is None:
        os.mkfifo(tmp_path / "run.json")
    else:
        (tmp_path / "run.json").write_text(text)
    with pytest.raises(ValueError, match=r"run\.json (is not|can't be read as) a record of the benchmark.*; \w+"):
        check_record(tmp_path, "abc", None)


@pytest.mark.parametrize("content", [b"", b"garbage" * 500, b"PK\x05\x06" + bytes(18)])
def test_weights_that_can_t_be_read_are_one_sentence(tmp_path, capsys, content: bytes) -> None:
    (tmp_path / "bad.pt").write_bytes(content)
    assert main(["--weights", str(tmp_path / "bad.pt"), "--output", str(tmp_path / "out.onnx")]) == 1
    told = f"{tmp_path / 'bad.pt'} is not a readable checkpoint; give one that python -m estimators.network.training"
    assert capsys.readouterr().err == f"{told} wrote.\n"
    assert not (tmp_path / "out.onnx").exists()


def test_a_missing_file_is_one_sentence(tmp_path, capsys) -> None:
    assert main(["--weights", str(tmp_path / "none.pt"), "--output", str(tmp_path / "out.onnx")]) == 1
    assert "none.pt" in capsys.readouterr().err
    assert not (tmp_path / "out.onnx").exists()
