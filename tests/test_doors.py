"""Every program of the project ends in the same way."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.test_architecture import ROOT, modules

DOORS = {
    "calibrate": ["calibrate.py"],
    "infer": ["infer.py"],
    "plan": ["plan.py"],
    "train": ["train.py"],
    "palpate.__main__": ["-m", "palpate", "infer"],
    "palpate.data.synthetic.__main__": ["-m", "data.synthetic"],
    "palpate.data.cholecseg8k": ["-m", "data.cholecseg8k"],
    "palpate.data.depth.photometric": ["-m", "data.depth.photometric"],
    "palpate.evaluation.benchmark": ["-m", "evaluation.benchmark"],
    "palpate.estimators.network.calibration": ["-m", "estimators.network.calibration"],
    "palpate.estimators.network.light_calibration": ["-m", "estimators.network.light_calibration"],
    "palpate.evaluation.ablation.__main__": ["-m", "evaluation.ablation"],
    "palpate.evaluation.compare_with_truth": ["-m", "evaluation.compare_with_truth"],
    "palpate.evaluation.plain_video": ["-m", "evaluation.plain_video"],
    "palpate.evaluation.foreign": ["-m", "evaluation.foreign"],
    "palpate.evaluation.online.__main__": ["-m", "evaluation.online"],
    "palpate.evaluation.palpation.__main__": ["-m", "evaluation.palpation"],
    "palpate.evaluation.palpation.example": ["-m", "evaluation.palpation.example"],
    "palpate.evaluation.paper.recovered": ["-m", "evaluation.paper.recovered"],
    "palpate.evaluation.result_figure": ["-m", "evaluation.result_figure"],
    "palpate.evaluation.model_errors": ["-m", "evaluation.model_errors"],
    "palpate.evaluation.real.__main__": ["-m", "evaluation.real"],
    "palpate.benchmarks.inference": ["-m", "benchmarks.inference"],
    "palpate.benchmarks.rollout": ["-m", "benchmarks.rollout"],
}
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
