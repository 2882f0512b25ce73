"""The inference benchmark times the sizes that the configurations have, and reads what infer.py writes down."""

import json
from pathlib import Path

import pytest
import yaml

from benchmarks import inference
from benchmarks.inference import NETWORKS, encoder_and_head, exported, timed
from palpate.data.synthetic.clip import write_clip
from palpate.data.synthetic.settings import SceneSettings
from palpate.models.onnx_session import open_model
from tests.test_architecture import ROOT


@pytest.fixture(autouse=True)
def few_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inference, "RUNS", 2)


@pytest.mark.acceptance
@pytest.mark.parametrize("name", NETWORKS)
def test_networks_are_as_large_as_configured(name: str, tmp_path: Path) -> None:
    file = exported(name, tmp_path)
    configured = yaml.safe_load((ROOT / "configs" / name).read_text())
    assert open_model(file).window == configured["data"].get("samples", {}).get("window", 1)
    assert configured["model"]["width"] == 64
    assert 0.1 < encoder_and_head(file, 1) < 10_000


@pytest.mark.acceptance
def test_a_video_is_timed_as_its_record_says(tmp_path: Path) -> None:
    settings = SceneSettings(width=214, height=120, frames=16)
    clip = write_clip(tmp_path / "clips", 1, settings, seed=1).with_suffix(".mp4")
    found = timed(ROOT, clip, tmp_path / "results")
    (record,) = (tmp_path / "results").rglob("run.json")
    seconds = json.loads(record.read_text())["timings_s"]
    assert found["frames/s"] == pytest.approx(16 / seconds["total"])
    assert found["contact"] == seconds["contact"]
    assert 0.5 < found["processor [s]"] < 1000
    assert 50 < found["peak memory [MB]"] < 10_000
    with pytest.raises(RuntimeError, match="status 2 on"):
        timed(ROOT, tmp_path / "none.mp4", tmp_path / "results")
