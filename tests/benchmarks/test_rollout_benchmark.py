"""The benchmark of rollouts compares methods that compute the same."""

import numpy as np
import pytest

from benchmarks import rollout
from benchmarks.rollout import WINDOW, differences, in_jax, main, ours, pressed_sheet


def test_without_jax_it_says_how_to_install_it_and_times_ours(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr(rollout, "find_spec", lambda name: None)
    assert main(["--rows", "50", "--columns", "52", "--turns", "1"]) == 0
    printed = capsys.readouterr().out
    assert "JAX is not installed; install 'palpate[jax]' to compare with it." in printed
    assert "2600 vertices, 200 steps" in printed
    assert [line.split()[1] for line in printed.splitlines() if line.startswith("│")] == ["exact", "window"]


def test_derivatives_of_another_size_are_noticed() -> None:
    methods = ours(*pressed_sheet(50, 52))
    forward, derivatives = methods["exact"]
    path, slopes = derivatives()
    exact, window, other = differences(methods | {"other": (forward, lambda: (path, slopes * np.array([1, 1.01, 1])))})
    assert exact == 0
    assert window < WINDOW.window_error
    assert other == pytest.approx(0.01)


def test_jax_on_the_whole_mesh_and_on_its_crop_computes_the_same() -> None:
    pytest.importorskip("jax")
    sheet = pressed_sheet(50, 60)
    assert (differences(ours(*sheet) | in_jax(*sheet)) < 1e-5).all()
