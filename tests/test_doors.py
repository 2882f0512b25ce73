"""Every program of the project ends in the same way."""

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from palpate.__main__ import COMMANDS
from tests.test_architecture import ROOT, faces, modules

MODULES = [
    "benchmarks.alarm",
    "benchmarks.compare_with_truth",
    "benchmarks.goldens",
    "benchmarks.inference",
    "benchmarks.instruments",
    "benchmarks.online",
    "benchmarks.palpation",
    "benchmarks.palpation.example",
    "benchmarks.path_traced",
    "benchmarks.path_tracer",
    "benchmarks.real",
    "benchmarks.recovery",
    "benchmarks.rollout",
    "data.synthetic",
    "palpate.estimators.network.calibration",
]
"""Programs that `python -m` starts."""


def named(module: str) -> str:
    """The file's name of such a program: a package is started by its `__main__`."""
    name = module if module.startswith(("benchmarks", "palpate")) else f"palpate.{module}"
    return f"{name}.__main__" if name in faces() else name


DOORS = {name: [f"{name}.py"] for name in ("infer", "train")}
DOORS |= {"palpate.__main__": ["-m", "palpate", "infer"], **{named(module): ["-m", module] for module in MODULES}}
"""How each program is started, by its file's name."""
INTERRUPTING = """
import os, signal, time
os.kill(os.getpid(), signal.SIGINT)
time.sleep(20)
"""


FILES = modules() | {path.stem: path for path in ROOT.glob("*.py")}
"""Where the programs stand."""


def test_these_are_all() -> None:
    found = {name for name, path in FILES.items() if re.search(r'^if __name__ == "__main__"', path.read_text(), re.M)}
    assert found == set(DOORS)


@pytest.mark.parametrize("door", DOORS)
def test_an_interrupt_during_imports_is_quiet(door: str, tmp_path: Path) -> None:
    """numpy, which all of them import first or soon, is one that presses Ctrl-C."""
    (tmp_path / "numpy.py").write_text(INTERRUPTING)
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, *DOORS[door]], cwd=ROOT, env=environment, capture_output=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"")


@pytest.mark.parametrize("door", DOORS)
def test_the_last_line_is_the_guarded_run(door: str) -> None:
    assert re.search(r'\n\nif __name__ == "__main__":\n    run_door\(main\b[^\n]*\)\n\Z', FILES[door].read_text())


@pytest.mark.parametrize(
    ("door", "command"), [*((door, []) for door in DOORS), *(("palpate.__main__", [name]) for name in COMMANDS)]
)
def test_every_help_is_printed(door: str, command: list[str], monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """A lone % in a help text ends argparse with a traceback, and only when --help is asked for.

    In this process: the slow imports are made once.
    """
    monkeypatch.setattr(sys, "argv", [FILES[door].name])
    with pytest.raises(SystemExit) as ended:
        sys.exit(importlib.import_module(door).main([*command, "--help"]))
    said = capsys.readouterr()
    assert (ended.value.code or 0, said.err) == (0, "")
    assert re.search("usage|python -m|palpate", said.out)
