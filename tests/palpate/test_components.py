"""An estimator, a mask source and an observation of another package: one file each, and an entry point."""

import importlib.metadata
import json
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from palpate.cli import infer
from palpate.data.synthetic.clip import write_clip
from tests.tables import read_rows
from tests.test_infer import SCENE

ESTIMATOR = '''
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from palpate.common.options import option
from palpate.estimators.contract import Estimator
from palpate.estimators.estimate import PressResult
from palpate.estimators.runs import RunSession, frame_estimate
from palpate.physics.mechanics import Mechanics


@dataclass(frozen=True)
class Constant(Estimator):
    """One stiffness for every press."""

    firmness: Annotated[float, 0, 9] = option(1.0, metavar="K")
    """stiffness of all tissue"""

    name = "constant"

    def build(self):
        return self

    def start(self, clip):
        return Session(clip, Mechanics(), self.firmness)


class Session(RunSession):
    def __init__(self, clip, mechanics, firmness):
        super().__init__(clip, mechanics)
        self.firmness = firmness

    def push(self, frame):
        yield from self._ended(self._pushed(frame))
        yield frame_estimate(frame, self.clip, whole=True)

    def _whole(self, contact):
        found = PressResult(np.array([self.firmness, 0.1, -0.1]), given_verdict="undetermined")
        return found, (np.zeros(1), np.zeros(1)), "It was not looked at."
'''
MASKS = '''
from palpate.data.masks.annotation import AnnotationMasks


class Drawn(AnnotationMasks):
    """Masks as they are drawn."""

    def __init__(self, asked):
        super().__init__(asked)
        self.identity = "drawn"
'''
OBSERVATION = '''
import numpy as np

from palpate.observations.base import Observation
from palpate.physics.observation import Linearised


class Sinking(Observation):
    """How far the followed contact has gone from the camera."""

    def __init__(self, contact):
        super().__init__(contact)
        record = contact.observations["sinking"]
        self.vertices, self.times, self.sunk = np.array([contact.vertex]), record.times, record.values

    @staticmethod
    def shown(frame, onset):
        return frame.track_position[2] - onset.contact.mesh.vertices[onset.contact.vertex, 2]

    def linearise(self, moved, slopes, logs):
        return Linearised((moved[:, 0, 2] - self.sunk) / 0.001, slopes[:, 0, 2] / 0.001)
'''
ENTRIES = {
    "palpate.observations": [EntryPoint("sinking", "toy_observation:Sinking", "palpate.observations")],
    "palpate.estimators": [EntryPoint("constant", "toy_estimator:Constant", "palpate.estimators")],
    "palpate.masks": [EntryPoint("drawn", "toy_masks:Drawn", "palpate.masks")],
}


@pytest.fixture(autouse=True)
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "toy_estimator.py").write_text(ESTIMATOR)
    (tmp_path / "toy_masks.py").write_text(MASKS)
    (tmp_path / "toy_observation.py").write_text(OBSERVATION)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in ("toy_estimator", "toy_masks", "toy_observation"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    found = importlib.metadata.entry_points
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **of: ENTRIES.get(of.get("group")) or found(**of))


def test_they_run_through_infer(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    clip, output = write_clip(tmp_path / "clips", 1, SCENE, 3), tmp_path / "out"
    given = ["--estimator", "constant", "--firmness", "7", "--masks", "drawn", "--no-overlay"]
    assert infer.main([str(clip), "--output", str(output), *given]) == 0
    (row,) = read_rows(output / clip.name / "interactions.csv")
    assert (float(row["stiffness"]), row["detail"]) == (7.0, "It was not looked at.")
    record = json.loads((output / clip.name / "run.json").read_text())
    assert record["estimator"] == {"name": "constant", "firmness": 7.0}
    assert record["masks"] == {"source": "drawn", "identity": "drawn"}
    with pytest.raises(SystemExit, match=r"^2$"):
        infer.main([str(clip), "--output", str(output), "--firmness", "7"])
    assert "--firmness is an option of --estimator constant." in capsys.readouterr().err


def test_an_observation_is_recorded_and_fitted(tmp_path: Path) -> None:
    clip, output = write_clip(tmp_path / "clips", 1, SCENE, 3), tmp_path / "out"
    given = ["--estimator", "direct", "--observation", "sinking", "--onset", "stamp", "--no-overlay"]
    assert infer.main([str(clip), "--output", str(output), *given]) == 0
    (row,) = read_rows(output / clip.name / "interactions.csv")
    truth = json.loads((clip / "truth.json").read_text())
    assert row["verdict"] != "", row["detail"]
    assert float(row["stiffness"]) == pytest.approx(truth["theta"]["stiffness"], rel=0.3)
    record = json.loads((output / clip.name / "run.json").read_text())
    assert record["estimator"]["observation"] == ["sinking"]


def help_of(estimator: str, capsys: pytest.CaptureFixture) -> str:
    with pytest.raises(SystemExit, match=r"^0$"):
        infer.main(["--help", "--estimator", estimator])
    return " ".join(capsys.readouterr().out.split())


def test_they_are_in_the_help(capsys: pytest.CaptureFixture) -> None:
    said = help_of("constant", capsys)
    assert "--estimator {network,gan,direct,online,constant}" in said
    assert "--observation {depth,shading,sinking}" in help_of("direct", capsys)
    assert "or a source: auto, annotation, automatic, drawn" in said
    assert (
        "--estimator constant: One stiffness for every press: --firmness K stiffness of all tissue (default 1.0)"
        in said
    )


def test_one_that_is_broken_is_named(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "toy_estimator.py").write_text("import nothing_of_this_name")
    for given in (["--estimator", "constant"], ["--help"]):
        with pytest.raises(SystemExit, match=r"^2$"):
            infer.main(["x", "--output", "y", *given])
        said = (
            "estimator constant can't be imported (No module named 'nothing_of_this_name'); install its package anew."
        )
        assert said in capsys.readouterr().err
