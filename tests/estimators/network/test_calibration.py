"""Calibration by hand, on errors of known size, and what it refuses."""

import json
import os

import numpy as np
import pytest

from benchmarks.harness import Row, Store
from palpate.data.contact.features import FEATURES, KNOWN, REFERENCE_SPACING
from palpate.data.contact.sequence_features import WITHIN
from palpate.estimators.network.calibration import check_record, main, widths_of
from palpate.models.calibration import LOG_DAMPING
from palpate.models.calibration_fit import conformal_scale, fit_exponents
from palpate.models.onnx_session import PosteriorModel
from palpate.physics.identifiability import NINETY
from palpate.results.record import sha256_of
from tests.benchmarks.recovery_cases import off_by, recovery

RATIO = float(np.exp(np.log(np.abs(off_by([0.0] * 3))) @ LOG_DAMPING))
"""k_d/√k_s of the usual tissue."""


def rows_of(errors: np.ndarray, sd: np.ndarray, noise: np.ndarray, damping: np.ndarray) -> list[Row]:
    """Clips whose log θ was missed by so much, said with so large standard deviations; log damping over the usual."""
    rows = []
    for index, error in enumerate(errors):
        true = np.array([0.0, damping[index], 0.0])
        known = {"covariance": np.diag(sd[index] ** 2), "noise": noise[index] * REFERENCE_SPACING}
        rows.append(recovery(index, estimator="network", theta=off_by(true), estimate=off_by(error + true), **known))
    return rows


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
    damping = np.exp(generator.uniform(-4, 4, 6000))
    """Over the usual tissue's."""
    errors = generator.normal(size=(6000, 3)) * 1.3 * sd**0.7 * noise[:, None] ** 0.2 * damping[:, None] ** 0.15
    found = widths_of(rows_of(errors[:3000], sd, noise, np.log(damping)))
    np.testing.assert_allclose(found.power, 0.7, atol=0.06)
    np.testing.assert_allclose(found.noise, 0.2, atol=0.06)
    np.testing.assert_allclose(found.damping, 0.15, atol=0.06)
    ratios = RATIO * damping[3000:, None]
    widths = found.scale * sd[3000:] ** found.power * noise[3000:, None] ** np.array(found.noise)
    widths = widths * ratios ** np.array(found.damping)
    off = np.abs(errors[3000:])
    for parameter in range(3):
        halves = np.array_split(np.argsort(sd[3000:, parameter]), 2)
        held = off[:, parameter] <= NINETY * widths[:, parameter]
        assert [held[half].mean() for half in halves] == pytest.approx([0.9, 0.9], abs=0.03)
        flat = conformal_scale(errors[:3000, parameter], sd[:3000, parameter]) * sd[3000:, parameter]
        narrow, wide = ((off[:, parameter] <= NINETY * flat)[half].mean() for half in halves)
        assert narrow < 0.88 < 0.92 < wide


def test_a_noise_between_two_others_may_be_the_worst() -> None:
    """Noise like that of rounding: errors that are three times as large there only."""
    generator = np.random.default_rng(1)
    noise = generator.choice([0.4, 0.6, 1.5], 2400)
    factor = np.where(noise == 0.6, 3.0, 1.0)
    errors = generator.normal(size=(2400, 3)) * 0.1 * factor[:, None]
    found = widths_of(rows_of(errors, np.full((2400, 3), 0.1), noise, np.zeros(2400)))
    assert found.middle_range == (pytest.approx(np.log(0.4)), pytest.approx(np.log(1.5)))
    for level, factors in ((0.4, 1), (0.6, 3), (1.5, 1)):
        log = np.log(level)
        widths = 0.1 ** np.array(found.power) * found.scale * RATIO ** np.array(found.damping)
        widths *= np.exp(log * np.array(found.noise) + (log - np.log(0.4 * 1.5) / 2) ** 2 * np.array(found.bend))
        np.testing.assert_allclose(widths, 0.1 * factors, rtol=0.15)


def test_results_of_something_else_are_refused(tmp_path) -> None:
    """Another split, contacts cut off otherwise, or another network."""
    network = {"model_sha256": "abc"}
    right = {"split": "validation", "seen": None, "estimator network": network}
    for change, words in (
        ({"split": "test"}, "has split test; run the benchmark with --split validation"),
        ({"seen": "press"}, "has seen press; run the benchmark without --seen"),
        ({"estimator network": {"model_sha256": "def"}}, "is of another network than the one to calibrate"),
        ({"estimator network": network | {"onset": "between"}}, "made with --onset between"),
        ({"estimator network": {}}, "is of another network than the one to calibrate"),
    ):
        (tmp_path / "run.json").write_text(json.dumps(right | change))
        with pytest.raises(ValueError, match=words):
            check_record(tmp_path, "abc", None)
    (tmp_path / "run.json").write_text(json.dumps(right))
    check_record(tmp_path, "abc", None)
    for asked, words in ((("press",), "with --seen press"), ((None, "between"), "the benchmark with --onset between")):
        with pytest.raises(ValueError, match=words):
            check_record(tmp_path, "abc", *asked)
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


@pytest.mark.parametrize("content", [b"", b"garbage" * 500, b"PK\x05\x06" + bytes(18), None])
def test_weights_that_can_t_be_read_are_one_sentence(tmp_path, capsys, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "bad.pt").write_bytes(content)
    assert main(["--weights", str(tmp_path / "bad.pt"), "--output", str(tmp_path / "out.onnx")]) == 1
    told = f"{tmp_path / 'bad.pt'} is not a readable checkpoint; give one that train.py fit -c configs/contact.yaml"
    caught = capsys.readouterr().err
    assert caught == f"{told} wrote.\n" if content is not None else "bad.pt" in caught
    assert not (tmp_path / "out.onnx").exists()


def test_an_exported_posterior_is_calibrated_by_its_results(tmp_path, capsys, posterior: PosteriorModel) -> None:
    """From the command line, several folders of results together; all errors are of one size, and sd tells nothing."""
    plain, output = posterior.path, tmp_path / "out.onnx"
    generator = np.random.default_rng(0)
    for name, count in (("first", 99), ("second", 21), ("pressed", 100), ("late", 100)):
        network = {"model_sha256": sha256_of(plain), "onset": "between" if name == "late" else "stamp"}
        wanted = {"seed": 0, "split": "validation", "seen": "press" if name == "pressed" else None}
        wanted |= {"estimator network": network}
        errors = generator.normal(0, 0.4, (count, 3))
        rows = rows_of(errors, np.full((count, 3), 0.1), np.full(count, 0.001 / REFERENCE_SPACING), np.zeros(count))
        Store(tmp_path / name, wanted, ("suite", "index", "estimator")).append(rows)
    pressed = ["--pressed", str(tmp_path / "pressed"), "--between", str(tmp_path / "late")]
    results = ["--validation", str(tmp_path / "first"), str(tmp_path / "second"), *pressed]
    assert main(["--model", str(plain), "--output", str(output), *results]) == 0
    assert "whole scale" in capsys.readouterr().out
    told = PosteriorModel(output).metadata["calibration"]
    assert (told["known_features"], told["within_features"]) == (list(KNOWN), [FEATURES + WITHIN])
    kinds = "whole", "pressed", "between"
    scales = [told[name]["scale"] * RATIO ** np.array(told[name]["damping"]) for name in kinds]
    np.testing.assert_allclose(scales, 0.4, rtol=0.25)
    for model, given, said in (
        (output, results, "is of another network than the one to calibrate"),
        (plain, [*results[:2], *pressed], "99 validation estimates; calibration needs 100 or more"),
    ):
        assert main(["--model", str(model), "--output", str(tmp_path / "no.onnx"), *given]) == 1
        assert said in capsys.readouterr().err
    assert not (tmp_path / "no.onnx").exists()


@pytest.mark.parametrize(
    "options",
    [("--model", "x.onnx"), ("--weights", "x.pt", "--pressed", "r"), ("--weights", "x.pt", "--model", "x.onnx")],
)
def test_options_that_don_t_go_together_are_wrong_usage(tmp_path, capsys, options: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit, match=r"^2$"):
        main(["--output", str(tmp_path / "out.onnx"), *options])
    assert "give --weights alone, or --model with --validation, --pressed" in capsys.readouterr().err
