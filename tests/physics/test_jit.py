"""Compiling, not compiling, and where compiled code is kept."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import warnings
from pathlib import Path

import numpy as np
import pytest
from sheets import sheet

from physics import jit
from physics.jit import Kernel, say_slow
from physics.mechanics import Mechanics
from physics.msd_kernel import simulate, simulate_field, simulate_sensitivities

ROOT = Path(__file__).resolve().parents[2]
ARGUMENTS = ((0.7, 0.05, -0.1), sheet(6, 6), 14, np.array([0.0, 0.0, -1.0]), Mechanics(steps=40, load_steps=10))


def run(code: str, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests' / 'physics'}", **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_without_numba_everything_works_and_says_once_that_it_is_slower():
    expected = simulate(*ARGUMENTS, dtype=np.float64)
    result = run("""
        import sys, warnings
        sys.modules["numba"] = None
        warnings.simplefilter("always")
        import numpy as np, torch
        from test_jit import ARGUMENTS
        from batches import batch_of
        from physics.msd import rollout
        from physics.msd_kernel import simulate, simulate_field, simulate_sensitivities
        trajectory = simulate(*ARGUMENTS, dtype=np.float64)
        simulate_field(*ARGUMENTS)
        simulate_sensitivities(*ARGUMENTS)
        mesh, contact = batch_of([ARGUMENTS[1]], [14])
        theta = torch.tensor([ARGUMENTS[0]], requires_grad=True)
        rollout(theta, mesh, contact).sum().backward()
        assert torch.isfinite(theta.grad).all()
        print(repr(trajectory[-1].tolist()))
    """)
    assert result.returncode == 0, result.stderr
    assert result.stderr.count("numba isn't installed") == 1
    np.testing.assert_allclose(np.array(eval(result.stdout)), expected[-1], rtol=1e-10)


def test_plain_and_compiled_doors_agree(monkeypatch):
    compiled = simulate(*ARGUMENTS), simulate_field(*ARGUMENTS), *simulate_sensitivities(*ARGUMENTS)
    monkeypatch.setattr(jit, "COMPILED", False)
    say_slow.cache_clear()
    with pytest.warns(RuntimeWarning, match="numba isn't installed"):
        plain = [simulate(*ARGUMENTS)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plain += [simulate_field(*ARGUMENTS), *simulate_sensitivities(*ARGUMENTS)]
    for seen, expected in zip(compiled, plain, strict=True):
        np.testing.assert_allclose(seen, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.skipif(not jit.COMPILED, reason="numba isn't installed")
def test_code_that_cannot_be_kept_is_compiled_for_this_process(monkeypatch):
    def double(value):
        return 2 * value

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    kernel = Kernel(double)
    monkeypatch.setattr(kernel, "run", full)
    assert kernel(21) == 42
    assert kernel(4) == 8
    assert kernel.__name__ == "double"


@pytest.mark.skipif(not jit.COMPILED, reason="numba isn't installed")
def test_without_any_folder_to_write_to_it_compiles_all_the_same(monkeypatch):
    calls = []

    def refusing(function, **options):
        calls.append(options.pop("cache", False))
        if calls[-1]:
            raise RuntimeError("cannot cache function 'triple': no locator available")
        return function

    monkeypatch.setattr(jit.numba, "njit", refusing)
    assert Kernel(lambda value: 3 * value)(5) == 15
    assert calls == [True, False]
