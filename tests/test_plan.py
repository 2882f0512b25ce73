"""The planner's door."""

import json

import pytest
import yaml

from palpate.cli import plan
from palpate.planning import cost_table
from tests.planning.cases import quick_press
from tests.planning.test_scene import SHIPPED


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost_table, "simulate_press", quick_press)


@pytest.mark.usefixtures("quick")
def test_a_plan_is_written_and_the_cache_used_by_another_scene(tmp_path, capsys):
    arguments = ["--cache", str(tmp_path / "presses")]
    assert plan.main([str(SHIPPED), "--output", str(tmp_path / "a"), *arguments]) == 0
    other = yaml.safe_load(SHIPPED.read_text()) | {"start": [0.03, -0.03]}
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(other))
    assert plan.main([str(tmp_path / "other.yaml"), "--output", str(tmp_path / "b"), *arguments, "--alpha", "0"]) == 0
    said = capsys.readouterr().err
    assert said.count("presses simulated") == 1
    assert said.count("found in the cache") == 1
    first, second = (json.loads((tmp_path / name / "plan.json").read_text()) for name in "ab")
    assert first["plan"]["cost"] < first["shortest"]["cost"]
    assert second["plan"]["places"] == second["shortest"]["places"] == [[0.03, -0.03], [0.025, 0.04]]
    assert (tmp_path / "a" / "plan.png").stat().st_size > 10_000
    assert first["plan"]["deformation"] < first["shortest"]["deformation"]


@pytest.mark.parametrize("option", ["--output", "--cache"])
@pytest.mark.parametrize("name", ["file/x", "a" * 300])
def test_what_can_t_be_written_is_told_before_presses_are_simulated(tmp_path, capsys, monkeypatch, option, name):
    monkeypatch.setattr(cost_table, "simulate_press", lambda *_: pytest.fail("minutes are spent"))
    (tmp_path / "file").write_text("mine")
    places = {"--output": str(tmp_path / "out"), "--cache": str(tmp_path / "presses"), option: str(tmp_path / name)}
    assert plan.main([str(SHIPPED), *(part for pair in places.items() for part in pair)]) == 1
    assert "writing failed" in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("young", [5.0, 5000.0])
def test_tissue_that_seems_to_be_in_kilopascals_is_said(tmp_path, capsys, young):
    scene = yaml.safe_load(SHIPPED.read_text())
    next(iter(scene["objects"].values()))["young"] = young
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene))
    assert plan.main([str(tmp_path / "scene.yaml"), "--output", str(tmp_path / "out")]) == 0
    said = "scene.yaml: young is 5 Pa, softer than tissue; give Pa, not kPa"
    assert (said in " ".join(capsys.readouterr().err.split())) == (young < 50)


@pytest.mark.usefixtures("quick")
def test_a_blocked_goal_is_a_sentence(tmp_path, capsys):
    blocked = yaml.safe_load(SHIPPED.read_text()) | {"goal": [0.03, 0.0]}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(blocked))
    assert plan.main([str(tmp_path / "scene.yaml"), "--output", str(tmp_path / "out")]) == 1
    assert "is blocked" in capsys.readouterr().err
    assert not (tmp_path / "out" / "plan.json").exists()
