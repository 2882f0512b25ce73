"""Conformal factors: by hand, and that they make intervals hold what they say."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.estimate import NINETY
from evaluation.calibration import conformal_scale, main


def test_factor_by_hand() -> None:
    """With 199 scores 1…199 in units of sd the 180th is the 90 % quantile of 200."""
    errors = np.repeat(np.arange(1.0, 200.0)[:, None], 3, axis=1) * (1, -1, 2)
    scale = conformal_scale(errors, np.ones((199, 3)))
    np.testing.assert_allclose(scale * NINETY, [180, 180, 360])


def test_overconfident_estimates_become_calibrated() -> None:
    generator = np.random.default_rng(0)
    sd = generator.uniform(0.05, 0.5, (4000, 3))
    errors = generator.normal(size=(4000, 3)) * sd * 1.7
    scale = conformal_scale(errors[:2000], sd[:2000])
    np.testing.assert_allclose(scale, 1.7, rtol=0.06)
    covered = (np.abs(errors[2000:]) <= NINETY * scale * sd[2000:]).mean(axis=0)
    np.testing.assert_allclose(covered, 0.9, atol=0.02)


def test_too_few_clips_are_refused() -> None:
    with pytest.raises(ValueError, match="needs 100"):
        conformal_scale(np.zeros((99, 3)), np.ones((99, 3)))


def test_a_missing_file_is_one_sentence(tmp_path, capsys) -> None:
    assert main(["--weights", str(tmp_path / "none.pt"), "--output", str(tmp_path / "out.onnx")]) == 1
    assert "none.pt" in capsys.readouterr().err
    assert not (tmp_path / "out.onnx").exists()
