"""Compiling, not compiling, and where compiled code is kept."""

import os
import shutil
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path

import pytest

from palpate.physics.msd.grid_layout import MOBILE

ROOT = Path(__file__).resolve().parents[2]


def test_numba_is_installed_with_the_program():
    """Without it a clip takes thirty times as long."""
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert [name for name in needed if name.startswith("numba")]


SMALL = """
    from palpate.physics.jit import kernel
    from palpate.physics.msd.grid_layout import MOBILE


    @kernel
    def scaled(values):
        total = values[0] - values[0]
        for value in values:
            total += MOBILE * value * value
        return total
"""


@pytest.fixture
def copied(tmp_path) -> Path:
    """A checkout of the simulator of its own, without compiled code, and with a kernel that is compiled in no time."""
    for room in ("palpate", "physics"):
        shutil.copytree(ROOT / room, tmp_path / room, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / "physics" / "msd" / "small.py").write_text(textwrap.dedent(SMALL))
    return tmp_path


SHOW = """
    import numpy as np
    from palpate.physics.msd.small import scaled
    print(scaled.stats.cache_path, flush=True)
    input()
    print(float(scaled(np.arange(1, 4) / np.TYPE(3))))
"""


def start(checkout: Path, dtype: str = "float32", **environment: str) -> subprocess.Popen:
    """A process that computes with a checkout's kernel, which uses a constant of another file, as soon as it may.

    It prints the folder of the compiled code, waits for a line, and prints the result.
    """
    code = textwrap.dedent(SHOW).replace("TYPE", dtype)
    pipes, own = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE), {"PYTHONPATH": str(checkout)}
    command, variables = [sys.executable, "-c", code], os.environ | own | environment
    return subprocess.Popen(command, cwd=checkout, env=variables, text=True, **pipes)


def shown(*processes: subprocess.Popen) -> list[tuple[str, float]]:
    """Folders and results of processes that begin to compile at once."""
    folders = [process.stdout.readline().strip() for process in processes]
    for process in processes:
        process.stdin.write("\n")
        process.stdin.flush()
    ends = [process.communicate(timeout=300) for process in processes]
    assert [process.returncode for process in processes] == [0] * len(processes), ends
    return [(folder, float(output)) for folder, (output, _) in zip(folders, ends, strict=True)]


def expected(dtype: str, mobile: int = MOBILE) -> float:
    """What the copied kernel computes, with its constant."""
    return pytest.approx(mobile * 14 / 9, rel=1e-6 if dtype == "float32" else 1e-14)


@pytest.mark.slow
def test_code_does_not_outlive_a_constant_of_another_file(copied):
    assert MOBILE == 9
    [(folder, before)] = shown(start(copied))
    assert before == expected("float32")
    layout = copied / "physics" / "msd" / "grid_layout.py"
    text = layout.read_text()
    moved = text.replace(
        "LENGTH, LINK, MOBILE, REST_PLANES = 0, 3, 6, 9, 10", "MOBILE, LENGTH, LINK, REST_PLANES = 0, 3, 4, 7, 11"
    )
    assert moved != text
    layout.write_text(moved)
    [(changed_folder, after)] = shown(start(copied))
    assert changed_folder != folder
    assert after == expected("float32", 3)
    layout.write_text(text)
    assert shown(start(copied)) == [(folder, before)]


@pytest.mark.slow
def test_processes_that_start_together_and_find_no_code_compute_the_same(copied):
    kinds = ["float32", "float64", "float32"]
    results = shown(*(start(copied, kind) for kind in kinds))
    again = shown(*(start(copied, kind) for kind in kinds[:2]))
    assert results == [*again, again[0]]
    assert [value for _, value in again] == [expected(kind) for kind in kinds[:2]]
