"""Every notebook in examples/ runs, and what it prints is true."""

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

from tests.conftest import CHECKOUT


def run(path: Path) -> dict[str, Any]:
    """Names that a notebook leaves."""
    names: dict[str, Any] = {}
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    return names


@pytest.mark.parametrize("path", sorted((CHECKOUT / "examples").glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_are_committed_with_what_they_print_and_draw(path: Path) -> None:
    cells = [cell for cell in json.loads(path.read_text("utf-8"))["cells"] if cell["cell_type"] == "code"]
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert all(cell["execution_count"] for cell in cells)
    assert any("image/png" in output.get("data", ()) for output in outputs)
    assert any(output["output_type"] == "stream" for output in outputs)
    assert not any(output["output_type"] == "error" for output in outputs)


@pytest.mark.acceptance
def test_press_pull_and_simulator(monkeypatch, tmp_path, capsys) -> None:
    mpl.use("Agg")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    try:
        names = run(CHECKOUT / "examples" / "press_pull_simulate.ipynb")
        assert len(plt.get_fignums()) == 2
    finally:
        plt.close("all")
    told = capsys.readouterr().out
    assert told.startswith("determined\nstiffness: ")
    truth = names["truth"]
    for mean, name in zip(names["press_run"].estimate.theta, ("stiffness", "damping", "force"), strict=True):
        assert mean == pytest.approx(truth[name], rel=0.1)
    assert "relative_force" in names["pull_run"].grip.determined


@pytest.mark.acceptance
def test_three_examples_hold_their_truth(monkeypatch, tmp_path) -> None:
    mpl.use("Agg")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    try:
        names = run(CHECKOUT / "examples" / "palpate_phantom.ipynb")
        assert names["young"][1] < 10e3 < names["young"][2]
        assert names["poisson"][1] < 0.42 < names["poisson"][2]
        names = run(CHECKOUT / "examples" / "plan_past_a_fold.ipynb")
        planned = names["found"]["planned"]
        assert planned["cost_low"] < names["true_cost"] < planned["cost_high"]
        planned, straight = (names["paths"][name]["force_high_N"].max() for name in ("planned", "straight"))
        assert planned < 0.5 < straight
        names = run(CHECKOUT / "examples" / "stereo_pull.ipynb")
        assert names["held"].mean() > 0.7
    finally:
        plt.close("all")
